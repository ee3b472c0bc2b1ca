# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The page of the comparison: time and memory of FETI and other solvers on the same matrices.

    python3 -m benchmarks.compare.page build/speed.json --output build/results

writes ``speed.md``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from benchmarks.common.pages import Fields, groups, section, write_page
from benchmarks.common.records import Record
from benchmarks.compare.path import PHASES
from benchmarks.compare.run import GEOMETRIES, is_known

__all__ = ["main"]

#: How the solvers are called, in the order of the tables.
NAMES = {"feti": "FETI", "mumps": "MUMPS", "gamg": "GAMG", "hypre": "BoomerAMG", "bddc": "BDDC"}

#: Volume stiffness at the ends of the comparison [kPa].
KAPPAS = (10.0, 1000.0)

#: What the iterations may grow by from the lesser κ to the larger one.
GROWTH = 1.3


@dataclass(frozen=True, slots=True)
class _Group:
    """The records of one body and size, in all layouts; of a load path if ``mmhg`` is its end."""

    geometry: str
    kappa: float
    dofs: int
    mmhg: float | None
    records: list[Record]

    def of_solver(self, solver: str) -> list[Record]:
        """Return the records of a solver, the better layout first, failures at the end."""
        mine = [record for record in self.records if record["solver"] == solver]
        return sorted(mine, key=lambda r: _seconds(r) if r["converged"] else float("inf"))

    def best(self, solver: str) -> Record | None:
        """Return the record of a solver's better layout, if it came to a solution."""
        mine = self.of_solver(solver)
        return mine[0] if mine and mine[0]["converged"] else None

    def rows(self) -> Iterator[dict[str, object]]:
        """Yield a row for each record, with FETI's better layout over it."""
        feti = self.best("feti")
        for solver in NAMES:
            mine = self.of_solver(solver)
            for record in mine:
                row = _row(record)
                if len(mine) > 1 and record is self.best(solver):
                    row["layout"] = f"**{row['layout']}**"
                if feti and record["converged"] and solver != "feti":
                    row |= _ratios(feti, record)
                yield row


def _fields(records: Sequence[Record]) -> Fields:
    sorted_groups = _groups(records)
    first = [group for group in sorted_groups if group.mmhg is None]
    paths = [group for group in sorted_groups if group.mmhg is not None]
    steps = [
        {"geometry": mine[0].geometry, "kappa": mine[0].kappa}
        | {"rows": [row for group in mine for row in group.rows()]}
        for mine in _by_kappa(first)
    ]
    phases = [
        _row(r) | _shares(r)
        for group in sorted_groups
        for r in group.of_solver("feti")
        if r["converged"] and "seconds_phases" in r
    ]
    lost = [_row(r) for group in sorted_groups for r in group.records if not r["converged"]]
    return {
        "steps": steps,
        "paths": section(row for group in paths for row in group.rows()),
        "phases": section(phases),
        "growth": section(_growth(first), low=KAPPAS[0], high=KAPPAS[1], bound=GROWTH),
        "failures": section(lost),
    }


def _groups(records: Sequence[Record]) -> list[_Group]:
    names = ("geometry", "kappa", "dofs", "path_mmhg")
    found = [_Group(*key, mine) for key, mine in groups(records, *names)]
    return sorted(found, key=lambda g: (GEOMETRIES.index(g.geometry), g.kappa, g.dofs, g.mmhg or 0))


def _by_kappa(found: Sequence[_Group]) -> list[list[_Group]]:
    """Collect the sizes of each body and κ."""
    keys = dict.fromkeys((group.geometry, group.kappa) for group in found)
    return [[group for group in found if (group.geometry, group.kappa) == key] for key in keys]


def _row(record: Record) -> dict[str, object]:
    """Return a record with names, layout and means; without results if it has failed."""
    row = dict(record) | {"name": NAMES[str(record["solver"])], "layout": _layout(record)}
    path = record["path_mmhg"]
    row["load"] = "first step" if path is None else f"to {path:g} mmHg"
    if record["solver"] not in ("feti", "bddc"):
        row["subdomains"] = None
    if not record["converged"]:
        results = ("seconds_solve", "iterations", "peak_mib", "relative_residual")
        results += ("linear_solves", "seconds_per_newton", "seconds_assembly")
        return row | dict.fromkeys(results) | {"seconds_setup": None, "setup": "failed"}
    row |= {"seconds": _seconds(record), "setup": f"{record['seconds_setup']:.2f}"}
    later = record.get("iterations_per_solve", [])[1:]
    return row | {"later": sum(later) / len(later) if later else None}


def _ratios(feti: Record, other: Record) -> dict[str, object]:
    """Return FETI's time and memory over those of another solver."""
    mine, its = feti["peak_mib"], other["peak_mib"]
    memory = mine / its if mine and its else None
    return {"time_ratio": _seconds(feti) / _seconds(other), "memory_ratio": memory}


def _growth(first: Sequence[_Group]) -> Iterator[dict[str, object]]:
    """Pair the records of iterative solvers at both κ, for one solver, size and layout."""
    names = ("solver", "geometry", "dofs", "wanted_subdomains", "processes", "threads")
    found = [r for group in first for solver in NAMES for r in group.of_solver(solver)]
    iterative = [r for r in found if r["solver"] != "mumps" and r["converged"]]
    iterative.sort(key=lambda r: r["kappa"])
    for _, (low, *rest) in groups([r for r in iterative if r["kappa"] in KAPPAS], *names):
        for high in rest:
            quotient = high["iterations"] / low["iterations"]
            bounded = low["geometry"] == "block" and low["solver"] == "feti"
            met = ("yes" if quotient <= GROWTH else "**no**") if bounded else None
            its = {"low_its": low["iterations"], "high_its": high["iterations"]}
            yield _row(low) | its | {"quotient": quotient, "met": met}


def _shares(record: Record) -> dict[str, object]:
    """Return the shares of the phases in the time of a FETI solve, and the rest."""
    spent = record["seconds_phases"]
    shares = {name: 100 * spent[name] / _seconds(record) for name in PHASES}
    return shares | {"rest": 100 - sum(shares.values())}


def _seconds(record: Record) -> float:
    """Return the seconds of set-up and solution."""
    return record["seconds_setup"] + record["seconds_solve"]


def _layout(record: Record) -> str:
    """Name processes and threads."""
    processes, threads = record["processes"], record["threads"]
    of_each = "" if threads == 1 else f" × {threads} threads"
    return f"{processes} process{'' if processes == 1 else 'es'}{of_each}"


main = partial(write_page, __file__, "speed", known=is_known, fields=_fields)

if __name__ == "__main__":
    main()
