# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The tables of the linear study, the paper's values beside ours."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from benchmarks.common.records import Record
from benchmarks.common.table import Table, count, number, percent
from benchmarks.unit_cube import paper
from benchmarks.unit_cube.checks import error_scale
from benchmarks.unit_cube.groups import (
    PRECONDITIONERS,
    TYPES,
    differs_in,
    group,
    is_papers,
    is_solved,
    order,
    seconds_an_iteration,
)
from benchmarks.unit_cube.growth import growth_tables, jump_table, number_table

__all__ = ["deviations", "solver_table", "tables"]

SOLVERS = {
    "feti_all_floating": "FETI, all-floating, the paper's choices",
    "feti_classical": "FETI, classical, the paper's choices",
    "feti_default": "FETI, defaults",
    "gamg": "GAMG",
    "mumps": "MUMPS",
}

#: Remarks on quadratic elements.
QUADRATIC = {
    "all_floating": (
        "The values of the paper's table are not compared. It gives 53 181 dofs and 77 700 "
        "multipliers on level 1, and 2 908 692 multipliers on level 4. Quadratic elements have the "
        "surface nodes, and so the multipliers, of linear ones on the next level: that is what the "
        "last number is, and on level 1 it makes 84 276. As in the paper, with all subdomains "
        "floating the Dirichlet preconditioner hardly depends on the level; there the identity "
        "gets better with it, and the lumped one is constant, while both get worse here."
    ),
    "classical": (
        "In the paper iterations with the Dirichlet preconditioner are almost constant, and grow "
        "marginally with the others. Here all of them grow as they do with linear elements on the "
        "next level, as theory says."
    ),
}


def tables(records: Sequence[Record]) -> list[Table]:
    """Make all the tables that the records have rows for."""
    solved = [record for record in records if is_solved(record)]
    own = [record for record in solved if is_papers(record)]
    found = [
        *_papers_tables(own),
        _errors(own),
        *growth_tables(solved),
        _choices(solved),
        jump_table(solved),
        number_table(solved),
        _costs(own),
        _refused([record for record in records if not is_solved(record)]),
    ]
    return [table for table in found if table.rows]


def _papers_tables(records: Sequence[Record]) -> Iterator[Table]:
    """Iterations and condition numbers over levels, a table for each degree and type."""
    for degree in (1, 2):
        for kind, name in TYPES.items():
            mine = [r for r in records if (r["degree"], r["type"]) == (degree, kind)]
            rows = []
            for level in _values(mine, "level"):
                by_pc = {r["pc"]: r for r in mine if r["level"] == level}
                any_of = next(iter(by_pc.values()))
                cells = [str(level), count(any_of["dofs_torn"]), count(any_of["multipliers"])]
                for pc in PRECONDITIONERS:
                    cells += _solve(by_pc.get(pc))
                rows.append(cells)
            head = ["level", "torn dofs", "multipliers"]
            head += [f"{pc} {what}" for pc in PRECONDITIONERS for what in ("it.", "κ")]
            more = "; the paper's in brackets" if degree == 1 else ""
            title = f"P{degree}, {name}: iterations and condition numbers{more}"
            yield Table(title, head, rows, QUADRATIC[kind] if degree == 2 else "")


def _solve(record: Record | None) -> list[str]:
    """Return iterations and condition number, the paper's in brackets."""
    if record is None:
        return ["–", "–"]
    its, condition = record["iterations"], record["condition_number"]
    theirs = _papers_solve(record)
    if theirs is None:
        return [str(its), number(condition)]
    return [
        f"{its} ({theirs.iterations})",
        f"{number(condition)} ({theirs.condition_number:.1f}, "
        f"{percent(condition / theirs.condition_number)})",
    ]


def _papers_solve(record: Record) -> paper.Solve | None:
    if record["degree"] != 1:
        return None
    return paper.SOLVES.get((record["type"], record["pc"], record["level"]))


def deviations(records: Sequence[Record]) -> tuple[float, int]:
    """Return the largest deviations from the paper: condition numbers, relative; iterations."""
    pairs = [(r, _papers_solve(r)) for r in records if is_papers(r)]
    both = [(r, theirs) for r, theirs in pairs if theirs is not None]
    condition = [abs(r["condition_number"] / t.condition_number - 1.0) for r, t in both]
    iterations = [abs(r["iterations"] - t.iterations) for r, t in both]
    return max(condition, default=math.nan), max(iterations, default=0)


def _errors(records: Sequence[Record]) -> Table:
    """L2 errors and their order (eq. 54), which no preconditioner changes."""
    scale = error_scale(records)
    rows = []
    for degree in (1, 2):
        errors = {(r["type"], r["level"]): r["l2_error"] for r in records if r["degree"] == degree}
        for kind, level in sorted(errors):
            error, coarser = errors[kind, level], errors.get((kind, level - 1))
            order = "–" if coarser is None else f"{math.log2(coarser / error):.2f}"
            theirs = paper.L2_ERRORS[kind, level] if degree == 1 else None
            cells = [f"P{degree}", TYPES[kind], str(level), f"{error:.3e}", order]
            cells += ["–"] * 2 if theirs is None else _scaled(theirs, scale * error)
            rows.append(cells)
    head = ["elements", "type", "level", "L2 error", "eoc", "the paper's", "ours, scaled"]
    return Table("L2 errors and the estimated order of convergence", head, rows)


