# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's strong scaling: one load step on more and more processes, and what they send.

    python3 -m benchmarks.scaling --geometry vessel --processes 1,2 --json build/scaling.json

The load step to 0.2 mmHg with κ = 100 kPa, P1–P0 and the lumped preconditioner (section *Strong
scaling for nonlinear elasticity*, tables Augustin_tab:aorta_scaling and carotis_scaling):
all-floating FETI on the wall of one layer, classical FETI on that of two. --processes are measured,
at most as many as there are cores. --count are counted, any number on any machine: messages, bytes,
neighbours, reductions and coarse solves of an iteration and of a set-up. ``--predict DOFS
PROCESSES`` runs nothing: it prints what the model makes of the records.

Each number of processes is a program of its own, which this one starts with mpirun: a case that
fails takes no other one along, and the library that counts is in no run that is measured. Do not
run this with mpirun.
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
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from mpi4py import MPI

from benchmarks.common import command, paper
from benchmarks.common.pages import Fields, groups, section
from benchmarks.common.plots import COLOURS, OPEN, curve, picture
from benchmarks.common.records import Record, read_records
from benchmarks.common.scaling.model import KRYLOV, Machine, Model, create_model, efficiency
from benchmarks.common.scaling.traffic import compile_library
from benchmarks.common.study import Arguments, Keep, Study
from benchmarks.common.walls.first_step import ARTERIES, CHOICES
from benchmarks.common.walls.first_step import TYPES as NAMES
from dolfinx_feti import ConvergenceError
from meshes.arguments import count

__all__ = ["INHERITED", "SHARED_CORES", "STUDY", "TYPES", "predict"]


#: Variant by layers of the wall: the paper's aorta, its carotid artery.
TYPES = {1: "all_floating", 2: "classical"}

#: Environment in which Open MPI puts several processes on a core; MPICH does so by itself.
SHARED_CORES = {
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    "OMPI_MCA_mpi_yield_when_idle": "1",
}

#: Environment of a process that mpirun has started, which another mpirun must not see.
INHERITED = ("PMI_", "PMIX_", "PRTE_", "OMPI_COMM_WORLD_", "OMPI_FILE_", "OMPI_UNIVERSE_")

#: Records of the page.
KEPT = Path(__file__).parents[2] / "docs/results/scaling.json"

#: Preconditioners of the two choices.
PC = {"paper": "lumped", "default": "dirichlet"}


#: What cases share that differ in their number of processes alone.
CASE = ("geometry", "size", "subdomains", "layers", "choices")

#: Processes of weak scaling, as many dofs on each.
WEAK = (512, 10_000)

PARTS = ("local", "krylov", "total")

#: Microseconds, GB/s and Gflop/s.
UNITS = {"latency": 1e6} | dict.fromkeys(("bandwidth", "stream", "rate", "disk"), 1e-9)

STYLES = {"local": {"color": COLOURS[2]}, "krylov": {"color": COLOURS[0]}, "total": {"color": "k"}}

#: Processes that the model is asked for, beyond the paper's.
FURTHER = 10_000

#: Columns of a prediction.
FORESEEN = ("reading", "local", "coarse", "krylov", "rest", "fixed", "total")


def _options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    numbers = command.several(command.count_or_zero)
    command.add_mesh(parser)
    add("--processes", type=numbers, default=[1, 2], help="to measure, 1,2; 0 for none")
    some = [1, 2, 4, 8, 16, 32, 64]
    add("--count", type=numbers, default=some, help="to count, 1,2,4,8,16,32,64; 0 for none")
    add("--predict", type=count, nargs=2, metavar=("DOFS", "PROCESSES"), help="print the model's")
    add("--subdomains", type=count, default=512, help="over all processes, 512")
    layers = {"type": command.some_of(tuple(TYPES)), "default": list(TYPES)}
    add("--layers", **layers, help="1 with all-floating FETI, 2 with classical, 1,2")
    choices = {"type": command.some_of(tuple(CHOICES)), "default": list(CHOICES)}
    add("--choices", **choices, help="the paper's and the package's own, paper,default")


