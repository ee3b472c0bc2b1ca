# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The torn matrix: the interface between the finite elements and both formulations.

Tearing (eq. 33) replaces the assembled matrix (eq. 32, Augustin_eq:reordered) by

.. math:: A = T^\top K\, T, \qquad K = \operatorname{diag}(K_1, …, K_p),

where the boolean :math:`T` copies each dof to every subdomain that holds it: PETSc's MATIS, with a
block-diagonal local matrix on each process and the map *torn dof → dof*. A subdomain is a connected
component of the graph of the local matrix. What else is attached: docs/torn_matrix.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.runtime.arrays import Array, Indices, Integers, Mask
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.connectivity import (
    block_graph,
    connected_blocks,
    copy_forest,
    diagonal_places,
    is_symmetric,
)
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.runtime.petsc_library import pattern_state, product, rows_of


def create_torn_matrix(
    K: PETSc.Mat,
    torn_to_global: Integers,
    sizes: tuple[int, int],
    *,
    comm: MPI.Comm,
    dirichlet: Integers | None = None,
    stiffness: Array | None = None,
    symmetric: bool | None = None,
) -> PETSc.Mat:
    """Wrap a block-diagonal local matrix as the MATIS :math:`A = T^⊤ K T`.

    Args:
        K: Sequential matrix of this process's subdomains, (n_torn, n_torn); it is not copied.
        torn_to_global: Global *block* index of each torn block, (n_torn / bs,).
        sizes: Owned and global number of dofs of the assembled problem.
        comm: Communicator of the assembled problem.
        dirichlet: Global dofs with a prescribed value; in ``K`` they are left free.
        stiffness: Stiffness of each torn dof for the stiffness scaling, (n_torn,); the diagonal of
            ``K`` if not given.
        symmetric: Whether ``K`` is, with all later entries, too; None: it is looked for each time.

    Returns:
        The torn matrix; the caller destroys it. Collective.
    """
    bs = K.getBlockSize()
    blocks = np.asarray(torn_to_global, dtype=PETSc.IntType)
    lgmap = PETSc.LGMap().create(blocks, bsize=bs, comm=comm)
    A = PETSc.Mat().create(comm)
    A.setSizes((sizes, sizes), bsize=bs)
    A.setType(PETSc.Mat.Type.IS)
    A.setISAllowRepeated(True)
    A.setLGMap(lgmap, lgmap)
    lgmap.destroy()
    if symmetric is not None:
        K.setOption(PETSc.Mat.Option.SYMMETRIC, symmetric)
        K.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
    A.setISLocalMat(K)
    A.assemble()
    if dirichlet is not None:
        dofs = np.asarray(dirichlet, dtype=PETSc.IntType)
        A.compose("dirichlet", PETSc.IS().createGeneral(dofs, comm=comm))
    if stiffness is not None:
        A.compose("stiffness", PETSc.Vec().createWithArray(stiffness.copy(), comm=PETSc.COMM_SELF))
    return A


def set_near_kernel(
    A: PETSc.Mat, modes: Sequence[PETSc.Vec], coordinates: Array | None = None
) -> None:
    """Attach the near kernel (rigid body modes, constants) of the assembled problem. Collective.

    Args:
        A: Torn matrix.
        modes: Linearly independent vectors; orthonormalised in place.
        coordinates: Where the owned blocks of dofs are, (owned blocks, dimension of space), NaN at
            no point; with them, the message about a singular problem tells what moves, and where.
    """
    for j, mode in enumerate(modes):
        for _ in range(2):  # the first pass leaves rounding errors of the size of the mode
            for other in modes[:j]:
                mode.axpy(-mode.dot(other), other)
            mode.normalize()
    space = PETSc.NullSpace().create(vectors=list(modes), comm=A.comm)
    A.setNearNullSpace(space)
    space.destroy()
    if coordinates is not None:
        points = np.array(coordinates, dtype=np.float64).ravel()
        A.compose("coordinates", PETSc.Vec().createWithArray(points, comm=A.comm))


def set_condensed(A: PETSc.Mat, pressures: int) -> None:
    """Note how many pressures each process has condensed into K; ``auto`` is primal then."""
    A.setAttr("pressures", pressures)


