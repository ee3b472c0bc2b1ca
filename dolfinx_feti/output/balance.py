# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Balanced stresses: those of second-order elements, with the pressure that the traction asks for.

A pressure that is linear in each cell follows the stress of the fibres only as far as that is
linear, too. What is left of it is a pressure that is off, the same in all directions: relative to
the small stress across the wall it is large. Equilibrium tests σ with linear gradients, so that the
linear part of the traction is accurate in each cell, and tells by how much p is off. With the unit
normal n of the wall and the projection Π to linear functions on each cell,

.. math:: σ^* = σ + (Π(n·σ n) - n·σ n)\, I.

Cells may be curved, and of any type.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

import basix
import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.fem.compiler import Compiler

__all__ = ["balanced_stress"]


def balanced_stress(
    stress: Expr, u: dolfinx.fem.Function, *, normal: Expr, degree: int | None = None
) -> Expr:
    """Put the pressure of a Cauchy stress right by the traction on surfaces along the wall.

    Args:
        stress: The stress, with its pressure part, shape (d, d).
        u: Displacement, of second order; its mesh is that of the stress.
        normal: Normal of the deformed wall, of any length but zero and of either sign, F⁻ᵀ ê₂ with
            the transmural direction ê₂, shape (d,).
        degree: Of the quadrature inside the cells; twice the degree of u if not given.

    Returns:
        σ*, whose Π(n·σ n) is that of the present state.

    Raises:
        ValueError: The stress is no tensor on the mesh, or the normal is no vector.
        ArithmeticError: A stress is NaN or infinite somewhere, or a normal zero.

    Note:
        Collective.
    """
    V = u.function_space
    mesh, dim = V.mesh, V.mesh.geometry.dim
    if stress.ufl_shape != (dim, dim) or normal.ufl_shape != (dim,):
        raise ValueError(
            f"A stress of shape {stress.ufl_shape} with a normal of shape {normal.ufl_shape}: give "
            f"a stress of shape {(dim, dim)} and a vector of {dim} components."
        )
    traction = ufl.inner(normal, stress * normal) / ufl.inner(normal, normal)
    cell = getattr(basix.CellType, mesh.topology.cell_name())
    simplex = cell in (basix.CellType.triangle, basix.CellType.tetrahedron)
    linear = dolfinx.fem.Function(
        dolfinx.fem.functionspace(mesh, ("DG" if simplex else "DPC", 1)), name="traction"
    )
    twice = 2 * V.ufl_element().embedded_superdegree
    rule = basix.make_quadrature(cell, twice if degree is None else degree)
    points, w = (np.asarray(part, dtype=np.float64) for part in rule)
    values = ufl.as_vector([abs(ufl.JacobianDeterminant(mesh)), traction])
    owned = np.arange(mesh.topology.index_map(dim).size_local, dtype=np.int32)
    at_points = Compiler(mesh.comm).expression(values, points).eval(mesh, owned)
    volume, t = np.moveaxis(np.asarray(at_points).reshape(len(owned), len(points), 2), 2, 0)
    if not mesh.comm.allreduce(bool(np.isfinite(t).all()), op=MPI.LAND):
        raise ArithmeticError(
            "The traction is NaN or infinite somewhere: give an admissible state and a normal that "
            "is nowhere zero."
        )
    element = linear.function_space.element.basix_element
    φ = element.tabulate(0, points)[0, :, :, 0]  # (points, dofs)
    M = np.einsum("cq,qi,qj->cij", volume * w, φ, φ)
    b = np.einsum("cq,qi->ci", volume * w * t, φ)
    linear.x.array[linear.function_space.dofmap.list[: len(owned)]] = np.linalg.solve(
        M, b[:, :, None]
    )[:, :, 0]  # Π(n·σ n) = M⁻¹ b
    linear.x.scatter_forward()
    return stress + (linear - traction) * ufl.Identity(dim)
