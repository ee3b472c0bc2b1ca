# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The torn matrix: the interface between the finite elements and both formulations.

Tearing (eq. 33 of the paper, Augustin, Holzapfel and Steinbach 2014) replaces the assembled matrix
(eq. 32) by

.. math:: A = T^\top K\, T, \qquad K = \operatorname{diag}(K_1, …, K_p),

where the Boolean matrix :math:`T` copies each dof to every subdomain that has it. A is a MATIS of
PETSc, with a block-diagonal local matrix K on each process and the map *torn dof → dof*. A
subdomain is a connected component of the graph of K. Further data are attached to the matrix under
the names below (docs/torn_matrix.md). In shapes, this process has n torn dofs, and owns N dofs of
the assembled problem.
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
from dolfinx_feti.runtime.arrays import Array, Integers, Mask, Numbers
from dolfinx_feti.runtime.collective import logger, on_all
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.runtime.petsc_library import csr_of, pattern_version, product
from dolfinx_feti.runtime.star_forest import (
    Value,
    broadcast,
    create_star_forest,
    gather_leaves,
    sum_leaves,
)
from dolfinx_feti.torn.connectivity import block_graph, diagonal_places, rows_of_components
from dolfinx_feti.torn.symmetry import is_symmetric

#: Name of the IS of global dofs with a prescribed value that is attached to a torn matrix.
DIRICHLET_DOFS = "dirichlet"

#: Name of the Vec with the stiffness of each torn dof for the stiffness scaling, (n,).
STIFFNESS = "stiffness"

#: Name of the Vec with the coordinates of the owned blocks of dofs.
COORDINATES = "coordinates"

#: Name of the number of pressures that were condensed into the local matrix.
CONDENSED_PRESSURES = "condensed pressures"

#: Error for an assembled matrix of the type {0}.
NOT_TORN = (
    "The matrix has type '{0}', but FETI needs a torn matrix (MATIS), because an assembled one no "
    "longer has the subdomains. With forms of UFL use the matrix of a problem: problem = "
    "dolfinx_feti.LinearProblem(a, L, bcs=bcs); A, b = problem.linear_system(), or that of a "
    "NonlinearProblem; from matrices of the subdomains create one by "
    "dolfinx_feti.create_torn_matrix (see docs/own_matrix.md)."
)

#: Error for a matrix without a type: PETSc creates an empty one where it is given a destroyed one.
DESTROYED = (
    "The matrix has no type, as after its destruction: a torn matrix is destroyed with the problem "
    "it belongs to. Keep the problem as long as the matrix, as in problem = "
    "dolfinx_feti.LinearProblem(a, L, bcs=bcs); A, b = problem.linear_system()."
)


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
    """Wrap a block-diagonal local matrix as the MATIS :math:`A = T^⊤ K T`. Collective.

    Args:
        K: Sequential matrix of this process's subdomains, (n, n); it is not copied.
        torn_to_global: Global *block* index of each torn block, (n / bs,).
        sizes: Owned and global number of dofs of the assembled problem.
        comm: Communicator of the assembled problem.
        dirichlet: Global dofs with a prescribed value; ``K`` keeps their rows and columns.
        stiffness: Stiffness of each torn dof for the stiffness scaling, (n,); the diagonal of
            ``K`` if not given.
        symmetric: Whether ``K`` is symmetric, now and with all later entries. If None, symmetry is
            detected from the entries of each matrix.

    Returns:
        The torn matrix; the caller destroys it.

    Raises:
        ValueError: ``torn_to_global`` does not fit ``K`` or the size, or ``dirichlet`` does not fit
            the size. On all processes.
    """
    bs = K.getBlockSize()
    on_all(lambda: _require_map(torn_to_global, K.getSize()[0], sizes[1], bs, dirichlet), comm)
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
        A.compose(DIRICHLET_DOFS, PETSc.IS().createGeneral(dofs, comm=comm))
    if stiffness is not None:
        A.compose(STIFFNESS, PETSc.Vec().createWithArray(stiffness.copy(), comm=PETSc.COMM_SELF))
    return A


