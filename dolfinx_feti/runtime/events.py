# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Log events: the phases of the method as ``-log_view`` shows them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from petsc4py import PETSc


@contextmanager
def event(name: str) -> Iterator[None]:
    """Time a phase of the method under a name, such as ``FETIFactor``."""
    log = PETSc.Log.Event(name)
    log.begin()
    try:
        yield
    finally:
        log.end()


def seconds_of(names: Iterable[str]) -> list[float]:
    """Return what PETSc's log has counted for each event on this process so far [s]."""
    return [float(PETSc.Log.Event(name).getPerfInfo()["time"]) for name in names]