@dataclass(frozen=True, slots=True)
class State:
    """Names of what a torn matrix holds at one moment on this process; equal until it is changed.

    Without ``stateIncrease`` a change is not seen. The objects behind the names are kept, so that
    no new object gets their handles.
    """

    pattern: tuple[object, ...]
    values: tuple[object, ...]
    objects: tuple[PETSc.Object, ...] = field(compare=False, repr=False)

    def destroy(self) -> None:
        """Give the objects up; what Python drops waits in PETSc's garbage. Collective."""
        for owned in self.objects:
            owned.destroy()


def state_of(A: PETSc.Mat) -> State:
    """Return the state of a torn matrix on this process; of another matrix, its name alone."""
    if A.getType() != PETSc.Mat.Type.IS:
        return State((A.handle,), (A.stateGet(),), (copy(A),))
    K, maps, spaces = A.getISLocalMat(), A.getLGMap(), (A.getNearNullSpace(), A.getNullSpace())
    modes = [mode for space in spaces if space.handle for mode in space.getVecs()]
    dirichlet, stiffness, coordinates = map(A.query, ("dirichlet", "stiffness", "coordinates"))
    pattern = (
        *((M.handle, M.getSizes(), M.getBlockSizes(), M.getType()) for M in (A, K)),
        *pattern_state(K),
        *(lgmap.handle for lgmap in maps),
        None if dirichlet is None else dirichlet.getIndices().tobytes(),
    )
    values = (
        *(space.handle for space in spaces),
        A.getAttr("pressures"),
        *(each and (each.handle, each.stateGet()) for each in (A, K, stiffness, coordinates)),
        *((mode.handle, mode.stateGet()) for mode in modes),
    )
    vectors = (each for each in (stiffness, coordinates) if each is not None)
    return State(pattern, values, (copy(A), K, *maps, *modes, *spaces, *vectors))


def prescribed_dofs(A: PETSc.Mat) -> Mask:
    """Return the mask of the owned dofs of a torn matrix with a prescribed value. Collective."""
    mark, dofs = A.createVecRight(), A.query("dirichlet")
    if dofs is not None:
        indices = dofs.getIndices()
        mark.setValues(indices, np.ones(len(indices)))
    mark.assemble()
    mask = mark.array_r > 0.5
    mark.destroy()
    return np.asarray(mask)


