# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Displacements and norms for numerical tests: is a tangent symmetric, is there a potential?

The residual of a pressure is a polynomial in the displacement and its gradient. An identity between
such forces that holds for one displacement without any symmetry holds for all of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import bounding_box

__all__ = ["FORCE_RTOL", "free_norm", "trial_displacement"]

#: Difference of two forces that is rounding, relative to the norm of one of them. On a cube the
#: skew part of a pressure's tangent is 1e-14 of the tangent over the closed surface, where the
#: tangent is symmetric. Over one side, where it is not, it is of the size of the tangent.
FORCE_RTOL = 1e-9

#: Wave vectors of two displacements, (2, 3, 3), over the diagonal of the mesh; row i is that of
#: component i. The numbers are arbitrary: some waves on the mesh, and no two of them equal, so that
#: the displacements have no symmetry.
WAVES = np.array(
    [
        [[5.1, 3.7, -4.3], [-2.9, 6.1, 3.3], [4.7, -3.1, 5.3]],
        [[3.3, -5.9, 4.1], [6.7, 2.3, -3.7], [-4.9, 5.3, 2.9]],
    ]
)

#: Amplitude of these displacements over the diagonal of the mesh. Their gradients are then below
#: 0.2, so that no cell turns inside out.
AMPLITUDE = 0.02

#: Phase of the waves: without it they would be zero in a corner of the box around the mesh.
PHASE = 0.4


def trial_displacement(V: dolfinx.fem.FunctionSpace, index: int = 0) -> dolfinx.fem.Function:
    """Return a small displacement without any symmetry. Collective.

    Args:
        V: Its space.
        index: 0 or 1, for one of two displacements.
    """
    mesh = V.mesh
    dim = mesh.geometry.dim
    lower, upper = bounding_box(mesh.geometry.x, mesh.comm)
    diagonal = float(np.linalg.norm(upper - lower))
    vectors = WAVES[index, :dim] / diagonal

    def values(x: Array) -> Array:
        phases = vectors @ (x - lower[:, None]) + PHASE
        return np.asarray(AMPLITUDE * diagonal * np.sin(phases))

    w = dolfinx.fem.Function(V)
    w.interpolate(values)
    return w


def free_norm(form: ufl.Form, bcs: Sequence[dolfinx.fem.DirichletBC]) -> float:
    """Return the norm of a linear form over the dofs without Dirichlet conditions. Collective."""
    b = dolfinx.fem.assemble_vector(dolfinx.fem.form(form))
    b.scatter_reverse(dolfinx.la.InsertMode.add)
    owned = b.index_map.size_local * b.block_size
    for bc in bcs:
        bc.set(b.array, alpha=0.0)
    square = b.index_map.comm.allreduce(float(b.array[:owned] @ b.array[:owned]))
    return float(np.sqrt(square))