def _scaled(theirs: float, ours: float) -> list[str]:
    return [f"{theirs:.2e}", percent(ours / theirs)]


def _choices(records: Sequence[Record]) -> Table:
    """What else differs from the paper's parameters, on its cube."""
    names = ("scaling", "coarse_q", "gluing", "coarse_modes", "reorthogonalize")
    mine = [r for r in records if differs_in(r, names)]
    groups = {group(r, *names) for r in mine if not is_papers(r)}
    mine = [r for r in mine if group(r, *names) in groups]
    rows = [
        [
            f"P{r['degree']}",
            TYPES[r["type"]],
            str(r["level"]),
            r["pc"],
            *(str(r[name]) for name in names[:-1]),
            "yes" if r["reorthogonalize"] else "no",
            count(r["multipliers"]),
            str(r["iterations"]),
            number(r["condition_number"]),
            number(r["lambda_min"]),
            number(r["lambda_max"]),
        ]
        for r in sorted(mine, key=lambda r: (*order(r), *(str(r[name]) for name in names)))
    ]
    head = ["elements", "type", "level", "preconditioner", "scaling", "Q", "gluing", "soft modes"]
    head += ["reorthogonalized", "multipliers", "it.", "κ", "λ_min", "λ_max"]
    return Table("Other choices than the paper's", head, rows)


def _costs(records: Sequence[Record]) -> Table:
    """Processor time, which other work on the machine changes little, and memory."""
    rows = [
        [
            f"P{r['degree']}",
            TYPES[r["type"]],
            str(r["level"]),
            r["pc"],
            r["interior_is"],
            f"{r['cpu_seconds_setup']:.2f}",
            f"{r['cpu_seconds_solve']:.2f}",
            f"{r['cpu_seconds_solve'] / r['iterations']:.3f}",
            f"{r['processes'] * r['seconds_streaming']:.3f}",
            count(r["peak_mib"]),
            count(r["estimated_mib"]),
        ]
        for r in sorted(records, key=order)
    ]
    head = ["elements", "type", "level", "preconditioner", "interior", "set-up [s]", "solve [s]"]
    head += ["an iteration [s]", "to read [s]", "peak [MiB]", "estimated [MiB]"]
    note = (
        "Seconds are of the processor, all processes together. *To read* is what streaming the "
        "factors of an iteration through memory takes at the bandwidth that the run measured."
    )
    return Table("Time and memory", head, rows, note)


def solver_table(records: Sequence[Record]) -> Table:
    """FETI beside solvers of the assembled matrix."""
    rows = [
        [
            str(r["level"]),
            SOLVERS[r["solver"]],
            count(r["dofs"]),
            str(r["processes"]),
            *_effort(r),
            count(r["peak_mib"]),
            number(r.get("relative_residual")),
        ]
        for r in sorted(records, key=lambda r: (r["level"], r["processes"]))
    ]
    head = ["level", "solver", "dofs", "processes", "it.", "set-up [s]", "solve [s]"]
    head += ["an iteration [s]", "to read [s]", "peak [MiB]", "residual"]
    note = (
        "P1, 512 subdomains, Dirichlet preconditioner; seconds of the clock, the residual of the "
        "assembled system reduced by 1e-8. *Solve* goes from the condensation of the load to the "
        "displacement, *an iteration* without them. Peaks are above what mesh and forms take."
    )
    return Table("FETI, MUMPS and GAMG on the same problem", head, rows, note)


def _effort(r: Record) -> list[str]:
    """Return iterations and seconds, or what was missing."""
    if r["converged_reason"] < 0:
        return [f"needs {count(r.get('estimated_mib'))} MiB", *["–"] * 4]
    its, streaming = r["iterations"], r.get("seconds_streaming")
    seconds = [f"{r['seconds_setup']:.2f}", f"{r['seconds_solve']:.2f}"]
    return [str(its), *seconds, f"{seconds_an_iteration(r):.3f}", number(streaming)]


def _refused(records: Sequence[Record]) -> Table:
    """Cases without results, and why."""
    rows = [
        [
            f"P{r['degree']}",
            TYPES[r["type"]],
            str(r["level"]),
            f"{r['subdomains_per_edge']}³",
            r["pc"],
            "did not converge" if "failure" in r else "does not fit",
            count(r.get("estimated_mib")),
            count(r.get("available_mib")),
        ]
        for r in sorted(records, key=order)
    ]
    head = ["elements", "type", "level", "subdomains", "preconditioner", "why"]
    head += ["needs about [MiB]", "allowed [MiB]"]
    note = "Estimated before any work, from symbolic factorisations; what will not fit is refused."
    return Table("Cases without results", head, rows, note)


def _values(records: Sequence[Record], name: str) -> list[int]:
    return sorted({record[name] for record in records})
