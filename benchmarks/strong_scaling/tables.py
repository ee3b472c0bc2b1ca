# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tables of the scaling study: seconds and efficiencies, counts, balance, and the model's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from benchmarks.common.records import Record
from benchmarks.common.table import Table, count, number
from benchmarks.strong_scaling import paper
from benchmarks.strong_scaling.groups import ARTERIES, CHOICES, TYPES, Series, series
from benchmarks.strong_scaling.model import (
    KRYLOV,
    LIFT,
    Model,
    Prediction,
    create_model,
    efficiency,
)

__all__ = ["balance_table", "count_tables", "limit_table", "model_tables", "time_tables"]

PARTS = ("local", "krylov", "total")

#: Processes that the model is asked for, beyond the paper's.
FURTHER = (10_000,)

#: Parts whose share in the time is too small to be named.
SMALL = 0.05


def time_tables(records: Sequence[Record]) -> Iterator[Table]:
    """Make a table of measured seconds for each series, the paper's columns."""
    for of_one in series(records):
        if of_one.measured:
            yield _time_table(of_one)


def _time_table(of_one: Series) -> Table:
    first, model = of_one.measured[0], create_model(of_one.measured, of_one.counted)
    rows = []
    for r in of_one.measured:
        row = [str(r["processes"])]
        for part in PARTS:
            seconds = f"seconds_{part}"
            eff = efficiency(first["processes"], first[seconds], r["processes"], r[seconds])
            row += [f"{r[seconds]:.2f}", f"{eff:.3f}"]
        if model is not None:
            foreseen = model.predict(r["processes"])
            row += [f"{getattr(foreseen, part):.2f}" for part in PARTS]
        rows.append(row)
    head = ["P", "local [s]", "eff", "Krylov [s]", "eff", "total [s]", "eff"]
    if model is not None:
        head += ["model: local [s]", "Krylov [s]", "total [s]"]
    note = (
        f"{count(first['dofs'])} dofs, {count(first['multipliers'])} multipliers, "
        f"{count(first['coarse_size'])} coarse unknowns, {first['newton_iterations']} Newton steps "
        f"of {first['linear_iterations_mean']:.0f} iterations on average. The model begins with "
        "the first row."
    )
    return Table(f"Measured: {of_one.title}", head, rows, note)


def count_tables(records: Sequence[Record]) -> Iterator[Table]:
    """Make a table of counts for each series."""
    for of_one in series(records):
        rows = [
            [
                str(r["processes"]),
                number(r["neighbours"]),
                *_two(r["iteration"]["messages"]),
                *_two(r["iteration"]["bytes"]),
                number(r["iteration"]["reductions"]["max"]),
                number(r["coarse_solves"]),
                *_two(r["setup"]["messages"]),
                number(r["setup"]["bytes"]["max"] / 1e3),
                number(r["setup"]["reductions"]["max"]),
            ]
            for r in of_one.counted
        ]
        if rows:
            head = ["P", "neighbours, most", "messages, mean", "most"]
            head += ["bytes, mean", "most", "reductions", "coarse solves"]
            head += ["set-up: messages, mean", "most", "kB, most", "reductions"]
            form = of_one.counted[-1]["formulation"]
            note = (
                f"{form.capitalize()} form; sent by a process in an iteration, and in the first "
                "set-up. A reduction is any collective call on all processes."
            )
            yield Table(f"Counted: {of_one.title}", head, rows, note)


def balance_table(records: Sequence[Record]) -> Table:
    """Make the table of the most over the mean."""
    counted = [(of_one, r) for of_one in series(records) for r in of_one.counted]
    names = list(counted[0][1]["balance"]) if counted else []
    rows = [
        [
            TYPES[of_one.layers].replace("_", "-"),
            CHOICES[of_one.choices],
            str(r["processes"]),
            *(f"{r['balance'][name]:.2f}" for name in names),
        ]
        for of_one, r in counted
        if r["processes"] > 1
    ]
    note = "The largest process over the mean; flops are PETSc's and MUMPS's, not numpy's."
    return Table("Balance", ["type", "choices", "P", *names], rows, note)


def model_tables(records: Sequence[Record]) -> Iterator[Table]:
    """Make tables of the model's seconds and efficiencies beside the paper's.

    Two for each series: for the mesh that was measured, and for one with the paper's dofs.
    """
    for of_one in series(records):
        model = create_model(of_one.measured, of_one.counted)
        if model is not None:
            for dofs in (model.base["dofs"], paper.DOFS[of_one.layers]):
                yield _model_table(of_one, model, dofs)


def _model_table(of_one: Series, model: Model, dofs: int) -> Table:
    theirs, refined = paper.TIMES[of_one.layers], dofs / model.base["dofs"]
    first = model.predict(paper.FIRST, refined)
    rows = []
    for P in (*theirs, *FURTHER):
        foreseen = model.predict(P, refined)
        parts = (*PARTS[:2], "coarse", PARTS[2])
        row = [count(P), *(number(getattr(foreseen, part)) for part in parts)]
        for part in PARTS:
            of_first, here = getattr(first, part), getattr(foreseen, part)
            ours = efficiency(paper.FIRST, of_first, P, here)
            row += [f"{ours:.3f}", _papers(theirs, P, part)]
        rows.append(row)
    head = ["P", "local [s]", "Krylov [s]", "coarse [s]", "total [s]"]
    for name in ("local", "Krylov", "total"):
        head += [f"eff {name}", "the paper's"]
    mesh = "the measured mesh" if refined == 1.0 else "as many dofs as the paper's mesh"
    note = (
        f"{count(dofs)} dofs, {mesh}. Efficiencies refer to {paper.FIRST} processes; the paper's "
        f"are those of its {ARTERIES[of_one.layers]}."
    )
    return Table(f"Modelled, {count(dofs)} dofs: {of_one.title}", head, rows, note)


def _papers(theirs: dict[int, paper.Times], processes: int, part: str) -> str:
    """Return the paper's efficiency."""
    if processes not in theirs:
        return "–"
    seconds = getattr(theirs[processes], part)
    first = getattr(theirs[paper.FIRST], part)
    return f"{efficiency(paper.FIRST, first, processes, seconds):.3f}"


def limit_table(records: Sequence[Record]) -> Table:
    """Make the table of what takes the time on many processes, and what would lift it."""
    rows = []
    for of_one in series(records):
        model = create_model(of_one.measured, of_one.counted)
        if model is None:
            continue
        name = [TYPES[of_one.layers].replace("_", "-"), CHOICES[of_one.choices]]
        for dofs in (model.base["dofs"], paper.DOFS[of_one.layers]):
            for P in (max(paper.TIMES[of_one.layers]), *FURTHER):
                foreseen = model.predict(P, dofs / model.base["dofs"])
                rows += [[*name, count(dofs), *row] for row in _limits(foreseen)]
    head = ["type", "choices", "dofs", "P", "of", "what takes the time", "share"]
    head.append("what would lift it")
    note = f"The model's parts with a share above {100 * SMALL:.0f} %."
    return Table("What limits it", head, rows, note)


def _limits(foreseen: Prediction) -> Iterator[list[str]]:
    """Yield the parts that take the time of all and of the iterations, the greatest first."""
    for of, shares in (("total", foreseen.shares()), ("Krylov", foreseen.shares(KRYLOV))):
        for name, share in shares.items():
            if share > SMALL:
                what, lift = LIFT[name]
                yield [count(foreseen.processes), of, what, f"{100 * share:.0f} %", lift]


def _two(value: dict[str, float]) -> list[str]:
    return [number(value["mean"]), number(value["max"])]
