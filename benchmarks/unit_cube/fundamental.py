# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Kelvin's fundamental solution of linear elastostatics, the benchmark's exact solution.

.. math:: U^*_{1k}(x, x^*) = \frac{1}{8π} \frac{1}{E} \frac{1 + ν}{1 - ν} \left[
          (3 - 4ν) \frac{δ_{1k}}{|x - x^*|} +
          \frac{(x_1 - x^*_1)(x_k - x^*_k)}{|x - x^*|^3} \right], \qquad k = 1, 2, 3

(eq. 52, Augustin_eq:fundSol): the displacement of the whole space under a unit force at :math:`x^*`
in the direction of the first axis.
"""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl

from dolfinx_feti import _compat

__all__ = ["POISSON", "YOUNG", "boundary_values", "fundamental_solution", "l2_error"]

YOUNG, POISSON = 210.0, 0.45

#: Degree of the quadrature that measures the error.
QUADRATURE = 6


def fundamental_solution(mesh: dolfinx.mesh.Mesh, source: Sequence[float]) -> ufl.core.expr.Expr:
    """Return the displacement as an expression in the mesh's coordinates.

    Args:
        mesh: A mesh that does not contain the source point.
        source: The point :math:`x^*`.
    """
    d = ufl.SpatialCoordinate(mesh) - ufl.as_vector([float(c) for c in source])
    r = ufl.sqrt(ufl.dot(d, d))
    scale = (1 + POISSON) / (8 * np.pi * YOUNG * (1 - POISSON))
    direction = ufl.as_vector([1.0, 0.0, 0.0])
    return scale * ((3 - 4 * POISSON) * direction / r + d[0] * d / r**3)


def boundary_values(V: dolfinx.fem.FunctionSpace, u: ufl.core.expr.Expr) -> dolfinx.fem.DirichletBC:
    """Prescribe the nodal values of an expression on the whole surface.

    Note:
        Collective.
    """
    values = dolfinx.fem.Function(V)
    values.interpolate(dolfinx.fem.Expression(u, _compat.interpolation_points(V)))
    V.mesh.topology.create_connectivity(2, 3)
    facets = dolfinx.mesh.exterior_facet_indices(V.mesh.topology)
    return dolfinx.fem.dirichletbc(values, dolfinx.fem.locate_dofs_topological(V, 2, facets))


def l2_error(u_h: dolfinx.fem.Function, u: ufl.core.expr.Expr) -> float:
    """Return the norm of the error, ‖u − u_h‖ in L₂ (eq. 53).

    Note:
        Collective.
    """
    difference = u_h - u
    dx = ufl.dx(metadata={"quadrature_degree": QUADRATURE})
    square = dolfinx.fem.assemble_scalar(dolfinx.fem.form(ufl.inner(difference, difference) * dx))
    return float(np.sqrt(u_h.function_space.mesh.comm.allreduce(square, op=MPI.SUM)))
