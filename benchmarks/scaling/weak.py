# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The coarse problem with as many subdomains on each process: what it takes of a process's memory.

The paper's cube, of subcubes of one cell, 2048 on each process: on 2 processes there are 4096, on
16 there are 32 768. Linear elasticity, held all round, all-floating FETI with Q = I: six coarse
unknowns a subdomain.
"""

from __future__ import annotations

from unittest import mock

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl

from benchmarks.common.machine import PeakMemory
from benchmarks.common.records import Record
from dolfinx_feti import LinearProblem
from dolfinx_feti.feti.dual.coarse import Coarse
from meshes.cube import create_cube

__all__ = ["EACH", "coarse_problem"]

#: Subdomains of a process.
EACH = 2048

#: Lamé's parameters, whose ratio is that of ν = 0.45.
MU, LAMBDA = 1.0, 9.0

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
    linear = _create_problem(comm, round(case["subdomains"] ** (1.0 / 3.0)))
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


def _create_problem(comm: MPI.Comm, edge: int) -> LinearProblem:
    """Tear the cube into its subcubes, so many along an edge. Collective."""
    mesh, part = create_cube(comm, edge, 1)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    strain = ufl.sym(ufl.grad(u))
    stress = 2 * MU * strain + LAMBDA * ufl.tr(strain) * ufl.Identity(3)
    mesh.topology.create_connectivity(2, 3)
    surface = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    dofs = dolfinx.fem.locate_dofs_topological(V, 2, surface)
    return LinearProblem(
        ufl.inner(stress, ufl.grad(v)) * ufl.dx,
        ufl.inner(dolfinx.fem.Constant(mesh, np.zeros(3)), v) * ufl.dx,
        bcs=[dolfinx.fem.dirichletbc(np.zeros(3), dofs, V)],
        subdomains=part,
        petsc_options_prefix="cube_",
        petsc_options=OPTIONS,
    )