class Torn:
    """A torn matrix as the solver sees it: blocks, copies, near kernel, Dirichlet dofs.

    Attributes:
        A: The MATIS.
        K: Its local block-diagonal matrix, (n, n) on this process.
        n: Number of torn dofs of this process.
        start: First torn dof of this process in the numbering over all processes.
        graph: Which blocks of dofs K couples, (n / bs, n / bs).
        subdomains: For each subdomain its torn dofs, ascending.
        first: Number of the first subdomain of this process over all processes.
        prescribed: Mask of the owned dofs with a prescribed value, (owned,).
        dirichlet: Mask of their copies, (n,).
        owned: Number of dofs of the assembled problem that this process owns.
    """

    def __init__(self, A: PETSc.Mat) -> None:
        """Read the pattern of ``A``, which has to be a MATIS of square AIJ blocks."""
        if A.getType() != PETSc.Mat.Type.IS:
            raise TypeError(
                f"The matrix has type '{A.getType()}', but FETI needs the torn matrix (MATIS): "
                "make it with dolfinx_feti.create_torn_matrix, or use dolfinx_feti.LinearProblem."
            )
        self.comm = A.comm.tompi4py()
        with Lifetime() as owned:
            self.A = owned.own(copy(A))  # another reference
            self.K = owned.own(A.getISLocalMat())
            self.n, columns = self.K.getSize()
            is_aij = self.K.getType().startswith("seqaij")
            if self.comm.allreduce(self.n != columns or not is_aij, op=MPI.LOR):
                raise ValueError(
                    f"The local matrix has type '{self.K.getType()}' and size {self.K.getSize()}; "
                    "FETI needs square AIJ matrices, one block per subdomain."
                )
            self.start = self.comm.scan(self.n) - self.n
            self.owned = A.getLocalSize()[0]
            self.read_pattern()
            self.first = self.comm.scan(len(self.subdomains)) - len(self.subdomains)
            self._sf = owned.own(copy_forest(A))
            self.prescribed = prescribed_dofs(A)
            self.dirichlet = self.tear(self.prescribed) > 0.5
            self._owned = owned.pop_all()

    def read_pattern(self) -> None:
        """Read the pattern of K. Collective."""

        def read() -> None:
            bs = self.K.getBlockSize()
            with rows_of(self.K) as of_K:
                self.graph = block_graph(of_K, bs)
            self._diagonal = diagonal_places(self.K)
            self.subdomains = connected_blocks(self.graph, bs)

        on_all(read, self.comm)

    def multiply(self, t: Array, *, transpose: bool = False) -> Array:
        """Return K t, or Kᵀ t, for a vector, (n,), or several columns, (n, r)."""
        return product(self.K, t, transpose=transpose) if t.any() else np.zeros_like(t)

    def tear(self, x: npt.ArrayLike) -> Array:
        """Copy the owned values of an assembled vector, (owned,), to the subdomains, T x, (n,)."""
        torn, root = np.zeros(self.n), np.ascontiguousarray(x, dtype=np.float64)
        self._sf.bcastBegin(MPI.DOUBLE, root, torn, MPI.REPLACE)
        self._sf.bcastEnd(MPI.DOUBLE, root, torn, MPI.REPLACE)
        return torn  # T x

    def assemble(self, torn: Array) -> Array:
        """Sum the copies of each owned dof, :math:`T^⊤ t`, (owned,)."""
        root, leaf = np.zeros(self.owned), np.ascontiguousarray(torn)
        self._sf.reduceBegin(MPI.DOUBLE, leaf, root, MPI.SUM)
        self._sf.reduceEnd(MPI.DOUBLE, leaf, root, MPI.SUM)
        return root  # Tᵀ t

    def residual(self, b: PETSc.Vec, x: PETSc.Vec, r: PETSc.Vec) -> None:
        """Let r be b − A x, (N,), zero on Dirichlet dofs. Collective."""
        force = self.multiply(self.tear(x.array_r))
        r.array[:] = np.where(self.prescribed, 0.0, b.array_r - self.assemble(force))  # b − A x

    def multiplicity(self) -> Indices:
        """Count the copies of each owned dof, (owned,)."""
        return np.asarray(self._sf.computeDegree(), dtype=np.int32)

    def gather(self, torn: Array) -> Array:
        """Gather the values of all copies on the owner of their dof, in the order of the dofs."""
        copies, leaf = np.zeros(int(self.multiplicity().sum())), np.ascontiguousarray(torn)
        self._sf.gatherBegin(MPI.DOUBLE, leaf, copies)
        self._sf.gatherEnd(MPI.DOUBLE, leaf, copies)
        return copies

    def near_kernel(self) -> Array:
        """Return the near kernel on the torn dofs, (n, number of modes)."""
        space = self.A.getNearNullSpace()
        modes = [self.tear(mode.array_r) for mode in space.getVecs()] if space.handle else []
        modes += [np.ones(self.n)] if space.handle and space.hasConstant() else []
        if not modes and self.A.getBlockSize() > 1:
            raise SetUpError(
                "The torn matrix carries no near kernel, and with a block size of "
                f"{self.A.getBlockSize()} none can be guessed: attach the rigid body modes with "
                "dolfinx_feti.set_near_kernel."
            )
        return np.column_stack(modes or [np.ones(self.n)])

    def coordinates(self) -> Array | None:
        """Return where each torn dof is, (n, dimension); None if not attached. Collective."""
        points = self.A.query("coordinates")
        if points is None:
            return None
        bs = self.A.getBlockSize()
        x = points.array_r.reshape(self.owned // bs, -1) if self.owned else np.zeros((0, 0))
        dim = self.comm.allreduce(x.shape[1], op=MPI.MAX)
        torn = np.zeros((self.n, dim))
        for j in range(dim):
            torn[:, j] = self.tear(np.repeat(x[:, j], bs) if self.owned else np.zeros(0))
        return torn

    def diagonal(self) -> Array:
        """Return the diagonal of K, (n,)."""
        with rows_of(self.K) as csr:
            return np.where(self._diagonal < 0, 0.0, csr.values[self._diagonal])

    def stiffness(self) -> Array:
        """Return the stiffness of each torn dof for the scaling, (n,); a weight is not negative."""
        weight = self.A.query("stiffness")
        return np.abs(self.diagonal() if weight is None else weight.array_r)

    @property
    def pressures(self) -> int | None:
        """Number of pressures that have been condensed into the local matrix; None without."""
        return self.A.getAttr("pressures")  # type: ignore[no-any-return]

    def is_symmetric(self) -> bool:
        """Tell whether the matrices of all subdomains are symmetric. Collective."""
        return is_symmetric(self.A)

    def destroy(self) -> None:
        """Free the star forest, and give the matrix up."""
        self._owned.close()
