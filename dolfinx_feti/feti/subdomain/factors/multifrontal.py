# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The Schur complement and the factor of the interior in one sweep: the multifrontal method.

.. math:: K = \begin{pmatrix} K_{II} & K_{IΓ} \\ K_{ΓI} & K_{ΓΓ} \end{pmatrix}
            = \begin{pmatrix} U^⊤ & \\ W^⊤ & I \end{pmatrix}
              \begin{pmatrix} U & W \\ & S \end{pmatrix}, \qquad
          K_{II} = U^⊤ U, \qquad S = K_{ΓΓ} - W^⊤ W

(eq. 51; Duff and Reid 1983; Liu 1992; docs/theory.md). The fronts depend only on the pattern, and
are found once for all its matrices: :class:`Fronts` is a ``SymbolicFactor``. The algorithm is in C
(``multifrontal.c``); ``multifrontal.h`` documents its data types and contracts.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import scipy.sparse

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.subdomain.factors.nested_dissection import nested_dissection
from dolfinx_feti.feti.subdomain.factors.protocol import FactorInertia, destroyed_error
from dolfinx_feti.feti.subdomain.factors.work_space import WorkSpace
from dolfinx_feti.feti.subdomain.failures import RemediedFactorError
from dolfinx_feti.runtime.arrays import Array, Indices, Mask
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.native import address_of, load_with_header, pointer
from dolfinx_feti.runtime.petsc_library import CSRMatrix

SOURCE = Path(__file__).with_name("multifrontal.c")


class FrontCode:
    """The compiled code, with the routines of BLAS and LAPACK that it calls.

    Attributes:
        lib: The functions of ``multifrontal.h``.
        ffi: Its types.
        dense: The routines, a ``dense_routines *``.
    """

    def __init__(self, module: Any) -> None:
        """Set the addresses of the routines, from SciPy: ``dgemm`` for the field ``gemm``, etc."""
        self._module = module
        self.lib = module.lib
        self.ffi = module.ffi
        self.dense = self.ffi.new("dense_routines *")
        for name, field in self.ffi.typeof("dense_routines").fields:
            setattr(self.dense, name, self.ffi.cast(field.type, address_of("d" + name)))

    def pointer(self, array: npt.NDArray[Any]) -> Any:
        """Return a pointer to the entries of an array, column by column; it keeps the array."""
        return pointer(self._module, array, order="F")

    def struct(self, kind: str, **fields: Any) -> Any:
        """Return a pointer to a new struct.

        Args:
            kind: Name of its type.
            fields: Numbers and arrays. The struct does not keep the arrays alive: the caller has
                to, until the last call of C with the struct.
        """
        values = {
            name: self.pointer(value) if isinstance(value, np.ndarray) else value
            for name, value in fields.items()
        }
        return self.ffi.new(f"{kind} *", values)

    def require_done(self, status: int) -> None:
        """Raise the error of :meth:`error_of` unless the status of a C function is ``DONE``."""
        if status != self.lib.DONE:
            raise self.error_of(status)

    def error_of(self, status: int) -> Exception:
        """Return the error of a failed C function.

        Args:
            status: What the function returned; not ``DONE``.

        Returns:
            A MemoryError if there is no memory for the integers of the analysis or the
            factorisation; otherwise a FactorError, with a remedy if there is one.
        """
        if status == self.lib.NO_MEMORY:
            return MemoryError("no memory for the fronts of a subdomain")
        if status == self.lib.TOO_LARGE:
            return RemediedFactorError(
                "the subdomain is too large for 32-bit indices: take more subdomains"
            )
        if status == self.lib.INVALID:
            return FactorError("the graph of the subdomain, or the order of its nodes, is invalid")
        if status == self.lib.NEW_PATTERN:
            return RemediedFactorError(
                "the pattern of the matrix has changed since it was analysed: create a new solver"
            )
        return FactorError(f"the multifrontal code returned the unknown status {status}")


def load_fronts(comm: MPI.Comm) -> FrontCode:
    """Load the code, which is compiled at first use. Collective.

    Raises:
        RuntimeError: It cannot be compiled, on all processes.
    """
    module = load_with_header(SOURCE, comm)
    return on_all(lambda: FrontCode(module), comm)


class FrontElimination(NamedTuple):
    """The interior of one matrix, eliminated; an ``Elimination``.

    Attributes:
        factor: The factor of K_II.
        schur: S in packed format, (n_{Γ,i} (n_{Γ,i} + 1) / 2,).
    """

    factor: FrontFactor
    schur: Array


