# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Which records of the comparison belong together, and the better layout of each solver."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

from benchmarks.common.records import Record

__all__ = [
    "GEOMETRIES",
    "NAMES",
    "Case",
    "Group",
    "groups",
    "is_known",
    "layout",
    "seconds",
]

GEOMETRIES = ("tube", "vessel", "block")

#: How the solvers are called on the page, in the order of its tables.
NAMES = {"feti": "FETI", "mumps": "MUMPS", "gamg": "GAMG", "hypre": "BoomerAMG", "bddc": "BDDC"}


@dataclass(frozen=True, slots=True)
class Case:
    """Parameters of a case, as they stand in its records.

    Attributes:
        geometry: Out of :data:`GEOMETRIES`.
        kappa: κ [kPa].
        wanted_dofs: Approximate number.
        wanted_subdomains: Over all processes; None for the package's rule.
        processes: Their number.
        threads: Of each process.
        path_mmhg: Where a load path ends; None for the first Newton step alone.
    """

    geometry: str
    kappa: float
    wanted_dofs: int
    wanted_subdomains: int | None
    processes: int
    threads: int
    path_mmhg: float | None

    def __str__(self) -> str:
        """Name it in a line."""
        path = "first step" if self.path_mmhg is None else f"to {self.path_mmhg:g} mmHg"
        return (
            f"{self.geometry}, κ = {self.kappa:g}, about {self.wanted_dofs} dofs, {path}, "
            f"{self.processes} × {self.threads}"
        )

    def key(self, solver: object) -> Record:
        """Return the parameters by which the record of a solver is found."""
        return {"solver": solver} | asdict(self)


@dataclass(frozen=True, slots=True)
class Group:
    """The records of one body and size, in all layouts.

    Attributes:
        geometry: Of the body.
        kappa: κ [kPa].
        dofs: Their number.
        path_mmhg: End of a load path; None for the first Newton step alone.
        records: All of them.
    """

    geometry: str
    kappa: float
    dofs: int
    path_mmhg: float | None
    records: tuple[Record, ...]

    def of(self, solver: str) -> list[Record]:
        """Return the records of a solver, the better layout first, failures at the end."""
        mine = [record for record in self.records if record["solver"] == solver]
        return sorted(mine, key=lambda r: seconds(r) if r["converged"] else float("inf"))

    def best(self, solver: str) -> Record | None:
        """Return the record of a solver's better layout, if it came to a solution."""
        mine = self.of(solver)
        return mine[0] if mine and mine[0]["converged"] else None


def is_known(record: Record) -> bool:
    """Tell whether a record is one of this study."""
    return {"solver", "geometry", "threads", "path_mmhg"} <= record.keys()


def groups(records: Sequence[Record]) -> Iterator[Group]:
    """Yield the groups, in the order of the page."""
    names = ("geometry", "kappa", "dofs", "path_mmhg")

    def place(key: tuple[str, float, int, float | None]) -> tuple[float, ...]:
        geometry, kappa, dofs, path = key
        return GEOMETRIES.index(geometry), kappa, dofs, path or 0.0

    for key in sorted({tuple(record[name] for name in names) for record in records}, key=place):
        mine = (r for r in records if tuple(r[name] for name in names) == key)
        yield Group(*key, tuple(mine))


def seconds(record: Record) -> float:
    """Return the seconds of set-up and solution."""
    return record["seconds_setup"] + record["seconds_solve"]


def layout(record: Record) -> str:
    """Name processes and threads."""
    processes, threads = record["processes"], record["threads"]
    of_each = "" if threads == 1 else f" × {threads} threads"
    return f"{processes} process{'' if processes == 1 else 'es'}{of_each}"
