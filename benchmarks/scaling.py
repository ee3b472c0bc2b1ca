# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Strong scaling of the paper: one load step on more and more processes, and their messages.

    python3 -m benchmarks.scaling --geometry vessel --processes 1,2 --json build/scaling.json

The load step goes to 0.2 mmHg with κ = 100 kPa, P1–P0 and the lumped preconditioner (section
*Strong scaling for nonlinear elasticity*, tables Augustin_tab:aorta_scaling and carotis_scaling).
It is solved by all-floating FETI on the wall of one layer, and by classical FETI on that of two
layers.

Runs on --processes are measured; there may be as many as there are cores. Runs on --count are
counted, with any number on any machine: messages, bytes, neighbours, reductions and coarse solves
of an iteration and of a set-up. ``--predict DOFS PROCESSES`` runs nothing; it prints the seconds
that the model predicts from the records.

The study starts a separate program with mpirun for each number of processes. A case that fails does
not end the others, and measured runs do not load the library that counts. Do not start the study
itself with mpirun.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

from benchmarks.common import command, paper
from benchmarks.common.pages import Fields, groups, section
from benchmarks.common.plots import COLOURS, OPEN, curve, picture
from benchmarks.common.records import Record, read_records
from benchmarks.common.scaling import model
from benchmarks.common.scaling.model import Model, create_model, efficiency
from benchmarks.common.scaling.traffic import compile_library
from benchmarks.common.study import Arguments, Keep, Study
from benchmarks.common.walls.first_step import ARTERIES, CHOICES
from benchmarks.common.walls.first_step import TYPES as NAMES
from dolfinx_feti import ConvergenceError
from dolfinx_feti.meshes.arguments import count

#: Variant by layers of the wall: the paper's aorta, its carotid artery.
TYPES = {1: "all_floating", 2: "classical"}

#: Environment that lets Open MPI put several processes on a core; MPICH always does.
SHARED_CORES = {
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    "OMPI_MCA_mpi_yield_when_idle": "1",
}

#: Beginnings of the variables of a process that MPI has started; another mpirun must not see them.
INHERITED = ("PMI_", "PMIX_", "PRTE_", "OMPI_COMM_WORLD_", "OMPI_FILE_", "OMPI_UNIVERSE_")

#: Records of the page.
KEPT = Path(__file__).parents[2] / "docs/results/scaling.json"

#: Preconditioners of the two choices.
PC = {"paper": "lumped", "default": "dirichlet"}

#: Keys of a series: cases that differ only in their number of processes.
CASE = ("geometry", "size", "subdomains", "layers", "choices")

#: Processes of weak scaling, as many dofs on each.
WEAK = (512, 10_000)

#: Parts that the page shows.
SHOWN = ("local", "krylov", "total")

#: Factors from the units of the model's cluster to those of the page: µs, GB/s and Gflop/s.
UNITS = {"latency": 1e6, "node": 1, "bus": 1}
UNITS |= dict.fromkeys(("bandwidth", "stream", "rate", "disk"), 1e-9)
CLUSTER = {name: unit * getattr(model, name.upper()) for name, unit in UNITS.items()}

STYLES = {"local": {"color": COLOURS[2]}, "krylov": {"color": COLOURS[0]}, "total": {"color": "k"}}

#: Number of processes that the model predicts, beyond the paper's.
FURTHER = 10_000

#: Columns of a prediction.
FORESEEN = ("reading", "local", "coarse", "krylov", "rest", "fixed", "total")


def _options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    numbers = command.several(count)
    some = [1, 2, 4, 8, 16, 32, 64]
    command.add_mesh(parser)
    command.add_choices(parser, "--task", ("count", "measure"))
    add("--processes", type=numbers, default=[1, 2], help="to measure, 1,2")
    add("--count", type=numbers, default=some, help="to count, 1,2,4,8,16,32,64")
    add("--predict", type=count, nargs=2, metavar=("DOFS", "PROCESSES"), help="print the model's")
    add("--subdomains", type=count, default=512, help="over all processes, 512")
    command.add_choices(parser, "--layers", tuple(TYPES))
    command.add_choices(parser, "--choices", tuple(CHOICES))


def _cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    """Yield the cases; counted ones come first, as they are quick.

    With ``--predict`` it prints the prediction, and yields none.
    """
    if args.predict:
        (kept,) = args.json or [KEPT]
        known = read_records(kept, STUDY.known, STUDY.page)
        command.say("\n".join(predict(known, *args.predict)), comm)
        return
    _check(args)
    shared = {name: getattr(args, name) for name in ("geometry", "size", "subdomains")}
    shared |= {"study": "scaling", "degree": 1, "kappa": 100.0}
    for task in args.task:
        numbers = args.choices, args.layers, _processes(args, task)
        for choices, layers, processes in itertools.product(*numbers):
            case = {"task": task, "layers": layers, "choices": choices, "processes": processes}
            yield shared | case | {"type": TYPES[layers], "pc": PC[choices]}


def _processes(args: Arguments, task: str) -> Sequence[int]:
    return args.count if task == "count" else args.processes


