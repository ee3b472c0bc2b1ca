# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tables of the comparison: solvers on a first Newton step, load paths, growth with κ, failures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from benchmarks.common.records import Record
from benchmarks.common.table import Table, count
from benchmarks.speed.groups import NAMES, Group, groups, layout, seconds
from benchmarks.speed.phases import PHASES
from benchmarks.speed.statements import KAPPAS, growth_pairs

__all__ = ["failure_table", "growth_table", "path_table", "phase_table", "solver_tables"]


def solver_tables(records: Sequence[Record]) -> Iterator[Table]:
    """Make a table for each body and κ: what a first Newton step takes with each solver."""
    first_steps = [group for group in groups(records) if group.path_mmhg is None]
    head = ["dofs", "subdomains", "solver", "layout", "set-up [s]", "solve [s]", "iterations"]
    head += ["memory [MiB]", "residual", "FETI's time ÷ its", "FETI's memory ÷ its"]
    for key in dict.fromkeys((group.geometry, group.kappa) for group in first_steps):
        mine = [group for group in first_steps if (group.geometry, group.kappa) == key]
        rows = [row for group in mine for row in _solver_rows(group)]
        yield Table(f"A Newton step: {key[0]}, κ = {key[1]:g} kPa", head, rows)


def _solver_rows(group: Group) -> Iterator[list[str]]:
    feti = group.best("feti")
    for solver, name in NAMES.items():
        for record in group.of(solver):
            row = [count(group.dofs), _subdomains(record), name, _layout(group, record)]
            if not record["converged"]:
                yield [*row, "failed", *["–"] * 6]
                continue
            yield [
                *row,
                *_times(record),
                count(record["iterations"]),
                count(record["peak_mib"]),
                _short(record["relative_residual"]),
                *_ratios(feti, record),
            ]


def path_table(records: Sequence[Record]) -> Table:
    """Make the table of the load paths."""
    rows = []
    for group in groups(records):
        feti = group.best("feti")
        for solver in NAMES if group.path_mmhg is not None else ():
            for record in group.of(solver):
                row = [group.geometry, f"{group.kappa:g}", count(group.dofs)]
                row += [_subdomains(record), f"{group.path_mmhg:g}", NAMES[solver]]
                row += [_layout(group, record), str(record["load_steps"])]
                row += [str(record["newton_iterations"])]
                if not record["converged"]:
                    rows.append([*row, "failed", *["–"] * 7])
                    continue
                later = record["iterations_per_solve"][1:]
                rows.append(
                    [
                        *row,
                        str(record["linear_solves"]),
                        f"{sum(later) / len(later):.1f}" if later else "–",
                        *_times(record),
                        f"{seconds(record):.1f}",
                        _seconds(record["seconds_per_newton"]),
                        *_ratios(feti, record)[:1],
                        f"{record['seconds_assembly']:.1f}",
                    ]
                )
    head = ["body", "κ [kPa]", "dofs", "subdomains", "to [mmHg]", "solver", "layout"]
    head += ["load steps", "Newton steps", "linear solves", "iterations of a solve"]
    head += ["set-up [s]", "solve [s]", "both [s]", "a Newton step [s]", "FETI's time ÷ its"]
    head += ["assembly [s]"]
    note = (
        "One Newton's method, which goes on with FETI's solutions; MUMPS solves the same systems "
        "beside it, with one analysis and a factorisation LDLᵀ for each. Seconds of all linear "
        "solves together, those of Newton's method that end in a shift or a shorter load step "
        "included. *Iterations of a solve* and *a Newton step* are means without the first one. On "
        "the way FETI has a relative tolerance of 1e-4, and Newton's method of 1e-3, at the end "
        "both have 1e-8. The assembly is the same for both, and not in the ratio."
    )
    return Table("Load paths", head, rows, note)


