# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The Schur complement and the factor of the interior at once: the multifrontal method.

.. math:: K = \begin{pmatrix} K_{II} & K_{IΓ} \\ K_{ΓI} & K_{ΓΓ} \end{pmatrix}
            = \begin{pmatrix} U^⊤ & \\ W^⊤ & I \end{pmatrix}
              \begin{pmatrix} U & W \\ & S \end{pmatrix}, \qquad
          K_{II} = U^⊤ U, \qquad S = K_{ΓΓ} - W^⊤ W

(eq. 51; Duff and Reid 1983; Liu 1992; docs/theory.md). The order of elimination is that of nested
dissection (METIS, Karypis and Kumar 1998, or PETSc), found once for a pattern.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy.sparse

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.subdomain.factors.protocol import Pivots
from dolfinx_feti.runtime.arrays import Array, Indices, Mask, Numbers
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.runtime.native import address_of, load, pointer
from dolfinx_feti.runtime.petsc_library import Rows, function

#: Of METIS: the number of its options, and the code of success.
METIS_OPTIONS, METIS_OK = 40, 1

ROUTINES = ("dpotrf", "dtrtri", "dtrsm", "dtrmm", "dsyrk", "dgemm", "dtpsv", "dgemv")

DECLARATIONS = """
enum { DONE, NO_MEMORY, TOO_LARGE, INVALID, NOT_DEFINITE, NEW_PATTERN };
typedef struct { int n_I, count, widest, thickest, last, *rank; int64_t entries, work;
    double flops; ...; } fronts;
typedef struct { ...; } dense;
int fronts_analyse(int, const int *, const int *, const int *, int, const int *, fronts **);
int fronts_factor(const fronts *, int, const int *, const int *, const int *, const int *,
                  const double *, const double *, double *, double *, double *, const dense *);
void fronts_solve(const fronts *, const double *, int, double *, double *, const dense *);
double fronts_least_pivot(const fronts *, const double *);
void fronts_free(fronts *);
"""


class FrontCode:
    """The compiled code, with the routines of BLAS and LAPACK that it calls."""

    def __init__(self, module: Any) -> None:
        self.module = module
        self.lib = module.lib
        self._routines = module.ffi.new("intptr_t[]", [address_of(name) for name in ROUTINES])
        self.blas = module.ffi.cast("dense *", self._routines)

    def to(self, array: npt.NDArray[Any]) -> Any:
        """Return a pointer to the entries of an array, column by column."""
        return pointer(self.module, array, order="F")

    def check(self, status: int) -> None:
        """Raise the error that a status means."""
        if status == self.lib.NO_MEMORY:
            raise MemoryError("no memory for the fronts of a subdomain")
        if status == self.lib.TOO_LARGE:
            raise FactorError("the subdomain is too large for 32-bit indices: take more subdomains")
        if status == self.lib.INVALID:
            raise FactorError("the graph of the subdomain, or the order of its nodes, is invalid")
        if status == self.lib.NEW_PATTERN:
            raise FactorError("the pattern of the matrix has changed since it was analysed")


def load_fronts(comm: MPI.Comm) -> FrontCode:
    """Load the code, which is compiled at first use. Collective."""
    module = load(Path(__file__).with_name("multifrontal.c"), DECLARATIONS, comm)
    return on_all(lambda: FrontCode(module), comm)


def load_fronts_for(prefix: str, comm: MPI.Comm) -> FrontCode | None:
    """Load the code, unless the options with this prefix name a solver. Collective."""
    options = PETSc.Options(prefix)
    named = options.hasName("pc_factor_mat_solver_type") or options.hasName("pc_type")
    return None if named else load_fronts(comm)