def _cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    """Yield the cases: counted first, for that is quick."""
    if args.predict:
        (kept,) = args.json or [KEPT]
        known = read_records(kept, STUDY.known, "benchmarks.scaling")
        command.say("\n".join(predict(known, *args.predict)), comm)
        return
    _check(args)
    for task, numbers in (("count", args.count), ("measure", args.processes)):
        for choices, layers, processes in itertools.product(args.choices, args.layers, numbers):
            yield {
                "study": "scaling",
                "task": task,
                "geometry": args.geometry,
                "size": args.size,
                "layers": layers,
                "degree": 1,
                "kappa": 100.0,
                "type": TYPES[layers],
                "pc": PC[choices],
                "choices": choices,
                "subdomains": args.subdomains,
                "processes": processes,
            }


def _run(case: Record, keep: Keep, args: Arguments, _comm: MPI.Comm) -> None:
    """Run a case on its processes.

    Raises:
        ConvergenceError: It did not come to its end.
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
    for name in ("processes", "count"):
        setattr(args, name, [n for n in getattr(args, name) if n > 0])
    if max(args.processes, default=0) > cores:
        raise ValueError(
            f"--processes {max(args.processes)}: there are {cores} cores, and shared ones measure "
            "nothing; --count takes any number"
        )
    most = max(*args.processes, *args.count, 0, 0)
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
    for choices in CHOICES:
        for kind in NAMES:
            mine = [r for r in records if (r["choices"], r["type"]) == (choices, kind)]
            mine.sort(key=lambda r: r["processes"])
            tasks = ([r for r in mine if r["task"] == task] for task in ("measure", "count"))
            model = create_model(*tasks)
            if model is None:
                continue
            refined = dofs / model.base["dofs"]
            there, here = (model.predict(P, refined) for P in (first, processes))
            numbers = [getattr(here, part) for part in FORESEEN]
            numbers.append(efficiency(first, there.total, processes, here.total))
            its = sum(model.base["linear_iterations_per_newton"])
            steps = model.base["newton_iterations"]
            yield (
                " ".join(f"{number:8.3g}" for number in numbers)
                + f"  {NAMES[kind]}, {CHOICES[choices]}: {steps} Newton steps, {its} iterations"
            )


@dataclass(frozen=True, slots=True)
class _Series:
    """Cases that differ in their number of processes alone, in rising order, and their model."""

    layers: int
    choices: str
    measured: list[Record]
    counted: list[Record]
    model: Model | None

    def section(self, rows: Sequence[Fields], **fields: object) -> list[dict[str, object]]:
        """Return a section with its names, and what the first case has."""
        first = (self.measured or self.counted)[0]
        return section(rows, **(first | self.names | fields))

    @property
    def refined(self) -> float:
        """The paper's dofs over those of the model's mesh."""
        return paper.DOFS[self.layers] / self.model.base["dofs"]

    @property
    def names(self) -> dict[str, str]:
        """Its names on the page."""
        kind = NAMES[TYPES[self.layers]]
        return {"kind": kind, "chosen": CHOICES[self.choices], "artery": ARTERIES[self.layers]}


def _fields(records: Sequence[Record]) -> Fields:
    every = list(_series(records))
    modelled = [s for s in every if s.model is not None]
    return {
        "cluster": {k: value * UNITS.get(k, 1.0) for k, value in asdict(Machine()).items()},
        "measured": [part for s in every for part in s.section(list(_times(s)))],
        "modelled": [
            part
            for s in modelled
            for part in s.section(list(_model_rows(s)), dofs=paper.DOFS[s.layers])
        ],
        "limits": section(row for s in modelled for row in _limits(s)),
        "weak": section(_weak(s) for s in modelled),
        "once": section(r | s.names | {"s": r["seconds_once"]} for s in every for r in s.measured),
        "reading": section(
            {"P": P, "mb": r["reading_bytes"] / 1e6, "mib": r["reading_mib"], "sent": r["reading"]}
            for P, r in sorted({r["processes"]: r for s in modelled for r in s.counted}.items())
        ),
        "counted": section(
            r | s.names | {"kilobytes": r["setup"]["bytes"]["max"] / 1e3, "grown": grown}
            for s in every
            for r, grown in zip(s.counted, _growth(s.counted, "messages_to_each"), strict=True)
        ),
        "first_processes": paper.FIRST,
    }


def _series(records: Sequence[Record]) -> Iterator[_Series]:
    """Yield the series, the paper's choices first."""
    found = sorted(groups(records, *CASE), key=lambda s: (list(CHOICES).index(s[0][-1]), s[0][-2]))
    for (*_, layers, choices), mine in found:
        mine.sort(key=lambda record: record["processes"])
        tasks = [[r for r in mine if r["task"] == task] for task in ("measure", "count")]
        yield _Series(layers, choices, *tasks, create_model(*tasks))


