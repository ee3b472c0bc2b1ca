# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The Schur complement and the factor of the interior at once, front by front (``fronts.c``).

.. math:: K = \begin{pmatrix} K_{II} & K_{IΓ} \\ K_{ΓI} & K_{ΓΓ} \end{pmatrix}
            = \begin{pmatrix} U^⊤ & \\ W^⊤ & I \end{pmatrix}
              \begin{pmatrix} U & W \\ & S \end{pmatrix}, \qquad
          K_{II} = U^⊤ U, \qquad S = K_{ΓΓ} - W^⊤ W

(eq. 51) by Cholesky's factorisation that stops at the interface. It is the multifrontal method
(Duff and Reid 1983; Liu 1992): the interior falls into groups of dofs, the *pivots* of a front,
which are eliminated together; the *border* of a front is what its pivots and those of its
children touch later, Γ included. A front is a small dense matrix,

.. math:: \begin{pmatrix} P & Q \\ & C \end{pmatrix} \mapsto
          U = \operatorname{chol} P, \quad W = U^{-⊤} Q, \quad C - W^⊤ W,

and the last block is added to the front of its parent, at the roots to S. The groups follow from an
ordering by nested dissection (METIS, Karypis and Kumar 1998, or PETSc). So nearly all work is
that of BLAS on dense matrices, which divides by the narrow triangles on the diagonal of U through
their inverses. MUMPS, which offers S as well (``schur``), and with pivots, takes three times as
long for interiors of this size, S and then the factor of :math:`K_{II}`.

There are no pivots to choose as long as :math:`K_{II}` is positive definite. A pivot that is not
positive ends the factorisation, and :meth:`Fronts.factor` tells so.
"""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.connectivity import coupled_nodes, load_graph_code
from dolfinx_feti.native import address_of, load_or_do_without, pointer
from dolfinx_feti.petsc_library import Rows, function

__all__ = ["FrontCode", "Fronts", "load_fronts", "load_fronts_for"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]
Numbers = npt.NDArray[np.int64]

#: Orderings of PETSc that are tried without METIS; that with the least estimate of time is taken.
ORDERINGS = ("nd", "amd")

#: Of METIS: the number of its options, and the code of success.
METIS_OPTIONS, METIS_OK = 40, 1

ROUTINES = ("dpotrf", "dtrtri", "dtrsm", "dtrmm", "dsyrk", "dgemm", "dtrsv", "dgemv")

DECLARATIONS = """
typedef struct {
    int n_I, count, *rank, *first, widest;
    int64_t *factor, work;
    double seconds;
    ...;
} fronts;
typedef struct { ...; } dense;
fronts *fronts_analyse(int, const int *, const int *, const int *, int, const int *);
int fronts_factor(const fronts *, const int *, const int *, const int *, const int *,
                  const double *, const double *, double *, double *, double *, int *, int *,
                  int *, int *, const dense *);
