# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Recovered stresses, more accurate than those inside the cells (docs/stresses.md).

*By patches*, for elements with a pressure P_0: a fit σ^in to the values inside the cells recovers
the traction across the wall, and a fit σ^means to the means over cells the stress along the wall.
With the normal n, :math:`σ^* = σ^{in} + T (σ^{means} - σ^{in}) T`, :math:`T = I - n ⊗ n`.

*By balance*, for elements of second order: the pressure is corrected so that the normal traction
n·σ n is linear in each cell, σ* = σ + (Π(n·σ n) − n·σ n) I. Π is the projection to such functions.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

import basix
import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.output.evaluation import CellEvaluator
from dolfinx_feti.output.patches import FitToMeans, FitToValues, Patches, moments
from dolfinx_feti.runtime.arrays import Array

__all__ = ["balanced_stress", "recovered_field"]

#: Number of fits of a field, each to what the earlier ones have left. Further fits change little.
SWEEPS = 3

#: Variation inside the cells, over the largest mean, up to which a field counts as constant in each
#: cell: rounding with a margin.
CONSTANT_RTOL = 1e-12


def recovered_field(
    expression: Expr, patches: Patches, *, normal: Expr | None = None, name: str = "recovered"
) -> dolfinx.fem.Function:
    """Recover a field, such as a stress or the element-wise pressure, from its values in the cells.

    Example::

        from dolfinx_feti.output import create_patches

        stress = kinematics.cauchy_stress(psi, F)
        recovered = recovered_field(stress, create_patches(mesh, wall.cell_tags))

    Args:
        expression: The field; a stress in full, with its pressure part.
        patches: Patches of its mesh, see :func:`~dolfinx_feti.output.patches.create_patches`.
        normal: A vector normal to the wall, not zero, with the same sign in neighbouring cells; for
            a Cauchy stress that of the deformed wall, F⁻ᵀ ê₂, with the transmural ê₂.
        name: Name of the result.

    Returns:
        A function of the same shape, piecewise quadratic, continuous in each layer, with jumps
        between layers. Fields that are linear in each layer are reproduced.

    Raises:
        ValueError: The expression is on another mesh than the patches, a normal is given for a
            field that is not a stress, or the normal is not a vector.
        ArithmeticError: The expression is NaN or infinite somewhere, or the normal is zero.

    Note:
        Collective.
    """
    mesh = patches.mesh
    shape = expression.ufl_shape
    dim = mesh.geometry.dim
    if normal is not None and (shape != (dim, dim) or normal.ufl_shape != (dim,)):
        raise ValueError(
            f"A normal of shape {normal.ufl_shape} is given for a field of shape {shape}: give a "
            f"vector of {dim} components for a stress of shape {(dim, dim)}, and None otherwise."
        )
    data = moments(expression, patches)
    is_constant = _is_constant_in_cells(data, mesh)
    fit = FitToMeans(patches) if is_constant else FitToValues(patches)
    field = fit.recover(data, sweeps=SWEEPS)
    if normal is not None:
        to_means = FitToMeans(patches)
        n = _unit_normals(normal, patches, to_means)
        T = np.eye(dim) - n[..., :, None] * n[..., None, :]
        along_wall = to_means.recover(data, sweeps=SWEEPS)
        field += (T @ (along_wall - field).reshape(T.shape) @ T).reshape(field.shape)
    result = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 2, shape)), name=name)
    dofs = result.function_space.dofmap.list[: len(field)]
    result.x.array.reshape(-1, field.shape[2])[dofs] = field
    result.x.scatter_forward()
    return result


def _is_constant_in_cells(data: Array, mesh: dolfinx.mesh.Mesh) -> bool:
    """Return True if a field is constant in each cell, on all processes. Collective.

    Args:
        data: Moments of the field, (n_c, 1 + d, components).
        mesh: The mesh.
    """
    mean_here = np.abs(data[:, :1]).max(initial=0.0)
    variation_here = np.abs(data[:, 1:]).max(initial=0.0)
    mean = mesh.comm.allreduce(float(mean_here), op=MPI.MAX)
    variation = mesh.comm.allreduce(float(variation_here), op=MPI.MAX)
    return variation <= CONSTANT_RTOL * mean


