# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Solvers on the paper's cube: FETI on its torn matrix, MUMPS and GAMG on the assembled one.

All of them reduce the residual of the assembled system by 1e-8. FETI has the Dirichlet
preconditioner and the paper's choices, all-floating and classical, or this package's own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from mpi4py import MPI

import dolfinx_feti
from benchmarks.common.cube import tear
from benchmarks.common.machine import PeakMemory, bandwidth, limited_memory
from benchmarks.common.records import Record
from benchmarks.cube.case import Case
from benchmarks.cube.case import solve as feti
from dolfinx_feti.runtime.collective import on_first

__all__ = ["SOLVERS", "solve"]

RTOL = 1e-8

PAPERS = {"feti_scaling": "multiplicity", "feti_coarse_q": "identity", "feti_coarse_modes": 0}
FETI = {
    "feti_all_floating": PAPERS | {"feti_type": "all_floating"},
    "feti_classical": PAPERS | {"feti_type": "classical"},
    "feti_default": {},
}
SOLVERS = (*FETI, "gamg", "mumps")


def solve(
    case: Case, names: Sequence[str], comm: MPI.Comm, memory: float
) -> Iterator[tuple[str, Record]]:
    """Solve a case with some of :data:`SOLVERS`, and yield what each took. Collective.

    MUMPS and GAMG may take so much ``memory`` on all processes [MiB].
    """
    problem = case.problem(comm)
    speed = bandwidth(comm)
    for name in (name for name in names if name in FETI):
        peak = PeakMemory()  # above what mesh and forms take
        linear, found = feti(problem, FETI[name] | {"ksp_rtol": RTOL})
        options = linear.solver.getPythonContext().report().options
        same = replace(
            case,
            type="all_floating" if options.all_floating else "classical",
            pc=options.pc_type,
            coarse_q=options.coarse_q,
            interior=options.interior,
        )
        streamed = on_first(lambda same=same: same.estimate(comm.size).streamed, comm)
        found["converged_reason"] = int(linear.solver.getConvergedReason())
        found["peak_mib"] = peak.mib_above_start(comm)
        yield name, found | {"seconds_streaming": streamed / speed, "bandwidth_gb_s": speed / 1e9}
    others = [name for name in names if name not in FETI]
    if others:
        with limited_memory(comm, memory):
            linear = tear(problem, {"ksp_rtol": RTOL})
            compared = dolfinx_feti.compare(linear, others, definite=True).records
        for found in compared:
            yield str(found.pop("solver")), {"converged_reason": -1} | found