class Fronts:
    """The fronts of one subdomain, for all matrices of a pattern: a ``SymbolicFactor``.

    Attributes:
        code: The compiled code.
        tree: The fronts, an ``assembly_tree *`` of C.
        ranks: Place of each interior dof in the order of elimination, (n_{I,i},). These ranks are
            not those of MPI.
        last_dofs: Interior dofs that are pivots of the last front, (p,). If the interior is
            connected, they contain a separator that cuts it in two.
        factor_entries: Number of entries of the factor of K_II.
        work_entries: Number of entries of the work space of :meth:`factor`.
        flops: Operations of a factorisation, for benchmarks.
    """

    def __init__(
        self,
        code: FrontCode,
        rows: Indices,
        local_index: Indices,
        size: Indices,
        graph: tuple[Indices, Indices],
        is_on_interface: Mask,
    ) -> None:
        """Analyse the graph of a subdomain; see :func:`create_fronts` for its matrix.

        Args:
            code: The compiled code.
            rows: Rows of the subdomain in the matrix, ascending, (n_i,).
            local_index: Place of each row of the matrix among those of its subdomain, or a negative
                number, (n,).
            size: Number of consecutive rows of each node of the graph, (nodes,).
            graph: Place of the first neighbour of each node, (nodes + 1,), and all neighbours.
            is_on_interface: Mask of the nodes of Γ, (nodes,).

        Raises:
            FactorError: The arrays do not fit, or the subdomain is too large for 32-bit indices.
            MemoryError: There is no memory for the fronts.
        """
        ptr, adjacent = graph
        if not _is_graph(ptr, adjacent, len(size)) or len(is_on_interface) != len(size):
            raise code.error_of(code.lib.INVALID)
        if size.sum() != len(rows):
            raise code.error_of(code.lib.INVALID)
        order = nested_dissection(ptr, adjacent, np.flatnonzero(~is_on_interface).astype(np.int32))
        graph_in_C = code.struct(
            "subdomain_graph",
            nodes=len(size),
            size=size,
            ptr=ptr,
            adjacent=adjacent,
            interior_nodes=len(order),
            order=order,
        )
        result = code.ffi.new("assembly_tree **")
        code.require_done(code.lib.multifrontal_analyse(graph_in_C, result))
        tree = code.ffi.gc(result[0], code.lib.multifrontal_free)
        is_interface_dof = np.repeat(is_on_interface, size)
        rank_of_dof = np.frombuffer(
            code.ffi.buffer(tree.rank_of_dof, 4 * len(rows)), dtype=np.int32
        )
        self.code = code
        self.tree = tree
        self.ranks = rank_of_dof[~is_interface_dof].copy()
        interior_dof_of_rank = np.argsort(self.ranks)  # the inverse permutation
        self.last_dofs = interior_dof_of_rank[tree.last_front_rank :]
        self.factor_entries = int(tree.factor_entries)
        self.work_entries = int(tree.work_entries)
        self.flops = float(tree.flops)
        self._rows = rows
        self._local_index = local_index
        self._n_Γ = int(np.count_nonzero(is_interface_dof))

    def factor(self, K: CSRMatrix, work: WorkSpace) -> FrontElimination | None:
        """Factor K_II and form S of a matrix with the pattern of the analysis.

        Args:
            K: Matrix of all subdomains of the process, (n, n).
            work: Work space.

        Returns:
            The factor and S; None if K_II is not positive definite.

        Raises:
            FactorError: K has an entry outside of the pattern.
            MemoryError: Memory ran out.
        """
        return self._factor(K, None, work)

    def factor_sum(self, K: CSRMatrix, addend: Array, work: WorkSpace) -> FrontElimination | None:
        """Factor K_II with a dense matrix added on ``last_dofs``, like :meth:`factor`.

        Args:
            K: Matrix of all subdomains of the process, (n, n).
            addend: The dense matrix, symmetric, (p, p).
            work: Work space.

        Raises:
            ValueError: The addend has another shape.
        """
        p = len(self.last_dofs)
        if addend.shape != (p, p):
            raise ValueError(f"the addend has shape {addend.shape}, not ({p}, {p})")
        return self._factor(K, addend, work)

    def _factor(
        self, K: CSRMatrix, addend: Array | None, work: WorkSpace
    ) -> FrontElimination | None:
        """Factor K_II, with an addend on ``last_dofs``, (p, p), unless it is None."""
        code = self.code
        n = len(self._local_index)
        if len(K.indptr) != n + 1 or not len(K.indices) == len(K.values) == K.indptr[-1]:
            raise code.error_of(code.lib.NEW_PATTERN)
        values = np.empty(self.factor_entries)
        schur = np.zeros(self._n_Γ * (self._n_Γ + 1) // 2)
        work_entries = work.entries(self.work_entries)
        matrix = code.struct(
            "process_matrix",
            n=n,
            indptr=K.indptr,
            indices=K.indices,
            values=K.values,
            rows=self._rows,
            local_index=self._local_index,
        )
        storage = code.struct("factor_storage", factor=values, schur=schur, work=work_entries)
        entries = code.ffi.NULL if addend is None else code.pointer(np.asfortranarray(addend))
        status = code.lib.multifrontal_factor(self.tree, matrix, entries, storage, code.dense)
        if status == code.lib.NOT_DEFINITE:
            return None
        code.require_done(status)
        return FrontElimination(FrontFactor(self, values), schur)


class FrontFactor:
    """The factor of the K_II of one matrix, (n_{I,i}, n_{I,i}); methods are those of ``Factor``.

    Attributes:
        inertia: No negative eigenvalues, and no zero pivots: K_II is positive definite.
        is_single_precision: False.
        fronts: The fronts that it was computed with.
        values: U, packed, and the rows of W in the interior, front by front, (factor_entries,);
            None if the factor has been destroyed.
    """

    inertia = FactorInertia(0, 0)
    is_single_precision = False

    def __init__(self, fronts: Fronts, values: Array) -> None:
        """Own the entries of a factor."""
        self.fronts = fronts
        self.values: Array | None = values

    def solve(self, Y: Array, *, transpose: bool = False) -> Array:
        """Return K_II⁻¹ Y = U⁻¹ U⁻ᵀ Y, (n_{I,i},) or (n_{I,i}, r)."""
        if self.values is None:
            raise destroyed_error()
        code = self.fronts.code
        tree = self.fronts.tree
        ranks = self.fronts.ranks
        X = np.empty(Y.shape, order="F")
        X[ranks] = Y  # rows in the order of elimination
        if not X.size:
            return X
        columns = 1 if Y.ndim == 1 else Y.shape[1]
        size = tree.max_update_rows * columns
        if columns > 1:  # C unpacks U of a front into the work space
            size = max(size, tree.max_pivots**2)
        work = np.empty(max(size, 1))
        code.lib.multifrontal_solve(
            tree,
            code.pointer(self.values),
            columns,
            code.pointer(X),
            code.pointer(work),
            code.dense,
        )
        return X[ranks]

    def smallest_pivot(self) -> float:
        """Return the smallest square of a diagonal entry of U; infinity if there is none."""
        if self.values is None:
            raise destroyed_error()
        code = self.fronts.code
        values = code.pointer(self.values)
        return float(code.lib.multifrontal_smallest_pivot(self.fronts.tree, values))

    def memory(self) -> float:
        """Return the memory of the factor in MiB."""
        return 0.0 if self.values is None else self.values.nbytes / 2**20

    def destroy(self) -> None:
        """Free the entries."""
        self.values = None


def create_fronts(
    code: FrontCode,
    graph: scipy.sparse.csr_array,
    rows: Indices,
    local_index: Indices,
    bs: int,
    interface: Indices,
) -> Fronts:
    """Find the fronts of a subdomain of a matrix K, (n, n), with blocks of bs dofs.

    A node of their graph consists of the rows of one block that are all on Γ, or all in the
    interior.

    Args:
        code: The compiled code.
        graph: Which blocks K couples, (n / bs, n / bs).
        rows: Rows of the subdomain, ascending, (n_i,).
        local_index: Place of each row of K among those of its subdomain, or a negative number,
            (n,).
        bs: Dofs of a block.
        interface: Places of the dofs of Γ among the rows, ascending; if there are none, K_II is the
            matrix of the subdomain.

    Raises:
        FactorError: The subdomain is too large for 32-bit indices.
        MemoryError: There is no memory for the fronts.
    """
    block_of_row = rows // bs
    is_on_interface = np.zeros(len(rows), dtype=bool)
    is_on_interface[interface] = True
    begins_block = block_of_row[1:] != block_of_row[:-1]
    crosses_interface = is_on_interface[1:] != is_on_interface[:-1]
    begins_node = np.ones(len(rows), dtype=bool)
    begins_node[1:] = begins_block | crosses_interface
    size = np.bincount(np.cumsum(begins_node) - 1).astype(np.int32)
    block_of_node = block_of_row[begins_node]
    first = block_of_node.min(initial=len(local_index))
    last = block_of_node.max(initial=-1)
    nodes = graph[first : last + 1, first : last + 1]  # all of it, if the blocks are consecutive
    if np.any(np.diff(block_of_node) != 1):  # gaps, or two nodes in a block
        nodes = nodes[block_of_node - first][:, block_of_node - first]
    return Fronts(
        code, rows, local_index, size, (nodes.indptr, nodes.indices), is_on_interface[begins_node]
    )


def _is_graph(ptr: Indices, adjacent: Indices, nodes: int) -> bool:
    """Return True if the arrays are a graph: ``ptr`` ascends, neighbours are nodes."""
    if len(ptr) != nodes + 1 or ptr[0] != 0 or ptr[-1] != len(adjacent):
        return False
    if np.diff(ptr).min(initial=0) < 0:
        return False
    return bool(adjacent.min(initial=0) >= 0 and adjacent.max(initial=-1) < nodes)
