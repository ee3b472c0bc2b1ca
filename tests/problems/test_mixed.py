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

MU, KAPPA = 1.0, 100.0


def elements(mesh):
    """Taylor and Hood's."""
    cell, dim = mesh.basix_cell(), mesh.geometry.dim
    return [basix.ufl.element("P", cell, 2, shape=(dim,)), basix.ufl.element("P", cell, 1)]


def rows(u, p, v, q):
    """Linear elasticity with a pressure: both rows."""
    inside = 2 * MU * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v)))
    return (inside + p * ufl.div(v)) * ufl.dx, (ufl.div(u) - p / KAPPA) * q * ufl.dx


def load(v):
    """Pull sideways."""
    return v[len(v) - 1] * ufl.dx


def linear_mixed(mesh):
    W = dolfinx.fem.functionspace(mesh, basix.ufl.mixed_element(elements(mesh)))
    v, q = ufl.TestFunctions(W)
    LinearProblem(sum(rows(*ufl.TrialFunctions(W), v, q)), load(v))


def nonlinear_mixed(mesh):
    W = dolfinx.fem.functionspace(mesh, basix.ufl.mixed_element(elements(mesh)))
    w = dolfinx.fem.Function(W)
    v, q = ufl.TestFunctions(W)
    NonlinearProblem(sum(rows(*ufl.split(w), v, q)) - load(v), w)


def spaces(mesh):
    return [dolfinx.fem.functionspace(mesh, element) for element in elements(mesh)]


def linear_parts(mesh):
    W = ufl.MixedFunctionSpace(*spaces(mesh))
    v, q = ufl.TestFunctions(W)
    LinearProblem(sum(rows(*ufl.TrialFunctions(W), v, q)), load(v))


def linear_blocks(mesh):
    W = ufl.MixedFunctionSpace(*spaces(mesh))
    v, q = ufl.TestFunctions(W)
    a, L = sum(rows(*ufl.TrialFunctions(W), v, q)), load(v) + 0 * q * ufl.dx(mesh)
    LinearProblem(ufl.extract_blocks(a), L)


def nonlinear_blocks(mesh):
    u, p = map(dolfinx.fem.Function, spaces(mesh))
    v, q = (ufl.TestFunction(f.function_space) for f in (u, p))
    F_u, F_p = rows(u, p, v, q)
    NonlinearProblem([F_u - load(v), F_p], [u, p])


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
WAYS = {
    linear_mixed: SOLID,
    nonlinear_mixed: SOLID,
    linear_parts: SOLID,
    linear_blocks: SOLID,
    nonlinear_blocks: SOLID,
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
