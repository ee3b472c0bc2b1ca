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
from benchmarks.common.walls.first_step import TYPES as TYPE_NAMES
from dolfinx_feti import ConvergenceError
from dolfinx_feti.meshes.arguments import count

#: Variant by layers of the wall: the paper's aorta, its carotid artery.
TYPES_OF_LAYERS = {1: "all_floating", 2: "classical"}

#: Environment that lets Open MPI put several processes on a core; MPICH always does.
SHARED_CORES = {
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    "OMPI_MCA_mpi_yield_when_idle": "1",
}

#: Beginnings of the variables of a process that MPI has started; another mpirun must not see them.
INHERITED = ("PMI_", "PMIX_", "PRTE_", "OMPI_COMM_WORLD_", "OMPI_FILE_", "OMPI_UNIVERSE_")

#: Records of the page, which ``--predict`` reads without ``--json``.
RECORDS = Path(__file__).parents[1] / "docs/results/scaling.json"

#: Preconditioner of each choice.
PC = {"paper": "lumped", "default": "dirichlet"}

#: Keys of a series: cases that differ only in their number of processes.
SERIES = ("geometry", "size", "subdomains", "layers", "choices")

#: Numbers of processes in weak scaling, with the same number of dofs on each.
WEAK = (512, 10_000)

#: Parts of the time that the page shows.
SHOWN = ("local", "krylov", "total")

#: The model's cluster in the units of the page: µs, GB/s and Gflop/s.
CLUSTER = {
    "latency": 1e6 * model.LATENCY,
    "node": model.NODE,
    "bus": model.BUS,
    "bandwidth": 1e-9 * model.BANDWIDTH,
    "stream": 1e-9 * model.STREAM,
    "rate": 1e-9 * model.RATE,
    "disk": 1e-9 * model.DISK,
}

#: Curve of each part.
STYLES = {"local": {"color": COLOURS[2]}, "krylov": {"color": COLOURS[0]}, "total": {"color": "k"}}

#: Number of processes that the model predicts, beyond the paper's.
FURTHER = 10_000

#: Columns of a prediction.
PREDICTED = ("reading", "local", "coarse", "krylov", "rest", "fixed", "total")


def _options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    numbers = command.several(count)
    command.add_mesh(parser)
    command.add_choices(parser, "--task", ("count", "measure"))
    add("--processes", type=numbers, default=[1, 2], help="to measure, 1,2")
    add(
        "--count", type=numbers, default=[1, 2, 4, 8, 16, 32, 64], help="to count, 1,2,4,8,16,32,64"
    )
    add("--predict", type=count, nargs=2, metavar=("DOFS", "PROCESSES"), help="print the model's")
    add("--subdomains", type=count, default=512, help="over all processes, 512")
    command.add_choices(parser, "--layers", tuple(TYPES_OF_LAYERS))
    command.add_choices(parser, "--choices", tuple(CHOICES))


def _cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    """Yield the cases; counted ones come first, as they are quick.

    With ``--predict`` it prints the prediction, and yields none.
    """
    if args.predict:
        (path,) = args.json or [RECORDS]
        records = read_records(path, STUDY.known, STUDY.page)
        command.say("\n".join(predict(records, *args.predict)), comm)
        return
    _check(args)
    shared = {name: getattr(args, name) for name in ("geometry", "size", "subdomains")}
    shared |= {"study": "scaling", "degree": 1, "kappa": 100.0}
    for task in args.task:
        numbers = args.choices, args.layers, _processes(args, task)
        for choices, layers, processes in itertools.product(*numbers):
            case = {"task": task, "layers": layers, "choices": choices, "processes": processes}
            yield shared | case | {"type": TYPES_OF_LAYERS[layers], "pc": PC[choices]}


def _processes(args: Arguments, task: str) -> Sequence[int]:
    """Return the numbers of processes of a task."""
    return args.count if task == "count" else args.processes


