# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Differences between dolfinx 0.9, 0.10 and 0.11 and their PETSc, in one place."""

from __future__ import annotations

import os
import sys

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import scipy.sparse

import dolfinx

from dolfinx_feti.runtime.arrays import Array, Indices, Integers

#: One thread; methods whose result does not depend on the order of messages.
SCOTCH = ("SCOTCH_PTHREAD_NUMBER", "SCOTCH_DETERMINISTIC")


def adjacency(data: Integers, offsets: Indices | None = None) -> object:
    """Create dolfinx's C++ adjacency list, which the Python function wraps from 0.10 on."""
    links = dolfinx.graph.adjacencylist(data, offsets)
    return getattr(links, "_cpp_object", links)


def create_function_space(
    V: dolfinx.fem.FunctionSpace, table: Indices, n_blocks: int, block_size: int | None = None
) -> dolfinx.fem.FunctionSpace:
    """Create a space of V's mesh and element with another dof map, on this process alone.

    The table has the dofs (blocks) of each cell, (n_cells, blocks per cell).
    """
    bs = V.dofmap.bs if block_size is None else block_size
    index_map = dolfinx.cpp.common.IndexMap(MPI.COMM_SELF, n_blocks)
    dofmap = dolfinx.cpp.fem.DofMap(V.dofmap.dof_layout, index_map, bs, adjacency(table), bs)
    arguments = [V.mesh._cpp_object, V._cpp_object.element, dofmap]
    try:  # up to 0.9 the value shape is an argument
        space = dolfinx.cpp.fem.FunctionSpace_float64(*arguments, V.value_shape)
    except TypeError:
        space = dolfinx.cpp.fem.FunctionSpace_float64(*arguments)
    return dolfinx.fem.FunctionSpace(V.mesh, V.ufl_element(), space)


def facet_graph(topology: dolfinx.mesh.Topology, n_cells: int) -> scipy.sparse.csr_array:
    """Return the graph of the first cells that share a facet, (n_cells, n_cells).

    The facets themselves, of which a prism has two types, have a table each from 0.10 on.
    """
    vertices = topology.connectivity(topology.dim, 0)
    cells = vertices.array[: vertices.offsets[n_cells]].astype(np.int64)
    mesh = (MPI.COMM_SELF, [topology.cell_type], [cells])
    try:  # from 0.10 on, with a bound on the cells at a facet
        links = dolfinx.cpp.mesh.build_dual_graph(*mesh, None)
    except TypeError:
        links = dolfinx.cpp.mesh.build_dual_graph(*mesh)
    ones, columns = np.ones(len(links.array), dtype=np.int8), links.array.astype(np.int32)
    graph = scipy.sparse.csr_array((ones, columns, links.offsets), shape=(n_cells, n_cells))
    graph.sort_indices()
    return graph


def geometry_degree(mesh: dolfinx.mesh.Mesh) -> int:
    """Return the degree of the geometry of the cells, 1 where edges are straight."""
    geometry = mesh.geometry
    return int((geometry.cmaps[0] if hasattr(geometry, "cmaps") else geometry.cmap).degree)


def geometry_dofmap(mesh: dolfinx.mesh.Mesh) -> Indices:
    """Return the nodes of each cell, (n_cells, nodes per cell), those of the first cell type."""
    geometry = mesh.geometry
    return np.asarray(geometry.dofmaps[0] if hasattr(geometry, "dofmaps") else geometry.dofmap)


def has_vertex_integrals() -> bool:
    """Tell whether dolfinx assembles integrals over vertices: from 0.10 on."""
    major, minor, *_ = dolfinx.__version__.split(".")  # type: ignore[attr-defined]
    return (int(major), int(minor)) >= (0, 10)


def interpolation_points(V: dolfinx.fem.FunctionSpace) -> Array:
    """Return the element's interpolation points: a method up to 0.9, an attribute from 0.10 on."""
    points = V.element.interpolation_points
    return np.asarray(points() if callable(points) else points)


def package_version() -> str:
    """Return the version of dolfinx_feti, which is imported by then."""
    return str(sys.modules["dolfinx_feti"].__version__)


def repeat_partitions() -> None:
    """Let Scotch, with which dolfinx partitions, find the same parts in every run.

    dolfinx seeds it; chance is left to its threads and messages. What the environment says stays.
    """
    for name in SCOTCH:
        os.environ.setdefault(name, "1")


def residual_is_nan() -> int:
    """Return SNES's reason for a residual that is NaN or Inf; PETSc 3.25 renamed it."""
    reasons = PETSc.SNES.ConvergedReason
    name = "DIVERGED_FNORM_NAN"
    return getattr(reasons, name if hasattr(reasons, name) else "DIVERGED_FUNCTION_NANORINF")
