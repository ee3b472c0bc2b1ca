# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The version of this package, and differences between dolfinx 0.9, 0.10 and 0.11.

Each version of dolfinx comes with another version of PETSc. Only this module compares versions; the
rest of the package calls its functions.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import scipy.sparse

import dolfinx

from dolfinx_feti.runtime.arrays import Array, Indices, Integers


def adjacency(data: Integers, offsets: Indices | None = None) -> object:
    """Return dolfinx's C++ adjacency list; from 0.10 on the Python function wraps it.

    Args:
        data: Links of all nodes, (links,).
        offsets: Place of the first link of each node, (nodes + 1,); None for data of shape
            (nodes, links of a node).
    """
    links = dolfinx.graph.adjacencylist(data, offsets)
    return getattr(links, "_cpp_object", links)


def create_function_space(
    V: dolfinx.fem.FunctionSpace,
    blocks_of_cells: Indices,
    n_blocks: int,
    block_size: int | None = None,
) -> dolfinx.fem.FunctionSpace:
    """Create a space with the mesh and element of V and another dof map, on this process alone.

    Args:
        V: The space.
        blocks_of_cells: Blocks of dofs of each cell, (n_cells, blocks per cell).
        n_blocks: Number of blocks.
        block_size: Dofs of a block; None for that of V.
    """
    bs = V.dofmap.bs if block_size is None else block_size
    index_map = dolfinx.cpp.common.IndexMap(MPI.COMM_SELF, n_blocks)
    cells = adjacency(blocks_of_cells)
    dofmap = dolfinx.cpp.fem.DofMap(V.dofmap.dof_layout, index_map, bs, cells, bs)
    arguments = [V.mesh._cpp_object, V._cpp_object.element, dofmap]
    if not _is_dolfinx_at_least(0, 10):
        arguments.append(V.value_shape)
    space = dolfinx.cpp.fem.FunctionSpace_float64(*arguments)
    return dolfinx.fem.FunctionSpace(V.mesh, V.ufl_element(), space)


def create_submesh(
    mesh: dolfinx.mesh.Mesh, dim: int, entities: Indices
) -> tuple[dolfinx.mesh.Mesh, Indices]:
    """Create a mesh of some entities of a mesh.

    Up to 0.9 dolfinx returns the entities as an array, from 0.10 on as an object.

    Args:
        mesh: The mesh.
        dim: Dimension of the entities.
        entities: Their local numbers.

    Returns:
        The new mesh, and the entity of each of its owned cells, (owned cells,).
    """
    submesh, parents, *_ = dolfinx.mesh.create_submesh(mesh, dim, entities)
    cells = np.arange(submesh.topology.index_map(dim).size_local, dtype=np.int32)
    if isinstance(parents, np.ndarray):
        return submesh, parents[cells]
    return submesh, np.asarray(parents.sub_topology_to_topology(cells, False))


def facet_graph(topology: dolfinx.mesh.Topology, n_cells: int) -> scipy.sparse.csr_array:
    """Return which of the first ``n_cells`` cells share a facet, (n_cells, n_cells).

    The graph is computed from the vertices of the cells: from 0.10 on, cells with two types of
    facets, such as prisms, have one table for each type.
    """
    vertices = topology.connectivity(topology.dim, 0)
    cells = vertices.array[: vertices.offsets[n_cells]].astype(np.int64)
    arguments = [MPI.COMM_SELF, [topology.cell_type], [cells]]
    if _is_dolfinx_at_least(0, 10):
        arguments.append(None)  # no bound on the number of cells at a facet
    links = dolfinx.cpp.mesh.build_dual_graph(*arguments)
    ones = np.ones(len(links.array), dtype=np.int8)
    columns = links.array.astype(np.int32)
    graph = scipy.sparse.csr_array((ones, columns, links.offsets), shape=(n_cells, n_cells))
    graph.sort_indices()
    return graph


def geometry_degree(mesh: dolfinx.mesh.Mesh) -> int:
    """Return the polynomial degree of the geometry of the cells; 1 for straight edges."""
    geometry = mesh.geometry
    return int((geometry.cmaps[0] if hasattr(geometry, "cmaps") else geometry.cmap).degree)


def geometry_dofmap(mesh: dolfinx.mesh.Mesh) -> Indices:
    """Return the nodes of each cell of the first cell type, (n_cells, nodes per cell)."""
    geometry = mesh.geometry
    return np.asarray(geometry.dofmaps[0] if hasattr(geometry, "dofmaps") else geometry.dofmap)


def has_vertex_integrals() -> bool:
    """Return True if dolfinx assembles integrals over vertices, as from 0.10 on."""
    return _is_dolfinx_at_least(0, 10)


def interpolation_points(V: dolfinx.fem.FunctionSpace) -> Array:
    """Return the interpolation points of an element, (points, dim).

    They are a method up to 0.9, an attribute from 0.10 on.
    """
    points = V.element.interpolation_points
    return np.asarray(points() if callable(points) else points)


@contextlib.contextmanager
def petsc_errors_silenced() -> Iterator[None]:
    """Context in which functions of PETSc return the code of an error and print nothing.

    PETSc renamed the error handler between 3.22 and 3.25.
    """
    try:
        PETSc.Sys.pushErrorHandler("return")
    except ValueError:
        PETSc.Sys.pushErrorHandler("ignore")
    try:
        yield
    finally:
        PETSc.Sys.popErrorHandler()


def package_version() -> str:
    """Return the version of dolfinx_feti.

    It is read at the time of the call: when this module is imported, the package has no version
    yet.
    """
    return str(sys.modules["dolfinx_feti"].__version__)


def dolfinx_version() -> str:
    """Return the version of dolfinx."""
    return str(dolfinx.__version__)  # type: ignore[attr-defined]


def nan_residual_reason() -> int:
    """Return SNES's converged reason for a residual that is NaN or Inf; PETSc 3.25 renamed it."""
    reasons = PETSc.SNES.ConvergedReason
    name = "DIVERGED_FNORM_NAN"
    return getattr(reasons, name if hasattr(reasons, name) else "DIVERGED_FUNCTION_NANORINF")


def _is_dolfinx_at_least(major: int, minor: int) -> bool:
    """Return True if dolfinx has this version or a later one."""
    numbers = dolfinx_version().split(".")
    return (int(numbers[0]), int(numbers[1])) >= (major, minor)