def _run(case: Record, keep: Keep, args: Arguments, _comm: MPI.Comm) -> None:
    """Run a case as a separate program, and keep its record.

    Raises:
        ConvergenceError: The program failed; the message has the end of its output.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "record.json"
        workers_case = json.dumps(case | {"folder": str(args.folder)})
        words = ["mpirun", "-n", str(case["processes"]), "env", "OMP_NUM_THREADS=1"]
        environment = {k: v for k, v in os.environ.items() if not k.startswith(INHERITED)}
        if case["task"] == "count":
            words += [f"LD_PRELOAD={compile_library(args.folder)}"]
            environment |= SHARED_CORES
        words += [sys.executable, "-m", "benchmarks.common.scaling.worker"]
        words += [workers_case, str(file)]
        run = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
        if run.returncode != 0 or not file.is_file():
            end_of_output = (run.stderr or run.stdout).strip()[-2000:]
            raise ConvergenceError(f"exit status {run.returncode}:\n{end_of_output}")
        keep({}, json.loads(file.read_text()))


def _check(args: Arguments) -> None:
    """Check that the cases can be run here.

    Raises:
        ValueError: They cannot.
    """
    cores = len(os.sched_getaffinity(0))
    if MPI.COMM_WORLD.size > 1:
        raise ValueError("it starts mpirun itself: run it as python3 -m benchmarks.scaling")
    if "measure" in args.task and max(args.processes) > cores:
        raise ValueError(
            f"--processes {max(args.processes)}: there are {cores} cores, and shared ones measure "
            "nothing; --count takes any number"
        )
    largest = max(P for task in args.task for P in _processes(args, task))
    if largest > args.subdomains:
        raise ValueError(
            f"{largest} processes need as many --subdomains, and there are {args.subdomains}"
        )
    if shutil.which("mpirun") is None:
        raise ValueError("mpirun is missing")


def predict(records: Sequence[Record], dofs: int, processes: int) -> Iterator[str]:
    """Yield the lines of a table: predicted seconds of a load step, for each measured series.

    Args:
        records: Records of the study.
        dofs: Dofs of the predicted mesh.
        processes: Number of processes.
    """
    first = min(paper.FIRST, processes)
    yield f"A load step of {dofs} dofs on {processes} processes, modelled [s]:"
    yield " ".join(f"{name:>8}" for name in (*PREDICTED, "eff")) + f"  (eff: against {first})"
    for series in filter(lambda s: s.model, _series(records)):
        base = series.model.base
        names = series.names
        refined = dofs / base["dofs"]
        on_first = series.model.predict(first, refined)
        predicted = series.model.predict(processes, refined)
        numbers = [predicted[part] for part in PREDICTED]
        numbers.append(efficiency(first, on_first["total"], processes, predicted["total"]))
        iterations = sum(base["linear_iterations_per_newton"])
        steps = base["newton_iterations"]
        case = f"{names['kind']}, {names['chosen']}: {steps} Newton steps, {iterations} iterations"
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
        kind = TYPE_NAMES[TYPES_OF_LAYERS[self.layers]]
        return {"kind": kind, "chosen": CHOICES[self.choices], "artery": ARTERIES[self.layers]}


def _fields(records: Sequence[Record]) -> Fields:
    """Return the sections of the page."""
    all_series = list(_series(records))
    modelled = [s for s in all_series if s.model is not None]
    counted = {r["processes"]: r for s in modelled for r in s.counted}
    return {
        "cluster": CLUSTER,
        "measured": [part for s in all_series for part in s.section(_measured_rows(s))],
        "modelled": [part for s in modelled for part in s.section(_model_rows(s), dofs=s.dofs)],
        "limits": section(row for s in modelled for row in _limit_rows(s)),
        "weak": section(_weak_row(s) for s in modelled),
        "once": section(
            record | s.names | {"s": record["seconds_once"]}
            for s in all_series
            for record in s.measured
        ),
        "reading": section(
            {"P": P, "mb": r["reading_bytes"] / 1e6, "mib": r["reading_mib"], "sent": r["reading"]}
            for P, r in sorted(counted.items())
        ),
        "counted": section(row for s in all_series for row in _counted_rows(s)),
        "first_processes": paper.FIRST,
    }


def _series(records: Sequence[Record]) -> Iterator[_Series]:
    """Yield the series, the paper's choices first."""
    order = list(CHOICES)
    by_keys = sorted(
        groups(records, *SERIES), key=lambda item: (order.index(item[0][-1]), item[0][-2])
    )
    for (*_, layers, choices), of_series in by_keys:
        of_series.sort(key=lambda record: record["processes"])
        measured = [record for record in of_series if record["task"] == "measure"]
        counted = [record for record in of_series if record["task"] == "count"]
        yield _Series(layers, choices, measured, counted, create_model(measured, counted))


