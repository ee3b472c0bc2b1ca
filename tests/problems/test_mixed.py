# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Mixed elements and block forms end in one message; what it names is in test_doors."""

from __future__ import annotations

import pytest
from collective import raises
from problems import Cell, cube

import basix.ufl
import dolfinx
import dolfinx.fem.petsc
import ufl

from dolfinx_feti import LinearProblem, NonlinearProblem


class Pair:
    """Linear elasticity with a continuous pressure, of Taylor and Hood's elements."""

    def __init__(self, mesh):
        cell, dim = mesh.basix_cell(), mesh.geometry.dim
        parts = basix.ufl.element("P", cell, 2, shape=(dim,)), basix.ufl.element("P", cell, 1)
        self.spaces = [dolfinx.fem.functionspace(mesh, part) for part in parts]
        self.mixed = dolfinx.fem.functionspace(mesh, basix.ufl.mixed_element(parts))
        self.parts = ufl.MixedFunctionSpace(*self.spaces)


def rows(u, p, v, q):
    """Both rows, pulled sideways."""
    inside = 2 * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v)))
    return (inside + p * ufl.div(v)) * ufl.dx, (ufl.div(u) - p / 100.0) * q * ufl.dx


def pull(v):
    return v[len(v) - 1] * ufl.dx


def linear_mixed(mesh):
    W = Pair(mesh).mixed
    v, q = ufl.TestFunctions(W)
    LinearProblem(sum(rows(*ufl.TrialFunctions(W), v, q)), pull(v))


def nonlinear_mixed(mesh):
    w = dolfinx.fem.Function(Pair(mesh).mixed)
    v, q = ufl.TestFunctions(w.function_space)
    NonlinearProblem(sum(rows(*ufl.split(w), v, q)) - pull(v), w)


def linear_parts(mesh, *, blocks=False):
    W = Pair(mesh).parts
    v, q = ufl.TestFunctions(W)
    a, L = sum(rows(*ufl.TrialFunctions(W), v, q)), pull(v)
    LinearProblem(ufl.extract_blocks(a) if blocks else a, L + 0 * q * ufl.dx(mesh) if blocks else L)


def linear_blocks(mesh):
    linear_parts(mesh, blocks=True)


def nonlinear_blocks(mesh):
    u, p = map(dolfinx.fem.Function, Pair(mesh).spaces)
    v, q = (ufl.TestFunction(f.function_space) for f in (u, p))
    F_u, F_p = rows(u, p, v, q)
    NonlinearProblem([F_u - pull(v), F_p], [u, p])


def three_scalars(mesh):
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    NonlinearProblem([ufl.dx(mesh)] * 3, [dolfinx.fem.Function(V) for _ in range(3)])


def flux(mesh):
    cell = mesh.basix_cell()
    family = "RT" if mesh.topology.cell_type != Cell.quadrilateral else "RTCF"
    pair = [basix.ufl.element(family, cell, 1), basix.ufl.element("DG", cell, 0)]
    W = dolfinx.fem.functionspace(mesh, basix.ufl.mixed_element(pair))
    w, t = ufl.TrialFunction(W), ufl.TestFunction(W)
    LinearProblem(ufl.inner(w, t) * ufl.dx, t[0] * ufl.dx)


SOLID = r"Condense a discontinuous .*NonlinearProblem\(\[F_u, F_p\], u, bcs=bcs, condense=p\)"
OTHER = "Solve it by dolfinx, with MUMPS or a field split"
SOLIDS = (linear_mixed, nonlinear_mixed, linear_parts, linear_blocks, nonlinear_blocks)
WAYS = {way: SOLID for way in SOLIDS} | {
    three_scalars: f"{OTHER}\\.",
    flux: f"{OTHER}; or, if the vector is a flux −k ∇p, solve −div",
}


@pytest.mark.parametrize(("way", "text"), WAYS.items())
@pytest.mark.parametrize("cell", [Cell.tetrahedron, Cell.quadrilateral])
def test_one_message(way, text, cell):
    mesh = cube(3, 1) if cell == Cell.tetrahedron else cube(2, 2, cell)
    kind = TypeError if way in (linear_mixed, nonlinear_mixed, flux) else ValueError
    with raises(kind, f"(of|has) [23].*but only a problem on one continuous space is torn. {text}"):
        way(mesh)
