# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Newton's method on a block that slides on rollers, a null space of its tangents."""

from petsc4py import PETSc

import numpy as np
import pytest
from cases import every_formulation
from collective import COMM, agree, raises, small

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_feti import ConvergenceError, NonlinearProblem

Reason = PETSc.SNES.ConvergedReason

every_unit = pytest.mark.parametrize(
    ("unit", "length"), [(1.0, 1.0), (1e9, 1e-3)], ids=["1-kPa-1-m", "1e9-kPa-1-mm"]
)


def block(kappa, load, formulation, *, unit=1.0, length=1.0, net=0.0):
    """Pull a block along x by a body force; only one with mean zero can be balanced."""
    mesh = dolfinx.mesh.create_rectangle(
        COMM,
        [(0.0, 0.0), (2 * length, length)],
        (8, 4),
        cell_type=dolfinx.mesh.CellType.quadrilateral,
    )
    V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    S, _ = V.sub(1).collapse()
    u = fem.Function(V)
    F = ufl.Identity(2) + ufl.grad(u)
    J = ufl.det(F)
    energy = unit * (0.5 * (ufl.tr(F.T * F) - 2 - 2 * ufl.ln(J)) + 0.5 * kappa * (J - 1) ** 2)
    x = ufl.SpatialCoordinate(mesh)[0] / length
    force = unit * load / length * (x**2 - 4 / 3 + net)
    bottom = dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[1], 0.0))
    dofs = fem.locate_dofs_topological((V.sub(1), S), 1, bottom)
    nodes = V.dofmap.index_map
    slide = PETSc.Vec().createMPI((2 * nodes.size_local, 2 * nodes.size_global), comm=mesh.comm)
    slide.array[::2] = 1.0
    slide.normalize()
    space = PETSc.NullSpace().create(vectors=[slide], comm=mesh.comm)
    problem = NonlinearProblem(
        energy * ufl.dx - force * u[0] * ufl.dx,
        u,
        bcs=[fem.dirichletbc(fem.Function(S), dofs, V.sub(1))],
        null_space=space,
        subdomains=4,
        petsc_options={"feti_formulation": formulation, "snes_rtol": 1e-12},
        quadrature_degree=4,
    )
    space.destroy()
    slide.destroy()
    return problem, u


def sliding(u):
    """Return the mean and the largest displacement along x."""
    n = u.function_space.dofmap.index_map.size_local
    own = u.x.array[: 2 * n : 2]
    mean = COMM.allreduce(own.sum()) / COMM.allreduce(n)
    return mean, max(COMM.allgather(np.abs(own).max(initial=0.0)))


@every_formulation
@every_unit
@pytest.mark.parametrize("kappa", [1.0, 1e2, 1e4])
def test_last_steps_whose_residual_is_rounding(kappa, unit, length, formulation):
    """Solves converge although the last residuals are rounding errors of balanced loads."""
    problem, u = block(kappa, 1e-2, formulation, unit=unit, length=length)
    problem.solve()
    agree(problem.solver.getConvergedReason() > 0)
    mean, largest = sliding(u)
    small(mean / largest, 1e-8)


@every_formulation
@every_unit
def test_shifted_tangents(unit, length, formulation):
    """A long step with indefinite, shifted tangents converges without sliding."""
    problem, u = block(1e4, 0.5, formulation, unit=unit, length=length)
    problem.solve()
    agree(any(step.shift > 0.0 for step in problem.history))
    mean, largest = sliding(u)
    small(mean / largest, 1e-8)
    problem.solve()  # the tangent has its null space again
    agree(problem.solver.getConvergedReason() > 0)


@every_formulation
@pytest.mark.parametrize("net", [1e-8, 1e-2, 1.0])
def test_a_load_that_nothing_balances_is_refused(net, formulation):
    """A load that is not orthogonal to the null space is refused, as nothing balances it."""
    problem, _ = block(1e2, 1e-2, formulation, net=net)
    with raises(ConvergenceError, "not orthogonal to the null space of A"):
        problem.solve()
