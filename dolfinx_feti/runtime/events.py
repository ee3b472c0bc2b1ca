# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""PETSc log events: the phases of the method in the table of ``-log_view``."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from petsc4py import PETSc

#: All events of the package, in the order of a run (docs/petsc_options.md describes them).
EVENTS = (
    "WallRead",
    "WallPartition",
    "WallTags",
    "WallFibres",
    "FETITear",
    "FETITangent",
    "FETIPattern",
    "FETIGluing",
    "FETIFactor",
    "FETISchur",
    "FETIModes",
    "FETICoarse",
    "FETISolve",
    "FETIRecycling",
    "FETIIterations",
    "FETISchurProduct",
    "FETILocalSolve",
    "FETICoarseSolve",
)


@contextmanager
def event(name: str) -> Iterator[None]:
    """Context whose time is logged under a name of :data:`EVENTS`.

    Raises:
        ValueError: There is no event of this name.
    """
    if name not in EVENTS:
        raise ValueError(f"{name} is no event of the package: add it to EVENTS")
    log = PETSc.Log.Event(name)
    log.begin()
    try:
        yield
    finally:
        log.end()


def seconds_of(names: Iterable[str]) -> list[float]:
    """Return the time of each event on this process so far [s], from PETSc's log."""
    return [float(PETSc.Log.Event(name).getPerfInfo()["time"]) for name in names]