void fronts_solve(const fronts *, const double *, int, double *, double *, const dense *);
void fronts_free(fronts *);
"""


class FrontCode:
    """The compiled code, with the routines of BLAS and LAPACK that it calls."""

    def __init__(self, module: Any, graph: Any) -> None:
        self.module = module
        self.graph = graph
        self.lib = module.lib
        self._routines = module.ffi.new("intptr_t[]", [address_of(name) for name in ROUTINES])
        self.blas = module.ffi.cast("dense *", self._routines)

    def to(self, array: npt.NDArray[Any]) -> Any:
        """Return a pointer to the entries of an array."""
        return pointer(self.module, array)


def load_fronts(comm: MPI.Comm) -> FrontCode | None:
    """Load the code, which is compiled at first use; None if it cannot be compiled. Collective."""
    graph = load_graph_code(comm)
    module = load_or_do_without(Path(__file__).with_name("fronts.c"), DECLARATIONS, comm)
    return None if graph is None or module is None else FrontCode(module, graph)


def load_fronts_for(prefix: str, comm: MPI.Comm) -> FrontCode | None:
    """Load the code, unless the options with this prefix name a solver. Collective."""
    options = PETSc.Options(prefix)
    named = options.hasName("pc_factor_mat_solver_type") or options.hasName("pc_type")
    return None if named else load_fronts(comm)


class Fronts:
    """The fronts of one subdomain and, once factored, the factor of its K_II.

    Attributes:
        factored: Whether there is a factor of the K of the last :meth:`factor`.
        entries: Entries of the factor.
        last: Pivots of the last front, among the dofs of the interior.
        work: Entries of the work space of :meth:`factor`.
    """

    def __init__(
        self,
        code: FrontCode,
        K: Rows,
        rows: Indices,
        number: Indices,
        bs: int,
        interface: Indices,
    ) -> None:
        """Find the fronts.

        Args:
            code: What :func:`load_fronts` returns.
            K: Symmetric matrix that holds that of the subdomain, with both triangles, (N, N).
            rows: Rows of the subdomain, ascending, (n,).
            number: For each column its place among these rows, or a negative number, (N,).
            bs: Size of the blocks, or nodes, that consecutive rows of K belong to.
            interface: Which of the rows are Γ, ascending; none, and K_II is K.
        """
        n, blocks = len(rows), rows // bs
        glued = np.zeros(n, dtype=bool)
        glued[interface] = True
        new = np.ones(n, dtype=bool)
        new[1:] = (np.diff(blocks) != 0) | (np.diff(glued))
        node = np.cumsum(new, dtype=np.int32) - 1
        size = np.bincount(node).astype(np.int32)
        self._code = code
        self._rows, self._number = rows, number
        self._n_Γ = len(interface)
        graph = coupled_nodes(code.graph, K, rows, number, node, len(size))
        self._fronts = self._analyse(graph, size, np.flatnonzero(~glued[new]).astype(np.int32))
        rank = np.frombuffer(code.module.ffi.buffer(self._fronts.rank, 4 * n), dtype=np.int32)
        self._rank = rank[~glued].copy()  # of the dofs of the interior, ascending
        self._factor = np.zeros(0)
        self.factored = False
        count = self._fronts.count
        first = self._fronts.first[count - 1] if count else 0
        self.last = np.argsort(self._rank)[first:]
        self.entries = int(self._fronts.factor[count])
        self.work = int(self._fronts.work)

    def _analyse(self, graph: tuple[Indices, Indices], size: Indices, interior: Indices) -> Any:
        """Try all orderings of the nodes of the interior, and return the best fronts."""
        code, best = self._code, None
        for order in _orders(*graph, interior):
            found = code.lib.fronts_analyse(
                len(size),
                code.to(size),
                *map(code.to, graph),
                len(interior),
                code.to(order),
            )
            if found == code.module.ffi.NULL:
                raise MemoryError("no memory for the analysis of a subdomain")
            found = code.module.ffi.gc(found, code.lib.fronts_free)
            if best is None or found.seconds < best.seconds:
                best = found
        return best

    def factor(self, K: Rows, work: Array, held: Array | None = None) -> Array | None:
        """Factor K_II and form S.

        Args:
            K: Matrix of the same pattern, (N, N).
            work: Work space, (at least ``work``,).
            held: Added to K_II on the dofs ``last``, (len(last), len(last)).

        Returns:
            S in packed format, (n_Γ (n_Γ + 1) / 2,), see ``dense``; None, and no factor, if K_II is
            not positive definite.
        """
        to, n = self._code.to, len(self._rows)
        if not len(self._factor):
            self._factor = np.empty(self.entries)
        S = np.zeros(self._n_Γ * (self._n_Γ + 1) // 2)
        places = [np.empty(n + 1, dtype=np.int32) for _ in range(4)]
        failed = self._code.lib.fronts_factor(
            self._fronts,
            to(self._rows),
            to(K.indptr),
            to(K.indices),
            to(self._number),
            to(K.values),
            self._code.module.ffi.NULL if held is None else to(held),
            to(self._factor),
            to(S),
            to(work),
            *(to(place) for place in places),
            self._code.blas,
        )
        if failed:
            self.release()
            return None
        self.factored = True
        return S

    def solve(self, Y: Array) -> Array:
        """Return K_II⁻¹ Y for one right-hand side, (n_I,), or several, (n_I, r)."""
        X = np.empty(Y.shape, order="F")
        X[self._rank] = Y
        columns = 1 if Y.ndim == 1 else Y.shape[1]
        work = np.empty(max(1, self._fronts.widest * columns))
        to = self._code.to
        if X.size:
            self._code.lib.fronts_solve(
                self._fronts, to(self._factor), columns, to(X), to(work), self._code.blas
            )
        return X[self._rank]  # U⁻¹ U⁻ᵀ Y

    def release(self) -> None:
        """Free the factor."""
        self._factor = np.zeros(0)
        self.factored = False

    def memory(self) -> float:
        """Return the memory of the factor in MiB."""
        return self._factor.nbytes / 2**20


def _orders(ptr: Indices, adjacent: Indices, interior: Indices) -> list[Indices]:
    """Order the nodes of the interior for elimination: by METIS, else in both ways of PETSc."""
    place = np.full(len(ptr) - 1, -1, dtype=np.int32)
    place[interior] = np.arange(len(interior))
    row, column = np.repeat(place, np.diff(ptr)), place[adjacent]
    inside = (row >= 0) & (column >= 0) & (row != column)
    row, column = row[inside], column[inside]
    if len(row) == 0:
        return [interior]
    begin = np.searchsorted(row, np.arange(len(interior) + 1))
    symmetric = _is_symmetric(row, column, len(interior))
    dissected = _dissect(begin, column) if symmetric else None
    orders = _orders_of_petsc(begin, column) if dissected is None else [dissected]
    return [interior[order] for order in orders]


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


def _orders_of_petsc(ptr: Numbers, adjacent: Indices) -> list[Indices]:
    """Order nodes in each of the ways that PETSc has."""
    csr = (ptr.astype(PETSc.IntType), adjacent.astype(PETSc.IntType), np.ones(len(adjacent)))
    graph = PETSc.Mat().createAIJ((len(ptr) - 1,) * 2, csr=csr, comm=PETSc.COMM_SELF)
    orders = []
    for name in ORDERINGS:
        try:
            order, columns = graph.getOrdering(name)
        except PETSc.Error:  # a PETSc without SuiteSparse knows no amd
            continue
        orders.append(order.indices.astype(np.int32))
        order.destroy()
        columns.destroy()
    graph.destroy()
    return orders
