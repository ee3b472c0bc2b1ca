# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A solve uses the present pattern and values of a torn matrix, however they were changed."""

import ctypes

from petsc4py import PETSc

import numpy as np
import pytest
import scipy.sparse
from cases import each
from collective import COMM, agree, equal, whole
from hand_torn import aij, random_values, solve
from mixed import solve_assembled

from dolfinx_feti import set_near_kernel
from dolfinx_feti.runtime.petsc_library import c_function
from dolfinx_feti.torn.connectivity import has_repeated_dofs
from dolfinx_feti.torn.matrix import Torn, create_torn_matrix, set_condensed_pressures, version_of

LAST = COMM.rank == COMM.size - 1


def local_matrix(problem):
    """Return the present local matrix."""
    return problem.A.getISLocalMat()


def replace_local_matrix(problem, K):
    """Replace the local matrix; there are no other references to the old or the new one."""
    problem.A.setISLocalMat(K)
    problem.A.assemble()
    K.destroy()


def replace_by_scaled_copy(problem):
    """Replace the local matrix by another one with five times its values."""
    K = local_matrix(problem).copy()
    K.scale(5.0)
    replace_local_matrix(problem, K)


def spring_entries(i, j):
    """Return the entries (row, column, value) of a spring between two torn dofs."""
    return ((i, i, 7.0), (j, j, 7.0), (i, j, -7.0), (j, i, -7.0))


