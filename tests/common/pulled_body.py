# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A block that is pulled, and what public calls are asked of it."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

import numpy as np
from collective import COMM
from problems import cube, dirichlet, left

import dolfinx
import ufl

from dolfinx_feti import LinearProblem, NonlinearProblem, comparison, kinematics, loading, materials
from dolfinx_feti import output as out

__all__ = ["Body"]


class Body:
    """A block that is pulled; whatever is asked of it is made once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.mesh = cube(3, 3)
        V = dolfinx.fem.functionspace(self.mesh, ("Lagrange", 1, (3,)))
        self.u, self.v = dolfinx.fem.Function(V, name="u"), ufl.TestFunction(V)
        self.load = dolfinx.fem.Constant(self.mesh, 0.0)
        self.F = kinematics.deformation_gradient(self.u)
        C, self.J = kinematics.right_cauchy_green(self.F), kinematics.jacobian(self.F)
        self.psi = materials.neo_hookean(C, c=3.0, J=self.J) + materials.volumetric(self.J, 10.0)
        self.bcs = [dirichlet(V, left)]

    @cached_property
    def problem(self) -> NonlinearProblem:
        """Under a load of the volume."""
        energy = (self.psi - self.load * self.u[0]) * ufl.dx
        return NonlinearProblem(energy, self.u, bcs=self.bcs, quadrature_degree=2, subdomains=6)

    @cached_property
    def steps(self) -> list[loading.LoadStep]:
        """Load steps, kept in a folder that is not there yet."""
        kept = {"checkpoint": self.checkpoint("kept/here")}
        first = loading.Steps(first=0.1, least=0.01)
        return loading.follow_load(
            self.problem, self.set_load, [0.1, 0.2], first, state=[self.u], **kept
        )

    def set_load(self, load: float) -> None:
        self.load.value = load

    def checkpoint(self, name: str, **options: object) -> loading.Checkpoint:
        return loading.Checkpoint(self.folder / name, COMM, **options)

    @cached_property
    def linear(self) -> LinearProblem:
        """Of the same block, with a solution."""
        V = self.u.function_space
        du = ufl.TrialFunction(V)
        a = ufl.inner(ufl.sym(ufl.grad(du)), ufl.sym(ufl.grad(self.v))) * ufl.dx
        problem = LinearProblem(a, self.v[0] * ufl.dx, bcs=self.bcs, subdomains=6)
        problem.solve()
        return problem

    @cached_property
    def assembled(self) -> tuple:
        """K, f and the solution by MUMPS with its cost."""
        A, b = self.linear.linear_system()
        K, f = comparison.assembled_system(A, b)
        return K, f, *comparison.measure(lambda: comparison.create_solver(K), f)

    @cached_property
    def solver(self) -> tuple:
        """A FETI solver that is kept, its solution and its system."""
        A, b = self.linear.linear_system()
        x = b.duplicate()
        cost, ksp = comparison.timed_solve(self.linear.create_linear_solver, b, x)
        return cost, ksp, A, b, x

    @cached_property
    def layers(self) -> dolfinx.mesh.MeshTags:
        n = self.mesh.topology.index_map(3)
        every = np.arange(n.size_local + n.num_ghosts, dtype=np.int32)
        return dolfinx.mesh.meshtags(self.mesh, 3, every, np.full_like(every, 7))

    @cached_property
    def patches(self) -> out.Patches:
        return out.create_patches(self.mesh, self.layers)

    @cached_property
    def stress(self) -> dolfinx.fem.Function:
        return out.recovered_field(kinematics.cauchy_stress(self.psi, self.F), self.patches)