def _run(case: Record, keep: Keep, args: Arguments, _comm: MPI.Comm) -> None:
    """Run a case as a program of its own, and keep its record.

    Raises:
        ConvergenceError: The program failed; the message has the end of its output.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "record.json"
        inside = json.dumps(case | {"folder": str(args.folder)})
        words = ["mpirun", "-n", str(case["processes"]), "env", "OMP_NUM_THREADS=1"]
        environment = {k: v for k, v in os.environ.items() if not k.startswith(INHERITED)}
        if case["task"] == "count":
            words += [f"LD_PRELOAD={compile_library(args.folder)}"]
            environment |= SHARED_CORES
        words += [sys.executable, "-m", "benchmarks.common.scaling.worker", inside, str(file)]
        ended = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
        if ended.returncode != 0 or not file.is_file():
            last = (ended.stderr or ended.stdout).strip()[-2000:]
            raise ConvergenceError(f"exit status {ended.returncode}:\n{last}")
        keep({}, json.loads(file.read_text()))


def _check(args: Arguments) -> None:
    """Raise a ValueError if the cases cannot be run here."""
    cores = len(os.sched_getaffinity(0))
    if MPI.COMM_WORLD.size > 1:
        raise ValueError("it starts mpirun itself: run it as python3 -m benchmarks.scaling")
    if "measure" in args.task and max(args.processes) > cores:
        raise ValueError(
            f"--processes {max(args.processes)}: there are {cores} cores, and shared ones measure "
            "nothing; --count takes any number"
        )
    most = max(P for task in args.task for P in _processes(args, task))
    if most > args.subdomains:
        raise ValueError(
            f"{most} processes need as many --subdomains, and there are {args.subdomains}"
        )
    if shutil.which("mpirun") is None:
        raise ValueError("mpirun is missing")


def predict(records: Sequence[Record], dofs: int, processes: int) -> Iterator[str]:
    """Yield the lines of a table: seconds of a load step, for each series that was measured."""
    first = min(paper.FIRST, processes)
    yield f"A load step of {dofs} dofs on {processes} processes, modelled [s]:"
    yield " ".join(f"{name:>8}" for name in (*FORESEEN, "eff")) + f"  (eff: against {first})"
    for series in filter(lambda s: s.model, _series(records)):
        base = series.model.base
        names = series.names
        there, here = (series.model.predict(P, dofs / base["dofs"]) for P in (first, processes))
        numbers = [here[part] for part in FORESEEN]
        numbers.append(efficiency(first, there["total"], processes, here["total"]))
        its = sum(base["linear_iterations_per_newton"])
        steps = base["newton_iterations"]
        case = f"{names['kind']}, {names['chosen']}: {steps} Newton steps, {its} iterations"
        yield " ".join(f"{number:8.3g}" for number in numbers) + f"  {case}"


@dataclass(frozen=True, slots=True)
class _Series:
    """Cases that differ only in their number of processes, in rising order, and their model."""

    layers: int
    choices: str
    measured: list[Record]
    counted: list[Record]
    model: Model | None

    def section(self, rows: Iterable[Fields], **fields: object) -> list[dict[str, object]]:
        """Return a section of the page with the names of the series and its first case."""
        first = (self.measured or self.counted)[0]
        return section(rows, **(first | self.names | fields))

    @property
    def dofs(self) -> int:
        """Dofs of the paper's mesh."""
        return paper.DOFS[self.layers, 1]

    @property
    def refined(self) -> float:
        """The paper's dofs over those of the model's mesh."""
        return self.dofs / self.model.base["dofs"]

    @property
    def names(self) -> dict[str, str]:
        """Names of type, choices and artery on the page."""
        kind = NAMES[TYPES[self.layers]]
        return {"kind": kind, "chosen": CHOICES[self.choices], "artery": ARTERIES[self.layers]}


def _fields(records: Sequence[Record]) -> Fields:
    every = list(_series(records))
    modelled = [s for s in every if s.model is not None]
    counted = {r["processes"]: r for s in modelled for r in s.counted}
    return {
        "cluster": CLUSTER,
        "measured": [part for s in every for part in s.section(_times(s))],
        "modelled": [part for s in modelled for part in s.section(_model_rows(s), dofs=s.dofs)],
        "limits": section(row for s in modelled for row in _limits(s)),
        "weak": section(_weak(s) for s in modelled),
        "once": section(r | s.names | {"s": r["seconds_once"]} for s in every for r in s.measured),
        "reading": section(
            {"P": P, "mb": r["reading_bytes"] / 1e6, "mib": r["reading_mib"], "sent": r["reading"]}
            for P, r in sorted(counted.items())
        ),
        "counted": section(row for s in every for row in _counts(s)),
        "first_processes": paper.FIRST,
    }


def _series(records: Sequence[Record]) -> Iterator[_Series]:
    """Yield the series, the paper's choices first."""
    found = sorted(groups(records, *CASE), key=lambda s: (list(CHOICES).index(s[0][-1]), s[0][-2]))
    for (*_, layers, choices), mine in found:
        mine.sort(key=lambda record: record["processes"])
        tasks = [[r for r in mine if r["task"] == task] for task in ("measure", "count")]
        yield _Series(layers, choices, *tasks, create_model(*tasks))