def phase_table(records: Sequence[Record]) -> Table:
    """Make the table of the shares of FETI's time."""
    rows = []
    for group in groups(records):
        for record in group.of("feti"):
            if record["converged"] and "seconds_phases" in record:
                whole, phases = seconds(record), record["seconds_phases"]
                spent = [phases[name] for name in PHASES]
                shares = [part / whole for part in [*spent, whole - sum(spent)]]
                path = "first step" if group.path_mmhg is None else f"to {group.path_mmhg:g} mmHg"
                row = [group.geometry, f"{group.kappa:g}", count(group.dofs), _subdomains(record)]
                row += [path, layout(record), f"{whole:.2f}"]
                rows.append(row + [f"{100.0 * share:.0f}" for share in shares])
    head = ["body", "κ [kPa]", "dofs", "subdomains", "load", "layout", "linear solves [s]"]
    head += [f"{name} [%]" for name in (*PHASES.values(), "rest")]
    note = (
        "Shares of the seconds of set-up and solution, by PETSc's events, those of the slowest "
        "process. The rest is the pattern of the torn matrix, which a first step finds anew, loads "
        "and results that are condensed and extended, Ritz vectors, sums of copies, scalar "
        "products, and waiting."
    )
    return Table("Where FETI's time goes", head, rows, note)


def growth_table(records: Sequence[Record]) -> Table:
    """Make the table of the iterations at both κ."""
    rows = [
        [
            str(pair.low["geometry"]),
            count(pair.low["dofs"]),
            _subdomains(pair.low),
            NAMES[pair.low["solver"]],
            layout(pair.low),
            count(pair.low["iterations"]),
            count(pair.high["iterations"]),
            f"{pair.quotient:.2f}",
        ]
        for pair in growth_pairs(records)
    ]
    head = ["body", "dofs", "subdomains", "solver", "layout"]
    head += [f"κ = {kappa:g} kPa" for kappa in KAPPAS] + ["quotient"]
    note = (
        "Iterations of the first Newton step. The block is clamped on five of its six faces: there "
        "a pressure pattern of a subdomain finds no free surface to escape to, which is the hard "
        "case for κ."
    )
    return Table("How the iterations grow with κ", head, rows, note)


def failure_table(records: Sequence[Record]) -> Table:
    """Make the table of the cases without a solution."""
    rows = [
        [
            str(r["geometry"]),
            f"{r['kappa']:g}",
            count(r["dofs"]),
            "–" if r["path_mmhg"] is None else f"{r['path_mmhg']:g}",
            NAMES[r["solver"]],
            layout(r),
            count(r["free_mib"]),
            str(r["note"]),
        ]
        for group in groups(records)
        for r in group.records
        if not r["converged"]
    ]
    head = ["body", "κ [kPa]", "dofs", "path to [mmHg]", "solver", "layout"]
    head += ["free memory [MiB]", "reason"]
    return Table("Cases without a solution", head, rows)


def _layout(group: Group, record: Record) -> str:
    """Name the layout, in bold if it is the better one of several."""
    several = len(group.of(str(record["solver"]))) > 1
    better = several and record is group.best(str(record["solver"]))
    return f"**{layout(record)}**" if better else layout(record)


def _ratios(feti: Record | None, record: Record) -> list[str]:
    """Return FETI's time and memory over those of a record."""
    if feti is None or record["solver"] == "feti":
        return ["–", "–"]
    time = f"{seconds(feti) / seconds(record):.2f}"
    mine, other = feti["peak_mib"], record["peak_mib"]
    return [time, f"{mine / other:.2f}" if mine and other else "–"]


def _subdomains(record: Record) -> str:
    """Return the number of subdomains of a solver that has some."""
    return str(record["subdomains"]) if record["solver"] in ("feti", "bddc") else "–"


def _times(record: Record) -> list[str]:
    return [_seconds(record["seconds_setup"]), _seconds(record["seconds_solve"])]


def _seconds(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def _short(value: float | None) -> str:
    return "–" if value is None else f"{value:.0e}".replace("e-0", "e-")
