# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A torn matrix is its owner's: what is changed in it, the next solve sees."""

from petsc4py import PETSc

import numpy as np
import pytest
from cases import each
from changes import PATTERN, VALUES, replaced, scaled_copy, stiffness
from collective import COMM, agree, equal, whole
from hand_torn import random_values, solve

from dolfinx_feti.comparison import assembled_system, create_solver
from dolfinx_feti.runtime.connectivity import has_joined_copies
from dolfinx_feti.torn.matrix import Torn, create_torn_matrix, state_of

CHANGES = {**PATTERN, **VALUES}
OPTIONS = [
    {"feti_formulation": "dual", "feti_interior": "keep"},
    {"feti_formulation": "dual", "feti_interior": "eliminate"},
    {"feti_formulation": "primal"},
]
RTOL = 1e-10
#: ‖x − x*‖/‖x*‖ over ‖b − A x‖/‖b‖ on these grids, with springs and scaled stiffness.
CONDITION = 1e4


@pytest.fixture
def problem(torn_grid):
    """Six subdomains of two by two cells, one after the other, whose weights are attached."""
    torn = torn_grid((6, 1), (2, 2))
    stiffness(torn)
    return torn


def solve_directly(problem, b):
    """Solve the assembled system of the present torn matrix."""
    K, f = assembled_system(problem.A, problem.vector(b))
    ksp = create_solver(K)
    x = f.duplicate()
    ksp.solve(f, x)
    values = whole(x.array_r)
    for made in (ksp, K, f, x):
        made.destroy()
    return values


def holds_two_copies(problem):
    """Two subdomains that share dofs are joined: on three processes, which hold neighbours."""
    torn = Torn(problem.A)
    joined = has_joined_copies(problem.A, torn.subdomains)
    torn.destroy()
    return joined


def test_neighbours_joined_are_refused(torn_grid, feti):
    """Two subdomains on each process, neighbours on it; on one process they are all there are."""
    problem = torn_grid((2 * COMM.size, 1), (2, 2))
    ksp = feti(problem.A, ksp_rtol=RTOL)
    PATTERN["two subdomains joined"](problem)
    agree(holds_two_copies(problem))
    solved(ksp, problem, random_values(problem))


def solved(ksp, problem, b):
    """The solution is that of the matrix as it is now, or the solver says why there is none."""
    reason, x = solve(ksp, problem, b)
    if holds_two_copies(problem):
        message = ksp.getPythonContext().message
        agree(reason < 0 and not x.any() and "two copies of a dof" in message, message)
        return
    agree(reason > 0, ksp.getPythonContext().message)
    equal(x, solve_directly(problem, b), CONDITION * RTOL)


@pytest.mark.parametrize("options", OPTIONS, ids=" ".join)
@pytest.mark.parametrize("name", CHANGES)
def test_next_solve_sees(name, options, problem, feti):
    ksp, b = feti(problem.A, ksp_rtol=RTOL, **options), random_values(problem)
    solved(ksp, problem, b)
    CHANGES[name](problem)
    solved(ksp, problem, b)
    solved(ksp, problem, 2.0 * b)


@pytest.mark.parametrize("options", OPTIONS, ids=" ".join)
def test_one_change_after_the_other(options, problem, feti):
    ksp, b = feti(problem.A, ksp_rtol=RTOL, **options), random_values(problem)
    for change in CHANGES.values():
        change(problem)
        solved(ksp, problem, b)


WITHOUT = {
    "dirichlet": (lambda A: A.compose("dirichlet", None), "singular"),
    "near kernel": (lambda A: A.setNearNullSpace(PETSc.NullSpace()), "set_near_kernel"),
}


@each(("take", "words"), WITHOUT)
def test_what_goes_is_missed(take, words, torn_grid, feti):
    """The message names the remedy; with the same objects back there is a solution again."""
    problem = torn_grid((2, 2), (2, 2), components=2)
    ksp, b = feti(problem.A, ksp_rtol=RTOL), random_values(problem)
    solved(ksp, problem, b)
    held, modes = problem.A.query("dirichlet"), problem.A.getNearNullSpace()
    take(problem.A)
    reason, x = solve(ksp, problem, b)
    message = ksp.getPythonContext().message
    agree(reason < 0 and not x.any() and words in message, message)
    problem.A.compose("dirichlet", held)
    problem.A.setNearNullSpace(modes)
    solved(ksp, problem, b)


def test_unblocked_local_matrix(torn_grid, feti):
    """Two components, and a local matrix that does not know of them."""
    problem = torn_grid((2, 2), (2, 2), components=2)
    ksp, b = feti(problem.A, ksp_rtol=RTOL), random_values(problem)
    solved(ksp, problem, b)
    K = problem.local.copy()
    csr = K.getValuesCSR()
    replaced(problem, PETSc.Mat().createAIJ(K.getSize(), csr=csr, comm=PETSc.COMM_SELF))
    K.destroy()
    solved(ksp, problem, b)


def test_another_matrix(problem, torn_grid, feti):
    """As many dofs in other subdomains."""
    ksp = feti(problem.A, ksp_rtol=RTOL)
    solved(ksp, problem, random_values(problem))
    other = torn_grid((2, 1), (6, 2))
    ksp.setOperators(other.A)
    solved(ksp, other, random_values(other))
    ksp.setOperators(problem.A)
    solved(ksp, problem, random_values(problem))


# -- the state


@pytest.mark.parametrize("name", CHANGES)
def test_change_is_in_the_state(name, problem):
    """On some process, and in its proper part."""
    before = state_of(problem.A)
    CHANGES[name](problem)
    after = state_of(problem.A)
    pattern = COMM.allreduce(after.pattern != before.pattern)
    values = COMM.allreduce(after.values != before.values)
    agree((pattern > 0) == (name in PATTERN) and (pattern or values), (pattern, values))


def test_state_stays_where_nothing_changes(problem, feti):
    """It can be hashed, and neither a solve nor a look at the matrix changes it."""
    before = state_of(problem.A)
    reason, _ = solve(feti(problem.A, ksp_rtol=RTOL), problem, random_values(problem))
    agree(reason > 0)
    problem.A.getISLocalMat().getValuesCSR()
    problem.A.getNearNullSpace().getVecs()[0].norm()
    after = state_of(problem.A)
    agree(after == before and hash(after) == hash(before), (before, after))


def test_state_keeps_what_it_names(problem):
    """A local matrix that is freed cannot hand its address on."""
    seen = []
    for _ in range(20):
        scaled_copy(problem)
        seen.append(state_of(problem.A))
    agree(len({state.pattern for state in seen}) == len(seen))
    agree(len(set(seen)) == len(seen))


def test_state_of_two_matrices_with_one_local_matrix(problem):
    sizes, dofs = problem.A.getSizes()[0], problem.A.getLGMap()[0].getIndices()
    other = create_torn_matrix(problem.local, np.asarray(dofs), sizes, comm=COMM)
    agree(state_of(other) != state_of(problem.A))
    other.destroy()
