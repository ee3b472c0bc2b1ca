# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The coarse problem with as many subdomains on each process: what it takes of a process's memory.

The paper's cube, of subcubes of one cell, 2048 on each process: on 2 processes there are 4096, on
16 there are 32 768. All-floating, Q = I, so that there are six coarse unknowns a subdomain.
"""

from __future__ import annotations

from unittest import mock

from mpi4py import MPI

from benchmarks.common.cube import create_problem, tear
from benchmarks.common.machine import PeakMemory
from benchmarks.common.records import Record
from dolfinx_feti.feti.dual.coarse import Coarse

__all__ = ["EACH", "coarse_problem"]

#: Subdomains of a process.
EACH = 2048

#: Where the unit force is whose displacement holds the cube all round.
SOURCE = (2.0, 2.0, 2.0)

OPTIONS = {
    "feti_type": "all_floating",
    "feti_formulation": "dual",
    "feti_coarse_q": "identity",
    "feti_coarse_modes": 0,
}

FORM = Coarse.__init__


def coarse_problem(case: Record, comm: MPI.Comm) -> Record:
    """Set the cube up; record memory of the coarse problem, most and mean of a process. Collective.

    It is the most that is held while G, N and the solver are formed, above what is held before.
    """
    edge = round(case["subdomains"] ** (1.0 / 3.0))
    cube = create_problem(comm, subdomains=edge, cells=1, degree=1, source=SOURCE)
    linear = tear(cube, OPTIONS)
    linear.linear_system()
    held: list[float] = []

    def form(*args: object, **named: object) -> None:
        peak = PeakMemory()
        FORM(*args, **named)
        held.append(peak.mib_above_start(MPI.COMM_SELF))

    with mock.patch.object(Coarse, "__init__", form):
        linear.solver.setUp()
    report = linear.solver.getPythonContext().report()
    return {
        "dofs": report.dofs,
        "subdomains_in_all": report.subdomains,
        "coarse_size": report.coarse_size,
        "coarse_solver": report.coarse_solver,
        "coarse_mib": report.coarse_mib,
        "coarse_peak_mib": {
            "mean": comm.allreduce(held[-1]) / comm.size,
            "max": comm.allreduce(held[-1], op=MPI.MAX),
        },
    }
