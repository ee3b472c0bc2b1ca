# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Quadratic elements with bubbles: their functions, and that they are continuous."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, raises, small

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti.fem.elements import quadratic_with_bubbles

DIMENSIONS = {("triangle", True): 7, ("tetrahedron", True): 15, ("tetrahedron", False): 11}


@pytest.mark.parametrize("kind", DIMENSIONS)
def test_functions(kind):
    """The elements contain the quadratic functions and all bubbles, and nothing else."""
    cell, faces = kind
    element = quadratic_with_bubbles(cell, faces=faces)
    x = basix.make_quadrature(element.cell_type, 8)[0]
    found = element.tabulate(0, x)[0]
    λ = np.column_stack([1.0 - x.sum(axis=1), x])
    n = λ.shape[1]
    wanted = [λ[:, i] * λ[:, j] for i in range(n) for j in range(i, n)] + [λ.prod(axis=1)]
    if n == 4 and faces:
        wanted += [np.delete(λ, i, axis=1).prod(axis=1) for i in range(n)]
    both = np.column_stack([found, *wanted])
    ranks = [np.linalg.matrix_rank(part, tol=1e-10) for part in (found, both)]
    agree(ranks == [DIMENSIONS[kind]] * 2, ranks)


@pytest.mark.parametrize("kind", DIMENSIONS)
def test_continuity(kind):
    """A function of random dofs has no jumps between cells."""
    cell, faces = kind
    mesh = dolfinx.mesh.create_unit_square(COMM, 3, 3)
    if cell == "tetrahedron":
        ghosts = dolfinx.mesh.GhostMode.shared_facet
        mesh = dolfinx.mesh.create_unit_cube(COMM, 2, 2, 2, ghost_mode=ghosts)
    element = quadratic_with_bubbles(cell, faces=faces)
    f = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element))
    n = f.function_space.dofmap.index_map.size_local
    f.x.array[:n] = np.random.default_rng(5).standard_normal(n)
    f.x.scatter_forward()
    jump = ufl.jump(f) ** 2 * ufl.dS(metadata={"quadrature_degree": 6})
    small(dolfinx.fem.assemble_scalar(dolfinx.fem.form(jump)), 1e-24)


def test_other_cells():
    """Cells without bubbles are refused."""
    with raises(ValueError, "cell is 'hexahedron': bubbles are made for"):
        quadratic_with_bubbles("hexahedron")