def _growth(records: Sequence[Record], name: str) -> list[float | None]:
    """Return each record's number over that of the first which has one."""
    numbers = [record.get(name) for record in records]
    first = next((number for number in numbers if number), None)
    return [number / first if number and first else None for number in numbers]


def _times(series: _Series) -> Iterator[dict[str, object]]:
    """Yield seconds and efficiencies of the measured cases, and what the model foresees."""
    for r in series.measured:
        first, P = series.measured[0], int(r["processes"])
        model = series.model.predict(P) if series.model else None
        s, s_1 = ({part: record[f"seconds_{part}"] for part in PARTS} for record in (r, first))
        eff = {part: efficiency(first["processes"], s_1[part], P, s[part]) for part in PARTS}
        foreseen = {part: getattr(model, part) for part in PARTS} if model else {}
        yield {"P": P, "s": s, "eff": eff, "model": foreseen}


def _model_rows(series: _Series) -> Iterator[dict[str, object]]:
    """Yield the model's seconds and efficiencies beside the paper's, of as many dofs."""
    theirs, refined = paper.TIMES[series.layers], series.refined
    first = series.model.predict(paper.FIRST, refined)
    for P in (*theirs, FURTHER):
        foreseen = series.model.predict(P, refined)
        yield {
            "P": P,
            "s": {part: getattr(foreseen, part) for part in (*PARTS, "coarse")},
            "eff": _efficiencies(first, P, foreseen),
            "paper": _efficiencies(theirs[paper.FIRST], P, theirs[P]) if P in theirs else {},
        }


def _efficiencies(first: object, P: int, times: object) -> dict[str, float]:
    """Return the efficiencies of the parts, those of the paper's first number being 1."""
    return {
        part: efficiency(paper.FIRST, getattr(first, part), P, getattr(times, part))
        for part in PARTS
    }


def _limits(series: _Series) -> Iterator[dict[str, object]]:
    """Yield the shares of the parts in all of the time and in the iterations [%]."""
    for P in (max(paper.TIMES[series.layers]), FURTHER):
        foreseen = series.model.predict(P, series.refined)
        parts = {"total": foreseen.shares(), "Krylov": foreseen.shares(KRYLOV)}
        for whole, shares in parts.items():
            percent = {name: 100 * share for name, share in shares.items()}
            yield series.names | {"P": P, "whole": whole, "share": percent}


def _weak(series: _Series) -> dict[str, object]:
    """Return Krylov and coarse set-up on WEAK processes, the paper's dofs on the fewest."""
    dofs, (few, many) = paper.DOFS[series.layers], WEAK
    foreseen = (series.model.predict(P, series.refined * P / few) for P in WEAK)
    t = [p.krylov + p.coarse for p in foreseen]
    dofs_many = dofs * many // few
    return series.names | {
        "few": few,
        "many": many,
        "dofs": dofs,
        "dofs_many": dofs_many,
        "t": t,
        "eff": t[0] / t[1],
    }


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
                curve(ax, [(P, getattr(times, part)) for P, times in theirs], **(style | OPEN))
                series = of_layers.get(layers)
                measured = series.measured if series else []
                points = [(r["processes"], r[f"seconds_{part}"]) for r in measured]
                curve(ax, points, **style, marker="s", ls="")
                if series and series.model:
                    foreseen = [(P, getattr(series.model.predict(P), part)) for P in processes]
                    curve(ax, foreseen, **style)
    return [{"picture": "scaling.png"}]


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="scaling",
    known=lambda record: record.get("study") == "scaling",
    options=_options,
    cases=_cases,
    run=_run,
    fields=_fields,
    draw=_draw,
)

if __name__ == "__main__":
    STUDY.main()
