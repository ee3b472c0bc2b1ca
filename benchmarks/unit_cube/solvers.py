# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Solvers on a case of the cube: FETI on its torn matrix, MUMPS and GAMG on the assembled one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from benchmarks.common.clock import Clock
from benchmarks.common.machine import PeakMemory, bandwidth
from benchmarks.common.records import Record
from benchmarks.unit_cube.case import Case, tear
from benchmarks.unit_cube.memory import estimate
from benchmarks.unit_cube.problem import CubeProblem
from dolfinx_feti import LinearProblem
from dolfinx_feti.collective import on_first
from dolfinx_feti.comparison import (
    assembled_system,
    create_gamg,
    create_mumps,
    measure,
    relative_difference,
    relative_residual,
)

__all__ = ["SOLVERS", "solve"]

#: Relative reduction of the residual of the assembled system.
RTOL = 1e-8

PAPERS = {"feti_scaling": "multiplicity", "feti_coarse_q": "identity", "feti_coarse_modes": 0}
FETI = {
    "feti_all_floating": PAPERS | {"feti_type": "all_floating"},
    "feti_classical": PAPERS | {"feti_type": "classical"},
    "feti_default": {},
}
SOLVERS = (*FETI, "gamg", "mumps")


def solve(
    case: Case, names: Sequence[str], comm: MPI.Comm, room: float
) -> Iterator[tuple[str, Record]]:
    """Solve a case with some solvers, those on the torn matrix first.

    Args:
        case: The case.
        names: Names out of :data:`SOLVERS`.
        comm: Communicator of the mesh.
        room: Memory that MUMPS may take on all processes [MiB].

    Yields:
        The name of a solver and what it took.

    Note:
        Collective.
    """
    if not names:
        return
    problem = case.problem(comm)
    speed = bandwidth(comm)
    linear = None
    for name in (name for name in names if name in FETI):
        linear = None  # its memory goes first
        linear, found = _feti(case, problem, FETI[name], speed)
        yield name, found
    if linear is None:
        linear, _ = _feti(case, problem, {}, speed)
    K, f = assembled_system(linear.A, linear.b)
    K.setOption(PETSc.Mat.Option.SPD, True)
    u = f.duplicate()
    u.array[:] = linear.u.x.array[: u.getLocalSize()]
    del linear
    for name in (name for name in names if name not in FETI):
        found, x = _assembled(K, f, name, room / comm.size)
        if found["converged_reason"] > 0:
            found |= {"relative_residual": relative_residual(K, f, x)}
            found |= {"difference_to_feti": relative_difference(u, x)}
        yield name, found
        x.destroy()
    for owned in (K, f, u):
        owned.destroy()


def _feti(
    case: Case, problem: CubeProblem, options: dict[str, object], speed: float
) -> tuple[LinearProblem, Record]:
    """Solve by FETI; return the problem, which has the torn matrix, and a record."""
    linear = tear(problem, options | {"ksp_rtol": RTOL})
    comm = linear.u.function_space.mesh.comm
    peak = PeakMemory()
    clock = Clock(comm)
    clock.watch(linear.solver)
    linear.solve()
    feti = linear.solver.getPythonContext()
    report = feti.report()

    def streamed() -> float:
        return estimate(
            degree=case.degree,
            cells=case.cells,
            subdomains=case.subdomains_per_edge,
            all_floating=report.options.all_floating,
            pc_type=report.options.pc_type,
            coarse_q=report.options.coarse_q,
            interior=report.options.interior,
            processes=comm.size,
        ).streamed

    return linear, clock.record() | {
        "dofs": report.dofs,
        "dofs_torn": report.torn_dofs,
        "coarse_size": report.coarse_size,
        "interior_is": report.interior,
        "iterations": feti.iterations,
        "converged_reason": int(linear.solver.getConvergedReason()),
        "relative_residual": feti.residual,
        "peak_mib": peak.mib_above_start(comm),
        "seconds_streaming": on_first(streamed, comm) / speed,
        "bandwidth_gb_s": speed / 1e9,
    }


def _assembled(K: PETSc.Mat, f: PETSc.Vec, name: str, room: float) -> tuple[Record, PETSc.Vec]:
    """Solve with the assembled matrix; return a record and the solution."""
    factors = []

    def create() -> PETSc.KSP:
        if name == "gamg":
            return create_gamg(K, rtol=RTOL)
        ksp = create_mumps(K)
        factors.append(ksp.getPC().getFactorMatrix())
        factors[0].setMumpsIcntl(23, int(room * 2**20 / 1e6))
        return ksp

    cost, x = measure(create, f)
    found = asdict(cost) | {"dofs": f.getSize()}
    for F in factors:
        found["estimated_mib"] = 1e6 * F.getMumpsInfog(17) / 2**20
        F.destroy()
    if not np.isfinite(found["peak_mib"]):
        found["peak_mib"] = None
    return found, x
