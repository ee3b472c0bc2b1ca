# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Assembly of a coarse matrix from one dense element matrix for each subdomain.

.. math:: A_0 = \sum_i C_i^⊤ (W_i^⊤ S_i W_i)\, C_i

:math:`W_i^⊤ S_i W_i`, (c_i, c_i), is the *element matrix* of subdomain i; :math:`C_i` is its dof
map (``dofmap``). A block, the coarse dofs that one subdomain contributes, is in an element matrix
as a whole or not at all. So a coarse matrix consists of dense sub-matrices, one for each pair of
blocks of a common subdomain. The sum on a process uses this structure; PETSc then adds those of all
processes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from petsc4py import PETSc

import numpy as np
import scipy.sparse

from dolfinx_feti.feti.coarse.basis import SubdomainColumns
from dolfinx_feti.feti.coarse.dofmap import CoarseDofMap, consecutive_numbers
from dolfinx_feti.feti.subdomain.failures import on_subdomains
from dolfinx_feti.runtime.arrays import Array, Indices, Numbers, concatenate, consecutive_slices
from dolfinx_feti.runtime.native import load_with_header, pointer
from dolfinx_feti.torn.matrix import create_torn_matrix


class CoarseAssembler:
    """Sum of the element matrices of all subdomains.

    Call :meth:`add` once for each subdomain, so that one element matrix at a time is in memory, and
    then :meth:`assemble`.
    """

    def __init__(self, by_subdomain: Sequence[SubdomainColumns], dofmap: CoarseDofMap) -> None:
        """Create a zero matrix. Collective.

        Args:
            by_subdomain: The columns of each subdomain of this process.
            dofmap: Owners of their coarse dofs.

        Raises:
            SetUpError: The matrix does not fit into memory; on all processes.
        """
        comm = dofmap.comm
        self._dofmap = dofmap
        self._code = load_with_header(Path(__file__).with_name("assembly.c"), comm)
        self._pattern, self._blocks_of_subdomains = on_subdomains(
            lambda: create_block_pattern(by_subdomain), comm
        )
        self._values = on_subdomains(lambda: np.zeros(self._pattern.start[-1]), comm)

    def add(self, i: int, element: Array) -> None:
        """Add the element matrix of subdomain i of this process, (c_i, c_i). Not collective.

        Raises:
            ValueError: The element matrix has another shape.
        """
        blocks = self._blocks_of_subdomains[i]
        c_i = int(self._pattern.width[blocks].sum())
        if element.shape != (c_i, c_i):
            raise ValueError(f"element matrix {i} is {element.shape}, not ({c_i}, {c_i})")
        add_element(self._code, self._pattern, blocks, element, self._values)

    def assemble(self) -> PETSc.Mat:
        """Return the sum over all processes, (N_c, N_c). Collective.

        PETSc's MATIS, a torn matrix, adds up rows that several processes have.

        Returns:
            The matrix, distributed like coarse vectors, (n_c,); the caller destroys it.
        """
        dofmap = self._dofmap
        local = _create_matrix(self._pattern, self._values)
        torn = create_torn_matrix(
            local, self._pattern.dofs, (dofmap.n_c, dofmap.N_c), comm=dofmap.comm
        )
        matrix = PETSc.Mat()
        torn.convert("aij", matrix)
        torn.destroy()
        local.destroy()
        return matrix


@dataclass(frozen=True, slots=True)
class BlockPattern:
    """Sparsity pattern of the sum of the element matrices of a process.

    It is a graph of blocks in compressed rows: two blocks of a common subdomain are *adjacent*, and
    each block is adjacent to itself. All rows of a block have the same columns, the dofs of the
    adjacent blocks. Values are stored block by block, and row by row in a block.

    Attributes:
        first_dof: First dof of each block, numbered over all processes, ascending, (blocks,).
        width: Number of dofs of each block, at least one, (blocks,).
        ptr: Index in ``adjacent`` of the first adjacent block of each block, and the end,
            (blocks + 1,).
        adjacent: Adjacent blocks of each block, ascending, (adjacent pairs,).
        column: First column of each adjacent block within a row of values, (adjacent pairs,).
        start: Index of the first value of each block, and the end, (blocks + 1,).
    """

    first_dof: Numbers
    width: Indices
    ptr: Indices
    adjacent: Indices
    column: Indices
    start: Numbers

    @property
    def dofs(self) -> Numbers:
        """Coarse dof of each row, numbered over all processes, (rows,)."""
        return consecutive_numbers(self.first_dof, self.width)

    @property
    def row_lengths(self) -> Numbers:
        """Number of values in each row of each block, (blocks,)."""
        return np.floor_divide(np.diff(self.start), self.width, dtype=np.int64)


