# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Bodies under a pressure whose surface has a free rim: the tangent is not symmetric."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from collective import COMM, agree, small
from mixed import solve_assembled
from walls import Wall, tube, wall

import dolfinx
import ufl

from dolfinx_feti import kinematics, loads, materials


def clamped_below(V: dolfinx.fem.FunctionSpace) -> list[dolfinx.fem.DirichletBC]:
    """Hold all that lies on z = 0."""
    facets = dolfinx.mesh.locate_entities_boundary(V.mesh, 2, lambda x: np.isclose(x[2], 0.0))
    dofs = dolfinx.fem.locate_dofs_topological(V, 2, facets)
    return [dolfinx.fem.dirichletbc(np.zeros(3), dofs, V)]


def free_tube(tangent: str) -> Wall:
    """A tube clamped at one end, 8 160 dofs."""
    body = wall(tube(around=16, along=4, length=1.2), tangent=tangent)
    return replace(body, bcs=clamped_below(body.u.function_space))


def free_block(tangent: str, cells: int = 6) -> Wall:
    """A neo-Hookean cube clamped below, under pressure above, P2–P0 with κ = 1000 kPa."""
    mesh = dolfinx.mesh.create_unit_cube(COMM, cells, cells, cells)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    u, p = (dolfinx.fem.Function(W) for W in (V, dolfinx.fem.functionspace(mesh, ("DG", 0))))
    v, q, du = ufl.TestFunction(V), ufl.TestFunction(p.function_space), ufl.TrialFunction(V)
    F = kinematics.deformation_gradient(u)
    C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
    psi = materials.neo_hookean(C, c=3.0, J=J) + materials.perturbed_lagrangian(J, p, 1000.0)
    metadata = {"quadrature_degree": 4}
    energy, load = psi * ufl.dx(metadata=metadata), dolfinx.fem.Constant(mesh, 0.0)
    above = dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[2], 1.0))
    tags = dolfinx.mesh.meshtags(mesh, 2, np.sort(above), np.ones(len(above), dtype=np.int32))
    ds = ufl.Measure("ds", mesh, subdomain_data=tags, metadata=metadata)(1)
    F_u = ufl.derivative(energy, u, v) + loads.follower_pressure(load, u, v, ds)
    K = ufl.derivative(ufl.derivative(energy, u, v), u, du)
    K += loads.follower_pressure_tangent(load, u, v, du, ds, tangent)
    return Wall(u, p, load, clamped_below(V), energy, F_u, ufl.derivative(energy, p, q), K)


@pytest.mark.parametrize("create", [free_tube, free_block])
def test_iterations_are_those_of_the_symmetric_part(create):
    """At 10 mmHg, for a random load: GMRES against CG, and the solution against LU."""
    counts = {}
    for tangent in ("symmetric", "full"):
        body = create(tangent)
        body.load.value = loads.mmhg(10.0)
        problem = body.problem(16, {"ksp_rtol": 1e-8})
        problem._system.residual()
        problem._system.linearise()
        A, ksp = problem.A, problem.solver.getKSP()
        ksp.setOperators(A)
        b = A.createVecLeft()
        every = np.random.default_rng(3).standard_normal(b.getSize())
        b.array[:] = every[slice(*b.getOwnershipRange())]
        x = b.duplicate()
        ksp.solve(b, x)
        context = ksp.getPythonContext()
        agree(ksp.getConvergedReason() > 0, context.message)
        agree(context.form.formulation == "primal")
        agree(context.method == {"symmetric": "cg", "full": "gmres"}[tangent])
        expected = solve_assembled(A, b)
        error, size = COMM.allreduce(
            np.array([np.sum((x.array_r - expected) ** 2), np.sum(expected**2)])
        )
        small(np.sqrt(error / size), 1e-5)
        counts[tangent] = context.iterations
    agree(counts["full"] <= 1.3 * counts["symmetric"], counts)


def test_path():
    """Each Newton step of a path takes about the iterations of the first."""
    body = free_block("full", 4)
    steps = body.inflate(body.problem(8, {"ksp_rtol": 1e-8}), [4.0, 8.0])
    iterations = [step.linear_iterations for step in steps]
    agree({step.linear_method for step in steps} == {"gmres"})
    agree(max(iterations) <= 1.5 * iterations[0], iterations)
