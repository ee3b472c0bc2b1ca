# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Functions in a NumPy archive that any number of processes can read.

For each process p that wrote, the archive holds its owned cells, their dofs, and the values of
these. A reader finds the values in a cell by the cell's index in the input mesh::

    {p}/cells         (cells,) int64        indices of the owned cells in the input mesh
    {p}/permutations  (cells,) uint32       dolfinx's permutation info: the orientations of the
                                            cells' edges and faces, as bits
    {p}/dofs {i}      (cells, dofs) int32   their dofs in function i: local numbers of blocks
    {p}/values {i} {t}  (n · bs,) float64   function i at instant t, ghosts included, as in
                                            ``x.array``, in the user's units
    head.json         text                  all else, as JSON

Instants are numbered from the oldest; the last one is the present state. Earlier instants may hold
the first functions only.
"""

from __future__ import annotations

import json
import os
import zipfile
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx

from dolfinx_feti.runtime.arrays import Array

__all__ = ["gathered_arrays", "read_head", "read_values", "write_archive"]

#: An array of the archive: floats or integers.
Stored = npt.NDArray[Any]

#: Name of the head in the archive.
HEAD = "head.json"


def gathered_arrays(
    functions: Sequence[dolfinx.fem.Function], past: Sequence[Sequence[Array]], comm: MPI.Comm
) -> Iterator[tuple[str, Stored]]:
    """Yield names and arrays of all processes on the first process, one at a time. Collective.

    On the other processes the iterator yields nothing and sends their arrays to the first one, as
    a side effect. Each process must exhaust it.

    Args:
        functions: The present state.
        past: Values at earlier instants, with ghosts, of the first of the functions.
        comm: Communicator of the mesh.
    """
    for name, array in _local_arrays(functions, past):
        if comm.rank > 0:
            comm.send(array, 0)
            continue
        yield f"0/{name}", array
        for p in range(1, comm.size):
            yield f"{p}/{name}", comm.recv(source=p)


def write_archive(
    path: Path, head: Mapping[str, Any], arrays: Iterator[tuple[str, Stored]]
) -> None:
    """Write an archive in place of the one at a path, which stays until the new one is on the disk.

    Args:
        path: The file.
        head: What JSON can hold.
        arrays: Names and arrays; exhausted even if the file cannot be written, as other processes
            wait until their arrays are received.

    Raises:
        OSError: It cannot be written; the archive at the path is the one before.
    """
    part = path.with_suffix(".part")
    try:
        with zipfile.ZipFile(part, "w") as file:
            for name, array in arrays:
                with file.open(f"{name}.npy", "w", force_zip64=True) as entry:
                    np.lib.format.write_array(entry, array, allow_pickle=False)
            file.writestr(HEAD, json.dumps(head))
        _sync(part)
        os.replace(part, path)
        _sync(path.parent)
    finally:
        exhaust(arrays)
        part.unlink(missing_ok=True)


def exhaust(arrays: Iterator[object]) -> None:
    """Run an iterator to its end."""
    deque(arrays, maxlen=0)


def read_head(path: Path) -> Any:
    """Return the head of an archive; None if the file is damaged, or no archive."""
    try:
        with zipfile.ZipFile(path) as file:
            if file.testzip() is not None:
                return None
            return json.loads(file.read(HEAD))
    except (KeyError, ValueError, zipfile.BadZipFile):
        return None


def read_values(
    path: Path, functions: Sequence[dolfinx.fem.Function], *, processes: int, counts: Sequence[int]
) -> list[list[Array]]:
    """Return the values of functions on the cells and ghosts of this process; not collective.

    Args:
        path: The archive.
        functions: The functions, on the same input mesh as those that were written. Their values do
            not change.
        processes: Number of processes that wrote.
        counts: Number of functions at each instant.

    Returns:
        For each instant, the values of its functions, with ghosts, as in ``x.array``.
    """
    values = []
    for count in counts:
        values.append([np.zeros_like(f.x.array) for f in functions[:count]])
    own_cells = np.asarray(functions[0].function_space.mesh.topology.original_cell_index)
    with np.load(path, allow_pickle=False) as file:
        for p in range(processes):
            # cells of this process, and the rows of the same cells in the arrays of p
            _, cells, rows = np.intersect1d(own_cells, file[f"{p}/cells"], return_indices=True)
            if len(cells) == 0:
                continue
            permutations = file[f"{p}/permutations"][rows]
            for i, f in enumerate(functions):
                bs = f.function_space.dofmap.bs
                dofs = f.function_space.dofmap.list[cells]
                dofs_of_p = file[f"{p}/dofs {i}"][rows]
                for t, count in enumerate(counts):
                    if i >= count:
                        continue
                    in_cells = file[f"{p}/values {i} {t}"].reshape(-1, bs)[dofs_of_p]
                    _permute(in_cells, f, permutations, cells)
                    values[t][i].reshape(-1, bs)[dofs] = in_cells
    return values


def _local_arrays(
    functions: Sequence[dolfinx.fem.Function], past: Sequence[Sequence[Array]]
) -> Iterator[tuple[str, Stored]]:
    """Yield the names and arrays of this process, as at the head of the file."""
    mesh = functions[0].function_space.mesh
    owned = mesh.topology.index_map(mesh.topology.dim).size_local
    instants = [*past, [f.x.array for f in functions]]
    yield "cells", np.asarray(mesh.topology.original_cell_index)[:owned]
    yield "permutations", _permutation_info(mesh)[:owned]
    for i, f in enumerate(functions):
        yield f"dofs {i}", np.asarray(f.function_space.dofmap.list)[:owned]
        for t, values in enumerate(instants):
            if i < len(values):
                yield f"values {i} {t}", values[i]


def _permutation_info(mesh: dolfinx.mesh.Mesh) -> Stored:
    """Return the orientations of edges and faces of each cell, by its numbers of vertices."""
    mesh.topology.create_entity_permutations()
    return np.asarray(mesh.topology.get_cell_permutation_info(), dtype=np.uint32)


def _permute(in_cells: Array, f: dolfinx.fem.Function, permutations: Stored, cells: Stored) -> None:
    """Transform values from cells as they were written to the cells of this process, in place.

    Args:
        in_cells: Values of dofs, (cells, dofs, bs), contiguous.
        f: Function of the element.
        permutations: Permutation info of the cells when they were written, (cells,).
        cells: Local numbers of the cells, (cells,).
    """
    element = f.function_space.element
    bs = in_cells.shape[2]
    flat = in_cells.reshape(-1)  # a view, as the array is contiguous
    if element.needs_dof_transformations:
        here = _permutation_info(f.function_space.mesh)[cells]
        element.Tt_apply(flat, permutations, bs)  # to the reference cell
        element.Tt_inv_apply(flat, here, bs)  # to the cells of this process


def _sync(path: Path) -> None:
    """Write a file or a folder from the cache to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