def create_block_pattern(
    by_subdomain: Sequence[SubdomainColumns],
) -> tuple[BlockPattern, list[Indices]]:
    """Return the pattern of the sum of element matrices.

    Args:
        by_subdomain: The columns of each subdomain. Panels of the same block, on several
            subdomains, have the same first dof.

    Returns:
        The pattern, and for each subdomain the block of each of its panels, (panels of W_i,).
    """
    first_dofs = concatenate([columns.first_dofs for columns in by_subdomain], np.int64)
    widths = concatenate([columns.W.widths for columns in by_subdomain], np.int32)
    panels = consecutive_slices([len(columns.first_dofs) for columns in by_subdomain])
    first_dof_of_block, inverse = np.unique(first_dofs, return_inverse=True)
    block_of_panel = inverse.astype(np.int32)
    block_width = np.zeros(len(first_dof_of_block), dtype=np.int32)
    block_width[block_of_panel] = widths
    ones = np.ones(len(block_of_panel), dtype=np.int32)
    panel_ends = [0, *(of_subdomain.stop for of_subdomain in panels)]
    blocks_of_subdomain = scipy.sparse.csr_array(
        (ones, block_of_panel, panel_ends), (len(panels), len(first_dof_of_block))
    )
    graph = scipy.sparse.csr_array(blocks_of_subdomain.T @ blocks_of_subdomain)
    graph.sort_indices()
    ptr = graph.indptr.astype(np.int32, copy=False)
    adjacent = graph.indices.astype(np.int32, copy=False)

    width_before = np.append(0, np.cumsum(block_width[adjacent]))  # over all adjacent pairs
    row_length = np.diff(width_before[ptr])
    column = width_before[:-1] - np.repeat(width_before[ptr[:-1]], np.diff(ptr))
    pattern = BlockPattern(
        first_dof=first_dof_of_block,
        width=block_width,
        ptr=ptr,
        adjacent=adjacent,
        column=column.astype(np.int32),
        start=np.cumsum(np.append(0, block_width * row_length)),
    )
    return pattern, [block_of_panel[of_subdomain] for of_subdomain in panels]


def add_element(
    code: Any, pattern: BlockPattern, blocks: Indices, element: Array, values: Array
) -> None:
    """Add an element matrix to the values of a pattern.

    Args:
        code: Module of the compiled ``assembly.c`` (cffi's modules have no type).
        pattern: The pattern.
        blocks: Blocks of the rows and columns of the element matrix, ascending.
        element: The element matrix, (c_i, c_i), with the dofs of these blocks.
        values: Values of the sum, changed in place, (pattern.start[-1],).

    Raises:
        ValueError: Two of the blocks are not adjacent, because the pattern was made for other
            subdomains. The values are useless then.
    """
    address = partial(pointer, code)
    element = np.ascontiguousarray(element)
    matrix = {
        "width": address(pattern.width),
        "ptr": address(pattern.ptr),
        "adjacent": address(pattern.adjacent),
        "column": address(pattern.column),
        "start": address(pattern.start),
        "values": address(values),
    }
    added = {"count": len(blocks), "blocks": address(blocks), "values": address(element)}
    status = code.lib.add_element(
        code.ffi.new("element_matrix *", added), code.ffi.new("block_matrix *", matrix)
    )
    if status:
        raise ValueError("an element matrix has two blocks that are not adjacent in the pattern")


def _create_matrix(pattern: BlockPattern, values: Array) -> PETSc.Mat:
    """Create the sequential matrix of a pattern, (rows, rows).

    Args:
        pattern: The pattern.
        values: Its values, which PETSc does not copy; petsc4py keeps a reference to them.
    """
    width = pattern.width[pattern.adjacent]
    first_row = np.cumsum(pattern.width) - pattern.width  # of each block in this matrix
    columns = consecutive_numbers(first_row[pattern.adjacent], width)  # of one row of each block
    length = pattern.row_lengths
    end = np.cumsum(length)
    indices = np.empty(len(values), dtype=np.int32)
    for block in range(len(pattern.width)):
        of_block = slice(pattern.start[block], pattern.start[block + 1])
        rows = indices[of_block].reshape(-1, length[block])
        rows[:] = columns[end[block] - length[block] : end[block]]  # the same for each row
    indptr = np.append(0, np.cumsum(np.repeat(length, pattern.width)))
    n = int(pattern.width.sum())
    csr = (indptr.astype(PETSc.IntType), indices.astype(PETSc.IntType, copy=False), values)
    return PETSc.Mat().createAIJWithArrays((n, n), csr, comm=PETSc.COMM_SELF)
