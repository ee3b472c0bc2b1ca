# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Balanced stresses: what they leave as it is, and what they put right."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, small

import dolfinx
import ufl

from dolfinx_feti.output import balanced_stress
from meshes.bricks import create_brick_tube


@pytest.fixture(scope="module", params=["tetrahedron", "hexahedron", "curved", "triangle"])
def u(request) -> dolfinx.fem.Function:
    """A displacement that is zero."""
    if request.param == "curved":
        mesh = create_brick_tube(COMM, length=0.3, size=0.3, quarter=True).mesh
    elif request.param == "triangle":
        mesh = dolfinx.mesh.create_unit_square(COMM, 4, 4)
    else:
        kind = getattr(dolfinx.mesh.CellType, request.param)
        mesh = dolfinx.mesh.create_unit_cube(COMM, 3, 3, 3, cell_type=kind)
    dim = mesh.geometry.dim
    return dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (dim,))))


def linear(u: dolfinx.fem.Function) -> tuple[ufl.core.expr.Expr, ufl.core.expr.Expr]:
    """Return a stress whose traction on surfaces along the normal is constant, and the normal."""
    dim = len(u)
    x = ufl.SpatialCoordinate(u.function_space.mesh)
    n = ufl.as_vector([1.0, 2.0, 2.0][:dim])
    along = ufl.Identity(dim) - ufl.outer(n, n) / ufl.inner(n, n)
    return 3.0 * ufl.Identity(dim) + x[0] * along, n


def norm(u: dolfinx.fem.Function, f: ufl.core.expr.Expr) -> float:
    """Return the L2 norm of a field."""
    mesh = u.function_space.mesh
    dx = ufl.dx(mesh, metadata={"quadrature_degree": 6})
    square = dolfinx.fem.assemble_scalar(dolfinx.fem.form(ufl.inner(f, f) * dx))
    return float(np.sqrt(mesh.comm.allreduce(square)))


def test_accurate_stress_stays(u):
    """Whatever its pressure does along the wall."""
    stress, n = linear(u)
    small(norm(u, balanced_stress(stress, u, normal=n) - stress), 1e-12)


def test_pressure_that_is_off_is_put_right(u):
    """One without a linear part in any cell, as what a linear pressure cannot follow."""
    stress, n = linear(u)
    mesh = u.function_space.mesh
    wave = ufl.cos(5.0 * ufl.SpatialCoordinate(mesh)[0])
    zero = balanced_stress(0.0 * stress, u, normal=n)
    off = wave * ufl.Identity(len(u))
    ripple = -balanced_stress(off, u, normal=n) + off  # (1 − Π) wave
    small(norm(u, zero), 1e-14)
    found = balanced_stress(stress + ripple, u, normal=-7.0 * n)
    small(norm(u, found - stress), 1e-12)
    assert norm(u, ripple) > 1e-3