def _unit_normals(normal: Expr, patches: Patches, fit: FitToMeans) -> Array:
    """Return the recovered unit normal at the nodes of each cell, (n_c, nodes, d). Collective.

    Args:
        normal: The normal, of any length.
        patches: The patches.
        fit: The fit in these patches.

    Raises:
        ArithmeticError: The normal vanishes at a node.
    """
    n = fit.recover(moments(normal, patches), sweeps=1)
    length = np.linalg.norm(n, axis=2, keepdims=True)
    vanishing = patches.mesh.comm.allreduce(int((length == 0.0).sum()))
    if vanishing:
        raise ArithmeticError(
            f"The normal vanishes at {vanishing} nodes: give one that has the same sign in "
            "neighbouring cells, and is nowhere zero."
        )
    return np.asarray(n / length)


def balanced_stress(
    stress: Expr, u: dolfinx.fem.Function, *, normal: Expr, degree: int | None = None
) -> Expr:
    """Correct the pressure of a Cauchy stress by the balance of the traction across the wall.

    Args:
        stress: The stress, with its pressure part, shape (d, d).
        u: Displacement, of second order; its mesh is that of the stress.
        normal: Normal of the deformed wall, not zero, F⁻ᵀ ê₂, shape (d,).
        degree: Degree of the quadrature inside the cells; twice the degree of u if not given.

    Returns:
        The expression σ*. Π(n·σ n) is computed once, in this call: call it again for another
        state.

    Raises:
        ValueError: The stress is not a tensor, or the normal is not a vector.
        ArithmeticError: A stress is NaN or infinite somewhere, or a normal is zero.

    Note:
        Collective.
    """
    V = u.function_space
    mesh = V.mesh
    dim = V.mesh.geometry.dim
    if stress.ufl_shape != (dim, dim) or normal.ufl_shape != (dim,):
        raise ValueError(
            f"A stress of shape {stress.ufl_shape} with a normal of shape {normal.ufl_shape}: give "
            f"a stress of shape {(dim, dim)} and a vector of {dim} components."
        )
    traction = ufl.inner(normal, stress * normal) / ufl.inner(normal, normal)
    if degree is None:
        degree = 2 * V.ufl_element().embedded_superdegree
    projected = _projected_to_linear(traction, mesh, degree)
    return stress + (projected - traction) * ufl.Identity(dim)


def _projected_to_linear(
    traction: Expr, mesh: dolfinx.mesh.Mesh, degree: int
) -> dolfinx.fem.Function:
    """Return the L2 projection of a traction to linear functions in each cell. Collective.

    Args:
        traction: The traction, a scalar.
        mesh: Its mesh.
        degree: Degree of the quadrature inside the cells.

    Raises:
        ArithmeticError: The traction is NaN or infinite somewhere.
    """
    cell = getattr(basix.CellType, mesh.topology.cell_name())
    is_simplex = cell in (basix.CellType.triangle, basix.CellType.tetrahedron)
    W = dolfinx.fem.functionspace(mesh, ("DG" if is_simplex else "DPC", 1))
    rule = basix.make_quadrature(cell, degree)
    points, w = (np.asarray(part, dtype=np.float64) for part in rule)
    integrands = ufl.as_vector([abs(ufl.JacobianDeterminant(mesh)), traction])
    values = CellEvaluator(integrands, mesh, points).values()
    scale, t = np.moveaxis(values, 2, 0)  # |det dx/dξ| and the traction, (cells, points) each
    if not mesh.comm.allreduce(bool(np.isfinite(t).all()), op=MPI.LAND):
        raise ArithmeticError(
            "The traction is NaN or infinite somewhere: give an admissible state and a normal that "
            "is nowhere zero."
        )
    φ = W.element.basix_element.tabulate(0, points)[0, :, :, 0]  # (points, dofs)
    M = np.einsum("cq,qi,qj->cij", scale * w, φ, φ)
    b = np.einsum("cq,qi->ci", scale * w * t, φ)
    c = np.linalg.solve(M, b[:, :, None])[:, :, 0]  # Π(n·σ n) = M⁻¹ b
    linear = dolfinx.fem.Function(W, name="traction")
    linear.x.array[W.dofmap.list[: len(c)]] = c
    linear.x.scatter_forward()
    return linear