def _counts(series: _Series) -> Iterator[Record]:
    """Yield the counted cases, with the growth of messages to each from the first case."""
    first = next((r["messages_to_each"] for r in series.counted if r["messages_to_each"]), None)
    for r in series.counted:
        to_each = r["messages_to_each"]
        grown = to_each / first if to_each and first else None
        kilobytes = r["setup"]["bytes"]["max"] / 1e3
        yield r | series.names | {"kilobytes": kilobytes, "grown": grown}


def _times(series: _Series) -> Iterator[dict[str, object]]:
    """Yield seconds and efficiencies of the measured cases, and the seconds of the model."""
    every = [{part: r[f"seconds_{part}"] for part in SHOWN} for r in series.measured]
    for r, s in zip(series.measured, every, strict=True):
        P = r["processes"]
        first = series.measured[0]["processes"]
        foreseen = series.model.predict(P) if series.model else {}
        yield {"P": P, "s": s, "eff": _efficiencies(first, every[0], P, s), "model": foreseen}


def _model_rows(series: _Series) -> Iterator[dict[str, object]]:
    """Yield the model's seconds and efficiencies on the paper's mesh, and the paper's."""
    begin = paper.FIRST
    theirs = paper.TIMES[series.layers]
    refined = series.refined
    first = series.model.predict(begin, refined)
    for P in (*theirs, FURTHER):
        s = series.model.predict(P, refined)
        printed = _efficiencies(begin, theirs[begin], P, theirs[P]) if P in theirs else {}
        yield {"P": P, "s": s, "eff": _efficiencies(begin, first, P, s), "paper": printed}


def _efficiencies(
    begin: int, first: Mapping[str, float], P: int, times: Mapping[str, float]
) -> dict[str, float]:
    """Return the efficiencies of the parts in SHOWN, relative to ``begin`` processes."""
    return {part: efficiency(begin, first[part], P, times[part]) for part in SHOWN}


def _limits(series: _Series) -> Iterator[dict[str, object]]:
    """Yield the shares of the parts in the total time, and in that of the Krylov method [%]."""
    for P in (max(paper.TIMES[series.layers]), FURTHER):
        foreseen = series.model.predict(P, series.refined)
        for whole, parts in {"total": model.PARTS, "Krylov": model.KRYLOV}.items():
            all_of_it = sum(foreseen[part] for part in parts)
            percent = {part: 100 * foreseen[part] / all_of_it for part in parts}
            yield series.names | {"P": P, "whole": whole, "share": percent}


def _weak(series: _Series) -> dict[str, object]:
    """Return seconds of Krylov method and coarse set-up on the two numbers of processes WEAK.

    The fewer processes have the dofs of the paper's mesh.
    """
    dofs = series.dofs
    (few, many) = WEAK
    foreseen = (series.model.predict(P, series.refined * P / few) for P in WEAK)
    t = [p["krylov"] + p["coarse"] for p in foreseen]
    sizes = {"few": few, "many": many, "dofs": dofs, "dofs_many": dofs * many // few}
    return series.names | sizes | {"t": t, "eff": t[0] / t[1]}


def _draw(records: Sequence[Record], folder: Path) -> list[Fields]:
    """Draw measured points, the model's curves, and the paper's points, with its choices."""
    of_layers = {s.layers: s for s in _series(records) if s.choices == "paper" and s.measured}
    if not any(series.measured for series in of_layers.values()):
        return []
    legend = {"local": STYLES["local"], "global Krylov method": STYLES["krylov"]}
    legend |= {"total": STYLES["total"], "measured": {"marker": "s", "ls": ""}}
    legend |= {"model": {}, "the paper's": OPEN}
    processes = [2**k for k in range(10)]
    with picture(folder / "scaling.png", 1, 2, legend, sharex=True) as axes:
        axes[0, 0].set_ylabel("seconds of a load step")
        for ax, (layers, kind) in zip(axes[0], TYPES.items(), strict=True):
            ax.set(title=f"{NAMES[kind]}; the paper's {ARTERIES[layers]}", xlabel="processes")
            ax.set_yscale("log")
            ax.set_xscale("log", base=2)
            for part, style in STYLES.items():
                theirs = paper.TIMES[layers].items()
                curve(ax, [(P, times[part]) for P, times in theirs], **(style | OPEN))
                series = of_layers.get(layers)
                measured = series.measured if series else []
                points = [(r["processes"], r[f"seconds_{part}"]) for r in measured]
                curve(ax, points, **style, marker="s", ls="")
                if series and series.model:
                    foreseen = [(P, series.model.predict(P)[part]) for P in processes]
                    curve(ax, foreseen, **style)
    return [{"picture": "scaling.png"}]


def _is_known(record: Record) -> bool:
    return record.get("study") == "scaling"


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="scaling",
    known=_is_known,
    options=_options,
    cases=_cases,
    run=_run,
    fields=_fields,
    draw=_draw,
)

if __name__ == "__main__":
    STUDY.main()
