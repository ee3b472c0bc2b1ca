# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A body with islands in a material that is softer by many orders is not a singular problem."""

import itertools

from petsc4py import PETSc

import hand_torn
import numpy as np
import pytest
from cases import case, each, every_formulation, every_interior
from collective import agree, small
from hand_torn import solve

Reason = PETSc.KSP.ConvergedReason

#: Cells of the body along each axis, and of a subdomain, for different numbers of subdomains.
CELLS = (24, 12)
SUBDOMAINS = {"one": (1, 1), "halves": (2, 1), "quarters": (2, 2), "many": (4, 3)}
every_tearing = each("subdomains", SUBDOMAINS)
VOIDS = [1e-6, 1e-8, 1e-9, 1e-10, 1e-12]


def is_solid(x, y):
    """Mark a frame with two islands, which no subdomain or two or four of them have."""
    frame = (y < 2) | (y > 10) | (x < 2) | (x > 21)
    islands = (abs(y - 6) < 2) & ((abs(x - 6) < 2) | (abs(x - 12) < 2))
    return frame | islands


@pytest.fixture
def frame(torn_grid):
    """Return a function that tears a frame held on the left, with a soft void, in some units."""

    def create(subdomains, void, units=1.0):
        cells = tuple(n // p for n, p in zip(CELLS, subdomains, strict=True))

        def soften(K, _dofs):
            for i, corner in enumerate(itertools.product(*map(range, subdomains))):
                first = np.multiply(corner, cells)

                def stiffness(cell, first=first):
                    x, y = np.add(first, cell) + 0.5
                    return units * (1.0 if is_solid(x, y) else void)

                K[i][:] = hand_torn.brick(cells, 2, stiffness)[1]

        return torn_grid(**case(subdomains, cells, 2, change=soften))

    return create


def shear(problem):
    """Return the load that pulls the right side downwards, (N,)."""
    b = np.zeros(len(problem.dirichlet))
    b[1::2][problem.x[:, 0] == CELLS[0]] = -1.0
    return b


def scaled_solution(problem, b):
    """Return the solution by a dense factor of the matrix with a unit diagonal, (N,)."""
    free = ~problem.dirichlet
    A = problem.free_matrix
    d = np.sqrt(A.diagonal())
    x = np.zeros(len(b))
    x[free] = np.linalg.solve(A / np.outer(d, d), b[free] / d) / d
    return x


@every_formulation
@every_interior
@every_tearing
@pytest.mark.parametrize("void", VOIDS)
@pytest.mark.parametrize("units", [1.0, 1e9])
def test_voids_agree_with_a_direct_solver(
    units, void, subdomains, interior, formulation, frame, create_ksp
):
    """The load's work is accurate, and displacements of islands up to rounding, κ ε."""
    problem = frame(subdomains, void, units)
    ksp = create_ksp(problem.A, feti_formulation=formulation, feti_interior=interior)
    b = shear(problem)
    reason, x = solve(ksp, problem, b)
    agree(reason > 0, ksp.getPythonContext().message)
    expected = scaled_solution(problem, b)
    small(b @ x / (b @ expected) - 1.0, 1e-7)
    islands = np.abs(x - expected).max() / np.abs(expected).max()
    small(islands, max(1e-6, 1e-14 / void))  # what rounding leaves of the islands: κ ε
    agree(ksp.getIterationNumber() <= 60)


@every_formulation
@every_interior
@every_tearing
@pytest.mark.parametrize("void", [1e-14, 1e-16, 1e-20])
def test_voids_beyond_rounding_are_solved_or_refused_for_their_scales(
    void, subdomains, interior, formulation, frame, create_ksp
):
    """Double precision does not resolve them; Dirichlet conditions would not help."""
    problem = frame(subdomains, void)
    ksp = create_ksp(problem.A, feti_formulation=formulation, feti_interior=interior)
    b = shear(problem)
    reason, x = solve(ksp, problem, b)
    if reason > 0:
        solid = frame(subdomains, 1e-9)
        small(b @ x / (b @ scaled_solution(solid, b)) - 1.0, 1e-6)
        return
    message = ksp.getPythonContext().message
    agree("Add Dirichlet conditions" not in message, message)
    agree(
        any(
            word in message
            for word in ("scale", "rounding", "coefficients", "range of the entries")
        ),
        message,
    )


@every_interior
@every_tearing
def test_islands_without_surroundings_are_singular(subdomains, interior, frame, create_ksp):
    """The rows of the empty cells are zero: nothing resists their nodes."""
    problem = frame(subdomains, 0.0)
    ksp = create_ksp(problem.A, feti_formulation="dual", feti_interior=interior)
    reason, _ = solve(ksp, problem, shear(problem))
    agree(reason == Reason.DIVERGED_PCSETUP_FAILED)
    agree("singular" in ksp.getPythonContext().message, ksp.getPythonContext().message)