def _counted_rows(series: _Series) -> Iterator[Record]:
    """Yield the counted cases, with the growth of messages to each from the first case."""
    first = next((r["messages_to_each"] for r in series.counted if r["messages_to_each"]), None)
    for record in series.counted:
        to_each = record["messages_to_each"]
        yield (
            record
            | series.names
            | {
                "kilobytes": record["setup"]["bytes"]["max"] / 1e3,
                "grown": to_each / first if to_each and first else None,
            }
        )


def _measured_rows(series: _Series) -> Iterator[dict[str, object]]:
    """Yield seconds and efficiencies of the measured cases, and the seconds of the model."""
    times = [{part: record[f"seconds_{part}"] for part in SHOWN} for record in series.measured]
    first = series.measured[0]["processes"] if series.measured else 0
    for record, seconds in zip(series.measured, times, strict=True):
        P = record["processes"]
        yield {
            "P": P,
            "s": seconds,
            "eff": _efficiencies(first, times[0], P, seconds),
            "model": series.model.predict(P) if series.model else {},
        }


def _model_rows(series: _Series) -> Iterator[dict[str, object]]:
    """Yield the model's seconds and efficiencies on the paper's mesh, and the paper's."""
    first = paper.FIRST
    papers = paper.TIMES[series.layers]
    on_first = series.model.predict(first, series.refined)
    for P in (*papers, FURTHER):
        seconds = series.model.predict(P, series.refined)
        printed = _efficiencies(first, papers[first], P, papers[P]) if P in papers else {}
        yield {
            "P": P,
            "s": seconds,
            "eff": _efficiencies(first, on_first, P, seconds),
            "paper": printed,
        }


def _efficiencies(
    first: int, on_first: Mapping[str, float], P: int, seconds: Mapping[str, float]
) -> dict[str, float]:
    """Return the parallel efficiency of each part in SHOWN.

    Args:
        first: Number of processes that the efficiency refers to.
        on_first: Seconds of each part on these.
        P: Number of processes.
        seconds: Seconds of each part on P processes.
    """
    return {part: efficiency(first, on_first[part], P, seconds[part]) for part in SHOWN}


def _limit_rows(series: _Series) -> Iterator[dict[str, object]]:
    """Yield the shares of the parts in the total time, and in that of the Krylov method [%]."""
    for P in (max(paper.TIMES[series.layers]), FURTHER):
        predicted = series.model.predict(P, series.refined)
        for whole, parts in {"total": model.PARTS, "Krylov": model.KRYLOV}.items():
            sum_of_parts = sum(predicted[part] for part in parts)
            percent = {part: 100 * predicted[part] / sum_of_parts for part in parts}
            yield series.names | {"P": P, "whole": whole, "share": percent}


def _weak_row(series: _Series) -> dict[str, object]:
    """Return seconds of Krylov method and coarse set-up on the two numbers of processes WEAK.

    The fewer processes have the dofs of the paper's mesh.
    """
    dofs = series.dofs
    few, many = WEAK
    predicted = (series.model.predict(P, series.refined * P / few) for P in WEAK)
    t = [seconds["krylov"] + seconds["coarse"] for seconds in predicted]
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
        for ax, (layers, kind) in zip(axes[0], TYPES_OF_LAYERS.items(), strict=True):
            ax.set(title=f"{TYPE_NAMES[kind]}; the paper's {ARTERIES[layers]}", xlabel="processes")
            ax.set_yscale("log")
            ax.set_xscale("log", base=2)
            for part, style in STYLES.items():
                printed = [(P, times[part]) for P, times in paper.TIMES[layers].items()]
                curve(ax, printed, **(style | OPEN))
                series = of_layers.get(layers)
                measured = series.measured if series else []
                points = [(r["processes"], r[f"seconds_{part}"]) for r in measured]
                curve(ax, points, **style, marker="s", ls="")
                if series and series.model:
                    predicted = [(P, series.model.predict(P)[part]) for P in processes]
                    curve(ax, predicted, **style)
    return [{"picture": "scaling.png"}]


def _is_known(record: Record) -> bool:
    """Return True if a record is one of this study."""
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