def add_spring(problem, i, j):
    """Add a spring between two torn dofs of each process, a matrix of another pattern."""
    n = local_matrix(problem).getSize()[0]
    X = PETSc.Mat().createAIJ((n, n), nnz=2, comm=PETSc.COMM_SELF)
    for row, column, value in spring_entries(i, j) if n else ():
        X.setValue(row % n, column % n, value, addv=PETSc.InsertMode.ADD)
    X.assemble()
    local_matrix(problem).axpy(1.0, X, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    problem.A.assemble()
    X.destroy()


def insert_entries(problem, entries):
    """Add entries to the local matrix of the last process, one after the other."""
    K = local_matrix(problem)
    if LAST and K.getSize()[0]:
        K.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        for i, j, value in entries:
            K.setValue(i, j, value, addv=PETSc.InsertMode.ADD)
    problem.A.assemble()


def remove_small_entries(problem):
    """Replace the local matrix by one without its smallest entries off the diagonal."""
    indptr, indices, values = local_matrix(problem).getValuesCSR()
    K = scipy.sparse.csr_array((values, indices, indptr), local_matrix(problem).getSize()).tocoo()
    small = np.abs(K.data) <= 0.2
    K.col[small] = K.row[small]  # constants stay the kernel
    replace_local_matrix(problem, aij(K.tocsr()))


def swap_global_dofs(problem):
    """Exchange the global numbers of the first two torn dofs of each process."""
    K = local_matrix(problem)
    dofs = problem.A.getLGMap()[0].getIndices().copy()
    dofs[:2] = dofs[:2][::-1].copy()
    lgmap = PETSc.LGMap().create(dofs, bsize=1, comm=COMM)
    problem.A.setLGMap(lgmap, lgmap)  # drops the local matrix
    problem.A.setISLocalMat(K)
    problem.A.assemble()
    lgmap.destroy()


def set_value_in_local_numbering(problem):
    """Set values through the torn matrix, in the local numbering."""
    if local_matrix(problem).getSize()[0]:
        problem.A.setValueLocal(1, 1, 2.5, addv=PETSc.InsertMode.ADD)
    problem.A.assemble()


def owned_dofs(problem, dofs):
    """Return those of some global dofs that this process owns."""
    first, last = problem.A.getOwnershipRange()
    return dofs[(first <= dofs) & (dofs < last)].astype(PETSc.IntType)


def prescribe_opposite_side(problem):
    """Prescribe the opposite side."""
    dofs = np.flatnonzero(problem.x[:, 0] == problem.x[:, 0].max())
    problem.A.compose("dirichlet", PETSc.IS().createGeneral(owned_dofs(problem, dofs), comm=COMM))


def append_dirichlet_dof_in_place(problem):
    """Append the last dof to the index set of the Dirichlet dofs."""
    dofs = np.append(np.flatnonzero(problem.dirichlet), len(problem.dirichlet) - 1)
    problem.A.query("dirichlet").setIndices(owned_dofs(problem, dofs))


def attach_stiffness(problem):
    """Attach stiffnesses of the torn dofs, by which the copies are weighed."""
    weight = PETSc.Vec().createSeq(local_matrix(problem).getSize()[0], comm=PETSc.COMM_SELF)
    weight.array[:] = 1.0 + np.arange(weight.getSize()) % 3
    problem.A.compose("stiffness", weight)


def replace_near_kernel(problem):
    """Attach a constant of the other sign as near kernel."""
    one = problem.A.createVecRight()
    one.set(-1.0)
    set_near_kernel(problem.A, [one])


def change_near_kernel_in_place(problem):
    """Change the sign of the first vector, which PETSc has locked and which is unlocked for it."""
    mode = problem.A.getNearNullSpace().getVecs()[0]
    unlock, lock = (c_function(f"VecLockRead{way}", (ctypes.c_void_p,)) for way in ("Pop", "Push"))
    unlock(mode.handle)
    mode.scale(-1.0)
    lock(mode.handle)


#: Changes of the pattern.
PATTERN = {
    "local matrix replaced": replace_by_scaled_copy,
    # the first one is freed, so that PETSc may use its address again
    "local matrix replaced twice": lambda p: (replace_by_scaled_copy(p), replace_by_scaled_copy(p)),
    "entries added in a subdomain": lambda p: add_spring(p, 0, 8),
    "two subdomains joined": lambda p: add_spring(p, 0, -4),
    "entries inserted": lambda p: insert_entries(p, spring_entries(0, 8)),
    "entries removed": remove_small_entries,
    "numbering": swap_global_dofs,
    "block size": lambda p: local_matrix(p).setBlockSize(3),
    "other Dirichlet dofs": prescribe_opposite_side,
    "Dirichlet dofs in place": append_dirichlet_dof_in_place,
}

#: Changes of the values alone.
VALUES = {
    "local matrix scaled": lambda p: local_matrix(p).scale(2.0),
    "torn matrix scaled": lambda p: p.A.scale(0.1),
    "one entry": lambda p: insert_entries(p, [(0, 0, 11.0)]),
    "values in the local numbering": set_value_in_local_numbering,
    "diagonal": lambda p: local_matrix(p).setDiagonal(3.0 * local_matrix(p).getDiagonal()),
    "stiffness": attach_stiffness,
    "stiffness in place": lambda p: p.A.query("stiffness").scale(4.0),
    "near kernel": replace_near_kernel,
    "near kernel in place": change_near_kernel_in_place,
    "coordinates": lambda p: p.A.query("coordinates").shift(1.0),
    "pressures": lambda p: set_condensed_pressures(p.A, 3),
}

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
    attach_stiffness(torn)
    return torn


def has_subdomain_with_two_copies(problem):
    """Return True if neighbours are joined: only on three processes, which hold neighbours."""
    torn = Torn(problem.A)
    joined = has_repeated_dofs(problem.A, torn.subdomains)
    torn.destroy()
    return joined


def check_solution(ksp, problem, b):
    """Assert that the solution is that of the present matrix, or that an error has the reason."""
    reason, x = solve(ksp, problem, b)
    if has_subdomain_with_two_copies(problem):
        message = ksp.getPythonContext().message
        agree(reason < 0 and not x.any() and "two copies of a dof" in message, message)
        return
    agree(reason > 0, ksp.getPythonContext().message)
    expected = whole(solve_assembled(problem.A, problem.vector(b)))
    equal(x, expected, CONDITION * RTOL)


def test_joined_neighbours_are_refused(torn_grid, create_ksp):
    """A subdomain with two copies of a dof cannot be torn, and the message says so."""
    problem = torn_grid((2 * COMM.size, 1), (2, 2))
    ksp = create_ksp(problem.A, ksp_rtol=RTOL)
    PATTERN["two subdomains joined"](problem)
    agree(has_subdomain_with_two_copies(problem))
    check_solution(ksp, problem, random_values(problem))


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("name", CHANGES)
def test_next_solve_uses_the_changed_matrix(name, options, problem, create_ksp):
    """Each change has another version of the pattern, or of the values alone."""
    ksp = create_ksp(problem.A, ksp_rtol=RTOL, **options)
    b = random_values(problem)
    check_solution(ksp, problem, b)
    before = version_of(problem.A)
    CHANGES[name](problem)
    after = version_of(problem.A)  # differs on some process, in the part that has changed
    pattern = COMM.allreduce(after.pattern != before.pattern)
    values = COMM.allreduce(after.values != before.values)
    agree((pattern > 0) == (name in PATTERN) and (pattern or values), (pattern, values))
    check_solution(ksp, problem, b)
    check_solution(ksp, problem, 2.0 * b)


@pytest.mark.parametrize("options", OPTIONS)
def test_solutions_are_right_after_each_of_many_changes(options, problem, create_ksp):
    """A change must not hide a later one."""
    ksp = create_ksp(problem.A, ksp_rtol=RTOL, **options)
    b = random_values(problem)
    for change in CHANGES.values():
        change(problem)
        check_solution(ksp, problem, b)


REMOVED = {
    "dirichlet": (lambda A: A.compose("dirichlet", None), "singular"),
    "near kernel": (lambda A: A.setNearNullSpace(PETSc.NullSpace()), "set_near_kernel"),
}


@each(("remove", "remedy"), REMOVED)
def test_removed_data_fails_until_it_is_restored(remove, remedy, torn_grid, create_ksp):
    """Without Dirichlet dofs or near kernel a solve fails, and its message names the remedy."""
    problem = torn_grid((2, 2), (2, 2), components=2)
    ksp = create_ksp(problem.A, ksp_rtol=RTOL)
    b = random_values(problem)
    check_solution(ksp, problem, b)
    dirichlet = problem.A.query("dirichlet")
    modes = problem.A.getNearNullSpace()
    remove(problem.A)
    reason, x = solve(ksp, problem, b)
    message = ksp.getPythonContext().message
    agree(reason < 0 and not x.any() and remedy in message, message)
    problem.A.compose("dirichlet", dirichlet)
    problem.A.setNearNullSpace(modes)
    check_solution(ksp, problem, b)


def test_local_matrix_may_lose_its_block_size(torn_grid, create_ksp):
    """The block size is that of the torn matrix, whatever the local one says."""
    problem = torn_grid((2, 2), (2, 2), components=2)
    ksp = create_ksp(problem.A, ksp_rtol=RTOL)
    b = random_values(problem)
    check_solution(ksp, problem, b)
    csr = problem.local.getValuesCSR()
    K = PETSc.Mat().createAIJ(problem.local.getSize(), csr=csr, comm=PETSc.COMM_SELF)
    replace_local_matrix(problem, K)
    check_solution(ksp, problem, b)


def test_solver_takes_another_matrix_and_the_first_again(problem, torn_grid, create_ksp):
    """The other matrix has the same dofs in other subdomains."""
    ksp = create_ksp(problem.A, ksp_rtol=RTOL)
    check_solution(ksp, problem, random_values(problem))
    other = torn_grid((2, 1), (6, 2))
    ksp.setOperators(other.A)
    check_solution(ksp, other, random_values(other))
    ksp.setOperators(problem.A)
    check_solution(ksp, problem, random_values(problem))


# -- the version


def test_version_is_unchanged_by_solves_and_reads(problem, create_ksp):
    """A version can be hashed; neither a solve nor reading the matrix changes it."""
    before = version_of(problem.A)
    reason, _ = solve(create_ksp(problem.A, ksp_rtol=RTOL), problem, random_values(problem))
    agree(reason > 0)
    problem.A.getISLocalMat().getValuesCSR()
    problem.A.getNearNullSpace().getVecs()[0].norm()
    after = version_of(problem.A)
    agree(after == before and hash(after) == hash(before), (before, after))


def test_versions_of_replaced_matrices_differ(problem):
    """A version keeps its local matrix alive, so that a new one cannot have the same address.

    Two torn matrices with the same local matrix have different versions.
    """
    versions = []
    for _ in range(20):
        replace_by_scaled_copy(problem)
        versions.append(version_of(problem.A))
    agree(len({version.pattern for version in versions}) == len(set(versions)) == len(versions))
    sizes = problem.A.getSizes()[0]
    dofs = problem.A.getLGMap()[0].getIndices()
    other = create_torn_matrix(local_matrix(problem), np.asarray(dofs), sizes, comm=COMM)
    agree(version_of(other) != versions[-1])
    other.destroy()