class Fronts:
    """The fronts of one subdomain, of all matrices of a pattern; immutable.

    Attributes:
        code: The compiled code.
        data: What it has found.
        rows: Rows of the subdomain in the matrix, ascending, (n,).
        ranks: Place of each dof of the interior in the order of elimination, (n_I,).
        last: Pivots of the last front, among the dofs of the interior.
        entries: Entries of the factor of K_II.
        work: Entries of the work space of :meth:`factor`.
        flops: Operations of a factorisation.
    """

    def __init__(
        self,
        code: FrontCode,
        rows: Indices,
        number: Indices,
        size: Indices,
        graph: tuple[Indices, Indices],
        glued: Mask,
    ) -> None:
        """Find the fronts, as ``create_fronts``, of nodes of consecutive rows, ``size`` each, (m,).

        The graph has the nodes that each is coupled with: where they begin, (m + 1,), and numbers.
        The nodes of Γ are ``glued``, (m,). A FactorError tells that a subdomain is too large.
        """
        ptr, adjacent = graph
        m, entries = len(size), len(adjacent)
        fits = len(ptr) == m + 1 == len(glued) + 1 and size.sum() == len(rows)
        fits = fits and ptr[0] == 0 and ptr[-1] == entries and np.diff(ptr).min(initial=0) >= 0
        if not fits or adjacent.min(initial=0) < 0 or adjacent.max(initial=-1) >= m:
            code.check(code.lib.INVALID)
        interior = _order(*graph, np.flatnonzero(~glued).astype(np.int32))
        made = code.module.ffi.new("fronts **")
        arrays = map(code.to, (size, ptr, adjacent))
        code.check(code.lib.fronts_analyse(m, *arrays, len(interior), code.to(interior), made))
        data = code.module.ffi.gc(made[0], code.lib.fronts_free)
        of_rows = np.repeat(glued, size)
        rank = np.frombuffer(code.module.ffi.buffer(data.rank, 4 * len(rows)), dtype=np.int32)
        self.code, self.data = code, data
        self.rows = rows
        self.ranks = rank[~of_rows].copy()
        self.last = np.argsort(self.ranks)[data.last :]
        self.entries = int(data.entries)
        self.work = int(data.work)
        self.flops = float(data.flops)
        self._number = number
        self._n_Γ = int(np.count_nonzero(of_rows))

    def factor(
        self, K: Rows, work: Array, held: Array | None = None
    ) -> tuple[FrontFactor, Array] | None:
        """Factor K_II and form S of a K of the same pattern, (N, N); None if K_II is not definite.

        In a work space, (at least ``work``,). Added to K_II on the dofs ``last`` is ``held``. S is
        in packed format, (n_Γ (n_Γ + 1) / 2,), see ``dense``.

        Raises:
            FactorError: K has an entry that the pattern does not have.
        """
        code, N = self.code, len(self._number)
        if len(K.indptr) != N + 1 or not len(K.indices) == len(K.values) == K.indptr[-1]:
            code.check(code.lib.NEW_PATTERN)
        if len(work) < self.work:
            raise ValueError(f"work has {len(work)} entries, but {self.work} are needed")
        if held is not None and held.shape != (len(self.last),) * 2:
            raise ValueError(f"held has shape {held.shape}, but last {len(self.last)} dofs")
        values = np.empty(self.entries)
        S = np.zeros(self._n_Γ * (self._n_Γ + 1) // 2)
        matrix = (self.rows, K.indptr, K.indices, self._number, K.values)
        status = code.lib.fronts_factor(
            self.data,
            N,
            *(code.to(array) for array in matrix),
            code.module.ffi.NULL if held is None else code.to(np.asfortranarray(held)),
            *(code.to(array) for array in (values, S, work)),
            code.blas,
        )
        if status == code.lib.NOT_DEFINITE:
            return None
        code.check(status)
        return FrontFactor(self, values), S


@dataclass(frozen=True, slots=True)
class FrontFactor:
    """The factor of the K_II of one matrix; methods are those of ``Factor``.

    Attributes:
        fronts: The fronts that it was made with.
        values: U, packed, and the rows of W in the interior, front by front, (entries,).
    """

    fronts: Fronts
    values: Array

    @property
    def pivots(self) -> Pivots:
        """Numbers of negative and zero eigenvalues."""
        return Pivots(0, 0)

    def memory(self) -> float:
        """Return the memory of the factor in MiB."""
        return self.values.nbytes / 2**20

    def least_pivot(self) -> float:
        """Return the least square of a diagonal entry of U: what elimination leaves of K_II's."""
        code = self.fronts.code
        return float(code.lib.fronts_least_pivot(self.fronts.data, code.to(self.values)))

    def solve(self, Y: Array, *, transpose: bool = False) -> Array:
        """Return K_II⁻¹ Y for one right-hand side, (n_I,), or several, (n_I, r)."""
        code, fronts, ranks = self.fronts.code, self.fronts.data, self.fronts.ranks
        X = np.empty(Y.shape, order="F")
        X[ranks] = Y
        columns = 1 if Y.ndim == 1 else Y.shape[1]
        triangle = fronts.thickest**2 if columns > 1 else 0
        work = np.empty(max(fronts.widest * columns, triangle, 1))
        if X.size:
            values, entries, space = (code.to(array) for array in (self.values, X, work))
            code.lib.fronts_solve(fronts, values, columns, entries, space, code.blas)
        return X[ranks]  # U⁻¹ U⁻ᵀ Y

    def destroy(self) -> None:
        """Do nothing: arrays are freed with the object."""


def create_fronts(
    code: FrontCode,
    graph: scipy.sparse.csr_array,
    rows: Indices,
    number: Indices,
    bs: int,
    interface: Indices,
) -> Fronts:
    """Find the fronts of a subdomain: ascending rows, (n,), of K, (N, N), of block size bs.

    The graph is that of the blocks of K, (N / bs, N / bs), and ``number`` has for each column of K
    its place among the rows, or a negative number. ``interface`` are those of the rows, ascending,
    that are Γ; none, and K_II is K.
    """
    n, blocks = len(rows), rows // bs
    glued = np.zeros(n, dtype=bool)
    glued[interface] = True
    new = np.ones(n, dtype=bool)
    new[1:] = (np.diff(blocks) != 0) | (np.diff(glued))
    size = np.bincount(np.cumsum(new) - 1).astype(np.int32)
    block = blocks[new]  # of each node
    first, last = block.min(initial=len(number)), block.max(initial=-1)
    nodes = graph[first : last + 1, first : last + 1]
    if np.any(np.diff(block) != 1):
        nodes = nodes[block - first][:, block - first]
    return Fronts(code, rows, number, size, (nodes.indptr, nodes.indices), glued[new])


def _order(ptr: Indices, adjacent: Indices, interior: Indices) -> Indices:
    """Order the nodes of the interior by nested dissection: METIS's, or PETSc's without it."""
    place = np.full(len(ptr) - 1, -1, dtype=np.int32)
    place[interior] = np.arange(len(interior))
    row, column = np.repeat(place, np.diff(ptr)), place[adjacent]
    inside = (row >= 0) & (column >= 0) & (row != column)
    row, column = row[inside], column[inside]
    if len(row) == 0:
        return interior
    begin = np.searchsorted(row, np.arange(len(interior) + 1))
    symmetric = _is_symmetric(row, column, len(interior))
    dissected = _dissect(begin, column) if symmetric else None
    return interior[_order_of_petsc(begin, column) if dissected is None else dissected]


def _is_symmetric(row: Indices, column: Indices, n: int) -> bool:
    """Tell, by random numbers, whether (j, i) is among the pairs wherever (i, j) is."""
    x, y = np.random.default_rng(1998).integers(2**63, size=(2, n), dtype=np.uint64)
    return bool(np.sum(x[row] * y[column]) == np.sum(x[column] * y[row]))  # modulo 2⁶⁴


def _dissect(ptr: Numbers, adjacent: Indices) -> Indices | None:
    """Order nodes by METIS's nested dissection; None where PETSc is not linked with METIS.

    The graph has to be symmetric and without loops: with others METIS may never end. Its integers
    have 32 or 64 bits; the options that it sets to −1 tell.
    """
    dissect = function("METIS_NodeND", (ctypes.c_void_p,) * 7)
    set_options = function("METIS_SetDefaultOptions", (ctypes.c_void_p,))
    if dissect is None or set_options is None:
        return None
    options = np.zeros(METIS_OPTIONS, dtype=np.int64)
    set_options(options.ctypes.data)
    kind = np.int64 if np.all(options == -1) else np.int32
    n = np.array([len(ptr) - 1], dtype=kind)
    graph = [part.astype(kind) for part in (ptr, adjacent)]
    order, rank = np.empty((2, int(n[0])), dtype=kind)
    pointers = [None if a is None else a.ctypes.data for a in (n, *graph, None, None, order, rank)]
    done = dissect(*pointers) == METIS_OK
    is_one = done and np.array_equal(np.sort(order), np.arange(len(order)))
    return order.astype(np.int32) if is_one else None


def _order_of_petsc(ptr: Numbers, adjacent: Indices) -> Indices:
    """Order nodes by PETSc's nested dissection."""
    csr = (ptr.astype(PETSc.IntType), adjacent.astype(PETSc.IntType), np.ones(len(adjacent)))
    with Lifetime() as owned:
        graph = owned.own(PETSc.Mat().createAIJ((len(ptr) - 1,) * 2, csr=csr, comm=PETSc.COMM_SELF))
        order, _ = map(owned.own, graph.getOrdering("nd"))
        return np.asarray(order.indices.astype(np.int32))