def _require_map(
    torn_to_global: Integers, n: int, size: int, bs: int, dirichlet: Integers | None
) -> None:
    """Check that blocks and Dirichlet dofs exist in the assembled problem.

    Args:
        torn_to_global: Global block of each torn block of this process, (n / bs,).
        n: Number of rows of the local matrix.
        size: Number of dofs of the assembled problem.
        bs: Number of dofs in a block.
        dirichlet: Global dofs with a prescribed value.

    Raises:
        ValueError: A block or dof does not exist, or the number of blocks does not fit n. Raised on
            this process alone.
    """
    if len(torn_to_global) * bs != n:
        raise ValueError(
            f"torn_to_global has {len(torn_to_global)} numbers, but the local matrix has {n} rows "
            f"in blocks of {bs}: give the global block of each of the {n // bs} torn blocks."
        )
    _require_range("torn_to_global", torn_to_global, size // bs, "block")
    if dirichlet is not None:
        _require_range("dirichlet", dirichlet, size, "dof")


def _require_range(name: str, numbers: Integers, count: int, kind: str) -> None:
    """Check that all entries of an argument are indices of blocks or dofs, 0 … count − 1."""
    values = np.asarray(numbers)
    wrong = values[(values < 0) | (values >= count)]
    if len(wrong):
        raise ValueError(
            f"{name} has the number {wrong[0]}, but the {kind}s of the assembled problem are "
            f"0 … {count - 1}: give the global number of each {kind}."
        )


def _require_square_aij(K: PETSc.Mat) -> None:
    """Check that a local matrix is square and AIJ; raise a ValueError on this process alone."""
    rows, columns = K.getSize()
    if rows != columns or not K.getType().startswith("seqaij"):
        raise ValueError(
            f"A local matrix has type '{K.getType()}' and size {rows} × {columns}, but FETI needs "
            "square AIJ matrices with one block for each subdomain: convert it to 'seqaij', or "
            "assemble it by subdomains."
        )


def set_near_kernel(
    A: PETSc.Mat, modes: Sequence[PETSc.Vec], coordinates: Array | None = None
) -> None:
    """Attach the near kernel (rigid body modes, constants) of the assembled problem. Collective.

    Args:
        A: Torn matrix.
        modes: Linearly independent vectors; orthonormalised in place.
        coordinates: Coordinates of the owned blocks of dofs, (owned blocks, dimension of space),
            NaN for a block without a point. If they are given, the message about a singular problem
            says what moves, and where.
    """
    for j, mode in enumerate(modes):
        for _ in range(2):  # the second pass removes the rounding errors of the first
            for other in modes[:j]:
                mode.axpy(-mode.dot(other), other)
            mode.normalize()
    space = PETSc.NullSpace().create(vectors=list(modes), comm=A.comm)
    A.setNearNullSpace(space)
    space.destroy()
    if coordinates is not None:
        points = np.array(coordinates, dtype=np.float64).ravel()
        A.compose(COORDINATES, PETSc.Vec().createWithArray(points, comm=A.comm))


def set_condensed_pressures(A: PETSc.Mat, count: int) -> None:
    """Attach the number of pressures that were condensed into K.

    Args:
        A: Torn matrix.
        count: Number on this process.
    """
    A.setAttr(CONDENSED_PRESSURES, count)


@dataclass(frozen=True, slots=True)
class MatrixVersion:
    """Version of a torn matrix and its parts on this process: PETSc's handles and change counts.

    Equal versions mean an unchanged matrix. Changes of entries are detected only if PETSc counts
    them: code that writes to the arrays of the matrix has to call ``stateIncrease``.

    Attributes:
        pattern: Handles, sizes and counts that change with the pattern, and the Dirichlet dofs.
        values: Handles and counts that change with the entries, or with data that are attached.
        objects: References that keep the objects alive: no new object can get their handles.
    """

    pattern: tuple[object, ...]
    values: tuple[object, ...]
    objects: tuple[PETSc.Object, ...] = field(compare=False, repr=False)

    def destroy(self) -> None:
        """Free the references. Collective.

        Otherwise Python's garbage collector would free them at another time on each process, and
        PETSc would postpone their destruction until all processes agree.
        """
        for owned in self.objects:
            owned.destroy()


def version_of(A: PETSc.Mat) -> MatrixVersion:
    """Return the version of a torn matrix on this process.

    The version of a matrix that is not a MATIS consists of its handle and change count only:
    ``Torn`` refuses such a matrix.
    """
    if A.getType() != PETSc.Mat.Type.IS:
        return MatrixVersion((A.handle,), (A.stateGet(),), (copy(A),))
    K = A.getISLocalMat()
    maps = A.getLGMap()
    spaces = (A.getNearNullSpace(), A.getNullSpace())
    modes = [mode for space in spaces if space.handle for mode in space.getVecs()]
    dirichlet = A.query(DIRICHLET_DOFS)
    stiffness = A.query(STIFFNESS)
    coordinates = A.query(COORDINATES)
    vectors = [vector for vector in (stiffness, coordinates) if vector is not None]

    pattern: list[object] = [lgmap.handle for lgmap in maps]
    for matrix in (A, K):
        pattern += [matrix.handle, matrix.getSizes(), matrix.getBlockSizes(), matrix.getType()]
    pattern += pattern_version(K)
    pattern.append(None if dirichlet is None else dirichlet.getIndices().tobytes())

    values: list[object] = [space.handle for space in spaces]
    values.append(A.getAttr(CONDENSED_PRESSURES))
    values += [stiffness is None, coordinates is None]
    for part in (A, K, *vectors, *modes):
        values += [part.handle, part.stateGet()]

    objects = (copy(A), K, *maps, *modes, *spaces, *vectors)  # copy(A) is another reference
    return MatrixVersion(tuple(pattern), tuple(values), objects)


def read_dirichlet_mask(A: PETSc.Mat) -> Mask:
    """Return the mask of the dofs of a torn matrix with a prescribed value, (N,). Collective."""
    mark = A.createVecRight()
    dofs = A.query(DIRICHLET_DOFS)
    if dofs is not None:
        indices = dofs.getIndices()
        mark.setValues(indices, np.ones(len(indices)))
    mark.assemble()
    mask = mark.array_r > 0.5
    mark.destroy()
    return np.asarray(mask)


class Torn:
    """A torn matrix as the solver reads it: subdomains, copies, near kernel, Dirichlet dofs.

    Attributes:
        comm: Communicator of A.
        A: The MATIS.
        K: Its local block-diagonal matrix, (n, n) on this process.
        n: Number of torn dofs of this process.
        first_torn_dof: First torn dof of this process in the numbering over all processes.
        graph: Pattern of K by blocks of bs dofs, (n / bs, n / bs).
        subdomains: Torn dofs of each subdomain of this process, ascending, (n_i,).
        first_subdomain: Number of the first subdomain of this process over all processes.
        N: Number of dofs of the assembled problem that this process owns.
        is_dirichlet: Mask of the dofs with a prescribed value, (N,).
        is_dirichlet_copy: Mask of the copies of these dofs, (n,).
        is_unused: Mask of the dofs without a copy on any process, (N,).
    """

    def __init__(self, A: PETSc.Mat) -> None:
        """Read the pattern of a torn matrix. Collective.

        Args:
            A: MATIS with square AIJ blocks.

        Raises:
            TypeError: A is not a MATIS.
            ValueError: A local matrix is not square or not AIJ. On all processes.
        """
        self.comm = A.comm.tompi4py()
        if A.getType() != PETSc.Mat.Type.IS:
            text = DESTROYED if A.getType() is None else NOT_TORN.format(A.getType())
            if self.comm.rank == 0:
                logger.error(text)  # callers in C and C++ get only PETSc's error number
            raise TypeError(text)
        with Lifetime() as owned:
            self.A = owned.own(copy(A))  # another reference
            self.K = owned.own(A.getISLocalMat())
            on_all(lambda: _require_square_aij(self.K), self.comm)
            self.n = self.K.getSize()[0]
            self.first_torn_dof = self.comm.scan(self.n) - self.n
            self.N = A.getLocalSize()[0]
            self._read_pattern()
            self.first_subdomain = self.comm.scan(len(self.subdomains)) - len(self.subdomains)
            torn_to_global = A.getLGMap()[0].getIndices()
            self._sf = owned.own(create_star_forest(torn_to_global, self.N, self.comm))
            self.is_unused = self.multiplicity() == 0
            self.is_dirichlet = read_dirichlet_mask(A)
            self.is_dirichlet_copy = self.tear(self.is_dirichlet.astype(np.int64)) > 0
            self._owned = owned.pop_all()

    def with_local_matrix(self, K: PETSc.Mat) -> Torn:
        """Return a torn matrix in which another local matrix replaces K. Collective.

        ``graph`` and ``subdomains`` are read from the new matrix. All else, such as the star forest
        and the numbers of dofs and subdomains, is shared with this object. ``A`` still holds the
        old K, and so do the answers of ``is_symmetric`` and ``near_kernel``. The result must not be
        used after :meth:`destroy` of this object. Its own :meth:`destroy` frees nothing.

        Args:
            K: Square AIJ matrix with the subdomains of this object, (n, n). The caller destroys it.
        """
        other = copy(self)
        other.K = K
        other._owned = Lifetime()
        other._read_pattern()
        return other

    def _read_pattern(self) -> None:
        """Set ``graph`` and ``subdomains`` from the pattern of K. Collective."""

        def read() -> None:
            bs = self.K.getBlockSize()
            with csr_of(self.K) as csr:
                self.graph = block_graph(csr, bs)
            self._diagonal_places = diagonal_places(self.K)
            self.subdomains = rows_of_components(self.graph, bs)

        on_all(read, self.comm)

    def multiply(self, t: Array, *, transpose: bool = False) -> Array:
        """Return K t, or Kᵀ t, for a vector, (n,), or several columns, (n, r)."""
        if not t.any():  # prescribed values often are zero; the check costs little
            return np.zeros_like(t)
        return product(self.K, t, transpose=transpose)

    def tear(self, x: npt.NDArray[Value]) -> npt.NDArray[Value]:
        """Copy the owned entries of an assembled vector to the subdomains, T x. Collective.

        Args:
            x: Floating-point numbers or 64-bit integers, (N,).

        Returns:
            The copies, of the same type, (n,).
        """
        return broadcast(self._sf, x, self.n)

    def assemble(self, t: Array) -> Array:
        """Sum the copies of each owned dof, :math:`T^⊤ t`, (n,) → (N,). Collective."""
        return sum_leaves(self._sf, t, self.N)

    def residual(self, b: PETSc.Vec, x: PETSc.Vec, r: PETSc.Vec) -> None:
        """Compute r = b − A x, (N,), zero on Dirichlet dofs. Collective."""
        force = self.multiply(self.tear(x.array_r))
        r.array[:] = np.where(self.is_dirichlet, 0.0, b.array_r - self.assemble(force))

    def multiplicity(self) -> Numbers:
        """Return the number of copies of each owned dof, (N,). Collective."""
        return np.asarray(self._sf.computeDegree(), dtype=np.int64)

    def gather(self, t: npt.NDArray[Value]) -> npt.NDArray[Value]:
        """Gather the values of all copies on the owner of their dof. Collective.

        Args:
            t: Floating-point numbers or 64-bit integers, (n,).

        Returns:
            The values of the copies of the first owned dof, of the second one, and so on, (sum of
            ``multiplicity()``,).
        """
        return gather_leaves(self._sf, t, self.multiplicity())

    def near_kernel(self) -> Array:
        """Return the near kernel on the torn dofs, (n, r); constants by default. Collective.

        Raises:
            SetUpError: No near kernel is attached, and the block size is larger than one.
        """
        space = self.A.getNearNullSpace()
        modes: list[Array] = []
        if space.handle:
            modes += [self.tear(mode.array_r) for mode in space.getVecs()]
            if space.hasConstant():
                modes.append(np.ones(self.n))
        if not modes and self.A.getBlockSize() > 1:
            raise SetUpError(
                "The torn matrix has no near kernel, and for a block size of "
                f"{self.A.getBlockSize()} there is no default: attach the rigid body modes with "
                "dolfinx_feti.set_near_kernel."
            )
        return np.column_stack(modes or [np.ones(self.n)])

    def coordinates(self) -> Array | None:
        """Return the coordinates of each torn dof, (n, dimension); None if not attached.

        Collective.
        """
        points = self.A.query(COORDINATES)
        if points is None:
            return None
        bs = self.A.getBlockSize()
        x = points.array_r.reshape(self.N // bs, -1) if self.N else np.zeros((0, 0))
        dim = self.comm.allreduce(x.shape[1], op=MPI.MAX)
        torn = np.zeros((self.n, dim))
        for j in range(dim):
            torn[:, j] = self.tear(np.repeat(x[:, j], bs) if self.N else np.zeros(0))
        return torn

    def diagonal(self) -> Array:
        """Return the diagonal of K, (n,)."""
        with csr_of(self.K) as csr:
            places = self._diagonal_places
            return np.where(places < 0, 0.0, csr.values[places])

    def stiffness(self) -> Array:
        """Return the stiffness of each torn dof for the scaling, (n,), not negative."""
        weight = self.A.query(STIFFNESS)
        return np.abs(self.diagonal() if weight is None else weight.array_r)

    @property
    def n_condensed_pressures(self) -> int | None:
        """Number of pressures that have been condensed into K; None if no number is attached."""
        return self.A.getAttr(CONDENSED_PRESSURES)  # type: ignore[no-any-return]

    def is_symmetric(self) -> bool:
        """Return True if the matrices of all subdomains are symmetric. Collective."""
        return is_symmetric(self.A)

    def destroy(self) -> None:
        """Free the star forest and the references to the matrix."""
        self._owned.close()
