# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A torn matrix may be changed by its owner; the next solve uses the changed one."""

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


def local(problem):
    """Return the present local matrix."""
    return problem.A.getISLocalMat()


def replaced(problem, K):
    """Replace the local matrix; there are no other references to the old or the new one."""
    problem.A.setISLocalMat(K)
    problem.A.assemble()
    K.destroy()


def scaled_copy(problem):
    K = local(problem).copy()
    K.scale(5.0)
    replaced(problem, K)


def spring(i, j):
    """Return entries that tie two torn dofs."""
    return ((i, i, 7.0), (j, j, 7.0), (i, j, -7.0), (j, i, -7.0))


def added(problem, i, j):
    """Add a matrix of other pattern, a spring between two torn dofs of each process."""
    n = local(problem).getSize()[0]
    X = PETSc.Mat().createAIJ((n, n), nnz=2, comm=PETSc.COMM_SELF)
    for row, column, value in spring(i, j) if n else ():
        X.setValue(row % n, column % n, value, addv=PETSc.InsertMode.ADD)
    X.assemble()
    local(problem).axpy(1.0, X, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    problem.A.assemble()
    X.destroy()


def inserted(problem, entries):
    """Add entries to the local matrix of the last process, one after the other."""
    K = local(problem)
    if LAST and K.getSize()[0]:
        K.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        for i, j, value in entries:
            K.setValue(i, j, value, addv=PETSc.InsertMode.ADD)
    problem.A.assemble()


def fewer_entries(problem):
    """The same dofs, no longer coupled by the smallest entries."""
    indptr, indices, values = local(problem).getValuesCSR()
    K = scipy.sparse.csr_array((values, indices, indptr), local(problem).getSize()).tocoo()
    small = np.abs(K.data) <= 0.2
    K.col[small] = K.row[small]  # constants stay the kernel
    replaced(problem, aij(K.tocsr()))


def numbering(problem):
    """The first two torn dofs of each process change places in the assembled numbering."""
    K = local(problem)
    dofs = problem.A.getLGMap()[0].getIndices().copy()
    dofs[:2] = dofs[:2][::-1].copy()
    lgmap = PETSc.LGMap().create(dofs, bsize=1, comm=COMM)
    problem.A.setLGMap(lgmap, lgmap)  # drops the local matrix
    problem.A.setISLocalMat(K)
    problem.A.assemble()
    lgmap.destroy()


def local_values(problem):
    """Set values through the torn matrix, in the local numbering."""
    if local(problem).getSize()[0]:
        problem.A.setValueLocal(1, 1, 2.5, addv=PETSc.InsertMode.ADD)
    problem.A.assemble()


def owned(problem, dofs):
    """Return the dofs of these that this process owns."""
    first, last = problem.A.getOwnershipRange()
    return dofs[(first <= dofs) & (dofs < last)].astype(PETSc.IntType)


def other_dirichlet(problem):
    """Prescribe the opposite side."""
    dofs = np.flatnonzero(problem.x[:, 0] == problem.x[:, 0].max())
    problem.A.compose("dirichlet", PETSc.IS().createGeneral(owned(problem, dofs), comm=COMM))


def dirichlet_in_place(problem):
    """The same index set has one dof more, the last, on the process that owns it."""
    dofs = np.append(np.flatnonzero(problem.dirichlet), len(problem.dirichlet) - 1)
    problem.A.query("dirichlet").setIndices(owned(problem, dofs))


def stiffness(problem):
    weight = PETSc.Vec().createSeq(local(problem).getSize()[0], comm=PETSc.COMM_SELF)
    weight.array[:] = 1.0 + np.arange(weight.getSize()) % 3
    problem.A.compose("stiffness", weight)


def near_kernel(problem):
    one = problem.A.createVecRight()
    one.set(-1.0)
    set_near_kernel(problem.A, [one])


def near_kernel_in_place(problem):
    """PETSc locks the vectors; who insists can still change them."""
    mode = problem.A.getNearNullSpace().getVecs()[0]
    unlock, lock = (c_function(f"VecLockRead{way}", (ctypes.c_void_p,)) for way in ("Pop", "Push"))
    unlock(mode.handle)
    mode.scale(-1.0)
    lock(mode.handle)


#: Changes of the pattern.
PATTERN = {
    "local matrix replaced": scaled_copy,
    # the first one is freed, so that PETSc may use its address again
    "local matrix replaced twice": lambda p: (scaled_copy(p), scaled_copy(p)),
    "entries added in a subdomain": lambda p: added(p, 0, 8),
    "two subdomains joined": lambda p: added(p, 0, -4),
    "entries inserted": lambda p: inserted(p, spring(0, 8)),
    "entries removed": fewer_entries,
    "numbering": numbering,
    "block size": lambda p: local(p).setBlockSize(3),
    "other Dirichlet dofs": other_dirichlet,
    "Dirichlet dofs in place": dirichlet_in_place,
}

#: Changes of the values alone.
VALUES = {
    "local matrix scaled": lambda p: local(p).scale(2.0),
    "torn matrix scaled": lambda p: p.A.scale(0.1),
    "one entry": lambda p: inserted(p, [(0, 0, 11.0)]),
    "values in the local numbering": local_values,
    "diagonal": lambda p: local(p).setDiagonal(3.0 * local(p).getDiagonal()),
    "stiffness": stiffness,
    "stiffness in place": lambda p: p.A.query("stiffness").scale(4.0),
    "near kernel": near_kernel,
    "near kernel in place": near_kernel_in_place,
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
    stiffness(torn)
    return torn


def holds_two_copies(problem):
    """Two subdomains that share dofs are joined: on three processes, which hold neighbours."""
    torn = Torn(problem.A)
    joined = has_repeated_dofs(problem.A, torn.subdomains)
    torn.destroy()
    return joined


def solved(ksp, problem, b):
    """Assert that the solution is that of the present matrix, or that an error has the reason."""
    reason, x = solve(ksp, problem, b)
    if holds_two_copies(problem):
        message = ksp.getPythonContext().message
        agree(reason < 0 and not x.any() and "two copies of a dof" in message, message)
        return
    agree(reason > 0, ksp.getPythonContext().message)
    expected = whole(solve_assembled(problem.A, problem.vector(b)))
    equal(x, expected, CONDITION * RTOL)


def test_neighbours_joined_are_refused(torn_grid, create_ksp):
    """Two subdomains on each process, neighbours on it; on one process they are all there are."""
    problem = torn_grid((2 * COMM.size, 1), (2, 2))
    ksp = create_ksp(problem.A, ksp_rtol=RTOL)
    PATTERN["two subdomains joined"](problem)
    agree(holds_two_copies(problem))
    solved(ksp, problem, random_values(problem))


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("name", CHANGES)
def test_next_solve_sees(name, options, problem, create_ksp):
    ksp = create_ksp(problem.A, ksp_rtol=RTOL, **options)
    b = random_values(problem)
    solved(ksp, problem, b)
    before = version_of(problem.A)
    CHANGES[name](problem)
    after = version_of(problem.A)  # is another one on some process, and in its proper part
    pattern = COMM.allreduce(after.pattern != before.pattern)
    values = COMM.allreduce(after.values != before.values)
    agree((pattern > 0) == (name in PATTERN) and (pattern or values), (pattern, values))
    solved(ksp, problem, b)
    solved(ksp, problem, 2.0 * b)


@pytest.mark.parametrize("options", OPTIONS)
def test_one_change_after_the_other(options, problem, create_ksp):
    ksp = create_ksp(problem.A, ksp_rtol=RTOL, **options)
    b = random_values(problem)
    for change in CHANGES.values():
        change(problem)
        solved(ksp, problem, b)


WITHOUT = {
    "dirichlet": (lambda A: A.compose("dirichlet", None), "singular"),
    "near kernel": (lambda A: A.setNearNullSpace(PETSc.NullSpace()), "set_near_kernel"),
}


@each(("take", "words"), WITHOUT)
def test_what_goes_is_missed(take, words, torn_grid, create_ksp):
    """The message names the remedy; with the same objects back there is a solution again."""
    problem = torn_grid((2, 2), (2, 2), components=2)
    ksp = create_ksp(problem.A, ksp_rtol=RTOL)
    b = random_values(problem)
    solved(ksp, problem, b)
    held = problem.A.query("dirichlet")
    modes = problem.A.getNearNullSpace()
    take(problem.A)
    reason, x = solve(ksp, problem, b)
    message = ksp.getPythonContext().message
    agree(reason < 0 and not x.any() and words in message, message)
    problem.A.compose("dirichlet", held)
    problem.A.setNearNullSpace(modes)
    solved(ksp, problem, b)


def test_unblocked_local_matrix(torn_grid, create_ksp):
    """Two components, and a local matrix that does not know of them."""
    problem = torn_grid((2, 2), (2, 2), components=2)
    ksp = create_ksp(problem.A, ksp_rtol=RTOL)
    b = random_values(problem)
    solved(ksp, problem, b)
    csr = problem.local.getValuesCSR()
    K = PETSc.Mat().createAIJ(problem.local.getSize(), csr=csr, comm=PETSc.COMM_SELF)
    replaced(problem, K)
    solved(ksp, problem, b)


def test_another_matrix(problem, torn_grid, create_ksp):
    """Another matrix has the same dofs in other subdomains."""
    ksp = create_ksp(problem.A, ksp_rtol=RTOL)
    solved(ksp, problem, random_values(problem))
    other = torn_grid((2, 1), (6, 2))
    ksp.setOperators(other.A)
    solved(ksp, other, random_values(other))
    ksp.setOperators(problem.A)
    solved(ksp, problem, random_values(problem))


# -- the version


def test_version_stays_where_nothing_changes(problem, create_ksp):
    """It can be hashed, and neither a solve nor a look at the matrix changes it."""
    before = version_of(problem.A)
    reason, _ = solve(create_ksp(problem.A, ksp_rtol=RTOL), problem, random_values(problem))
    agree(reason > 0)
    problem.A.getISLocalMat().getValuesCSR()
    problem.A.getNearNullSpace().getVecs()[0].norm()
    after = version_of(problem.A)
    agree(after == before and hash(after) == hash(before), (before, after))


def test_version_keeps_what_it_names(problem):
    """A local matrix that is freed cannot hand its address on; another matrix may hold the same."""
    seen = []
    for _ in range(20):
        scaled_copy(problem)
        seen.append(version_of(problem.A))
    agree(len({version.pattern for version in seen}) == len(set(seen)) == len(seen))
    sizes = problem.A.getSizes()[0]
    dofs = problem.A.getLGMap()[0].getIndices()
    other = create_torn_matrix(local(problem), np.asarray(dofs), sizes, comm=COMM)
    agree(version_of(other) != seen[-1])
    other.destroy()
