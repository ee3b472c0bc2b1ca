# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Whether the rim of a surface under pressure is held, found out by trying.

The tangent a of a uniform pressure p is symmetric up to a line integral along the deformed rim,
a(du, v) − a(v, du) = p ∮ (v × du)·dx, which vanishes if the surface is closed, if its rim is
clamped, and if it slides in a plane. No rule is needed to tell: the difference is assembled for one
du, at one displacement, and looked at in all dofs that no Dirichlet condition holds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

import dolfinx
import ufl
from ufl.core.expr import Expr

__all__ = ["rim_is_held"]

#: How closely two forces agree that are one, relative to their norm.
SAME = 1e-9

#: Wave vectors of a displacement without any symmetry, in the extent of the mesh.
STATE = np.array([[5.1, 3.7, -4.3], [-2.9, 6.1, 3.3], [4.7, -3.1, 5.3]])
INCREMENT = np.array([[3.3, -5.9, 4.1], [6.7, 2.3, -3.7], [-4.9, 5.3, 2.9]])

#: Size of that displacement in the extent of the mesh.
AMPLITUDE = 0.02


def rim_is_held(
    virtual_work: Callable[[dolfinx.fem.Function, Expr], ufl.Form],
    V: dolfinx.fem.FunctionSpace,
    bcs: Sequence[dolfinx.fem.DirichletBC],
) -> bool:
    """Tell whether the tangent of a uniform pressure is symmetric in all dofs that are free.

    Args:
        virtual_work: R(w; v) of the pressure one, a form in a displacement w and a test function v,
            with exact quadrature.
        V: Space of displacements.
        bcs: Dirichlet conditions on V and on its components.

    Raises:
        ValueError: The surface has no facets.

    Note:
        Collective.
    """
    held = np.concatenate([np.zeros(0, dtype=np.int32), *(bc.dof_indices()[0] for bc in bcs)])
    w, d = _wave(V, STATE), _wave(V, INCREMENT)
    for bc in bcs:
        bc.set(w.x.array)
    d.x.array[held] = 0.0
    v = ufl.TestFunction(V)
    a = ufl.derivative(virtual_work(w, v), w, d)  # a(d, v)
    a_T = ufl.derivative(virtual_work(w, d), w, v)  # a(v, d)
    skew, whole = (_free_norm(form, held) for form in (a - a_T, a))
    if whole == 0.0 and _free_norm(virtual_work(w, v), held[:0]) == 0.0:
        raise ValueError(
            "ds has no facets: give the measure the facet tags, ufl.Measure('ds', mesh, "
            "subdomain_data=tags), and a tag that is among them."
        )
    return skew <= SAME * whole


def _wave(V: dolfinx.fem.FunctionSpace, vectors: np.ndarray) -> dolfinx.fem.Function:
    """Return a displacement in which nothing is symmetric."""
    mesh, dim = V.mesh, V.mesh.geometry.dim
    reach = max(mesh.comm.allgather(float(np.abs(mesh.geometry.x).max(initial=0.0))))
    w = dolfinx.fem.Function(V)
    w.interpolate(
        lambda x: AMPLITUDE * reach * np.sin(vectors[:dim] @ (x / reach) + 0.4)  # (d, points)
    )
    return w


def _free_norm(form: ufl.Form, held: np.ndarray) -> float:
    """Return the norm of a linear form in the dofs that are not held."""
    b = dolfinx.fem.assemble_vector(dolfinx.fem.form(form))
    b.scatter_reverse(dolfinx.la.InsertMode.add)
    owned = b.index_map.size_local * b.block_size
    b.array[held] = 0.0
    return float(np.sqrt(b.index_map.comm.allreduce(float(b.array[:owned] @ b.array[:owned]))))
