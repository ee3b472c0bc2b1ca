# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Where FETI's seconds go, by the events that PETSc's ``-log_view`` shows."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from benchmarks.common.records import Record
from dolfinx_feti.events import seconds_of

__all__ = ["PHASES", "Phases"]

#: Events that do not overlap, in the order of the method, and what they are called on the page.
PHASES = {
    "FETIGluing": "gluing",
    "FETISchur": "S and factors of K_II",
    "FETIModes": "K_ρ and modes",
    "FETICoarse": "coarse set-up",
    "FETISchurProduct": "products S p",
    "FETILocalSolve": "solves with K_ρ",
    "FETICoarseSolve": "coarse solves",
}


class Phases:
    """Seconds of the phases since the beginning."""

    def __init__(self, comm: MPI.Comm) -> None:
        """Begin; PETSc's logging is begun if it is not.

        Args:
            comm: Of the solver.
        """
        PETSc.Log.begin()
        self._comm = comm
        self._begun = np.array(seconds_of(PHASES))

    def record(self) -> Record:
        """Return the seconds of each phase, those of the slowest process.

        Note:
            Collective.
        """
        spent = np.array(seconds_of(PHASES)) - self._begun
        slowest = np.empty_like(spent)
        self._comm.Allreduce(spent, slowest, op=MPI.MAX)
        return {"seconds_phases": dict(zip(PHASES, slowest.tolist(), strict=True))}
