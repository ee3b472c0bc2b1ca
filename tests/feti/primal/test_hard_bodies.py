# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Thin plates and stiff inclusions are solved in few iterations by default.

The dual formulation takes 20 to 3000 iterations on the same bodies.
"""

import itertools

import numpy as np
import pytest
from cases import each
from collective import COMM, agree, small
from problems import Problem, dirichlet, torn

import dolfinx
import ufl

from dolfinx_feti.comparison import assembled_system, create_solver, relative_difference
from dolfinx_feti.runtime.lifetime import Lifetime

POISSON = 0.3

#: Most iterations. Without A V in double precision, small columns kept and an accurate coarse
#: solve, some of these bodies take more than a thousand.
MAX_ITERATIONS = 60

HEXAHEDRA = dolfinx.mesh.CellType.hexahedron
TETRAHEDRA = dolfinx.mesh.CellType.tetrahedron


def stress(u, mu):
    """Return Hooke's stress for a shear modulus."""
    lmbda = 2 * mu * POISSON / (1 - 2 * POISSON)
    return 2 * mu * ufl.sym(ufl.grad(u)) + lmbda * ufl.div(u) * ufl.Identity(3)


def plate(slenderness, cell_type, degree):
    """Return the problem of a plate between two clamped edges, in its weight.

    Args:
        slenderness: Length over thickness; the plate is 1 × 0.6.
        cell_type: Tetrahedra or hexahedra.
        degree: Degree of the elements, of which 48 / degree lie along the plate.
    """
    corners = [(0.0, 0.0, 0.0), (1.0, 0.6, 1.0 / slenderness)]
    n = 48 // degree
    mesh = dolfinx.mesh.create_box(COMM, corners, (n, n * 7 // 12, 1), cell_type=cell_type)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    a = ufl.inner(stress(u, 1.0), ufl.grad(v)) * ufl.dx
    ends = dirichlet(V, lambda x: np.isclose(x[0], 0.0) | np.isclose(x[0], 1.0))
    return Problem(V, a, v[2] * ufl.dx, [ends])


def stiff_parts(ratio, shape):
    """Return the problem of a clamped cube with stiff parts, which lie in subdomains and across.

    Args:
        ratio: Shear modulus of the parts; that of the cube is one.
        shape: ``balls`` for 27 balls, ``rods`` for 9 rods along x.
    """
    mesh = dolfinx.mesh.create_unit_cube(COMM, 15, 15, 15)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    mu = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    x = mu.function_space.tabulate_dof_coordinates()[: len(mu.x.array)]
    places = (1 / 6, 3 / 6, 5 / 6)
    mu.x.array[:] = 1.0
    if shape == "balls":
        for centre in itertools.product(places, repeat=3):
            mu.x.array[np.linalg.norm(x - centre, axis=1) < 0.12] = ratio
    else:
        for y, z in itertools.product(places, repeat=2):
            mu.x.array[(np.abs(x[:, 1] - y) < 0.1) & (np.abs(x[:, 2] - z) < 0.1)] = ratio
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    a = ufl.inner(stress(u, mu), ufl.grad(v)) * ufl.dx
    return Problem(V, a, v[0] * ufl.dx, [dirichlet(V, lambda x: np.isclose(x[2], 0.0))])


#: How each body is built, and the difference to MUMPS that rounding allows in both solutions.
BODIES = {
    "plate 1:20, P1": (lambda: plate(20.0, TETRAHEDRA, 1), 1e-7),
    "plate 1:100, Q1": (lambda: plate(100.0, HEXAHEDRA, 1), 1e-6),
    "plate 1:400, P2": (lambda: plate(400.0, TETRAHEDRA, 2), 1e-4),
    "plate 1:1000, Q1": (lambda: plate(1000.0, HEXAHEDRA, 1), 1e-4),
    "plate 1:1000, P2": (lambda: plate(1000.0, TETRAHEDRA, 2), 1e-3),
    "balls 1e2": (lambda: stiff_parts(1e2, "balls"), 1e-7),
    "balls 1e4": (lambda: stiff_parts(1e4, "balls"), 1e-6),
    "balls 1e8": (lambda: stiff_parts(1e8, "balls"), 1e-3),
    "rods 1e6": (lambda: stiff_parts(1e6, "rods"), 1e-4),
    "rods 1e8": (lambda: stiff_parts(1e8, "rods"), 1e-3),
}


@pytest.mark.processes(1, 2, 3)
@each(("create", "tolerance"), BODIES)
def test_hard_bodies_take_few_iterations(create, tolerance):
    """The solution agrees with MUMPS as far as rounding in both allows."""
    problem = torn(create(), None, "hard_")
    with Lifetime() as owned:
        A, b = problem.linear_system()
        K, f = map(owned.own, assembled_system(A, owned.own(b)))
        direct = owned.own(create_solver(K))
        x = owned.own(f.duplicate())
        direct.solve(f, x)
        problem.solve()
        difference = relative_difference(problem.x, x)
    context = problem.solver.getPythonContext()
    agree(context.report().formulation == "primal")
    agree(context.iterations <= MAX_ITERATIONS)
    small(difference, tolerance)
