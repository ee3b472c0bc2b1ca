# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""How a wall is held: with clamped rims, or as a tube that remains one when it is inflated.

The ends of the tube slide in their planes, :math:`u_z = 0`, and so do the planes of symmetry of a
quarter, :math:`u_x = 0` and :math:`u_y = 0`. A whole tube is then still free to move as a rigid
body in the plane,

.. math:: u_x = a - ω y, \qquad u_y = b + ω x,

and three components hold it: on the rim of the lumen, of radius R, :math:`u_y` at (R, 0) and
(−R, 0), and :math:`u_x` at (0, R). They are circumferential, so the true displacement is zero
there; and three conditions on three motions leave no stress behind: a pressure in a closed lumen
has neither a resultant nor a torque, and the reactions vanish.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import dolfinx

from dolfinx_feti.wall import Wall, facets, openings
from meshes.tube import INNER_RADIUS

__all__ = ["Hold", "clamp_openings", "slide"]

Hold = Callable[[Wall, dolfinx.fem.FunctionSpace], list[dolfinx.fem.DirichletBC]]

#: Components that hold a whole tube, and the nodes where they are held [mm].
NODES = (
    (1, (INNER_RADIUS, 0.0, 0.0)),
    (1, (-INNER_RADIUS, 0.0, 0.0)),
    (0, (0.0, INNER_RADIUS, 0.0)),
)

#: How far from its place a node may be [mm].
NEAR = 1e-9


def clamp_openings(wall: Wall, V: dolfinx.fem.FunctionSpace) -> list[dolfinx.fem.DirichletBC]:
    """Hold the rims of all openings."""
    rims = np.concatenate([facets(wall, name) for name in openings(wall)])
    dofs = dolfinx.fem.locate_dofs_topological(V, 2, rims)
    return [dolfinx.fem.dirichletbc(np.zeros(3), dofs, V)]


def slide(wall: Wall, V: dolfinx.fem.FunctionSpace) -> list[dolfinx.fem.DirichletBC]:
    """Let the ends of a tube slide, and of a quarter its planes of symmetry. Collective.

    Raises:
        ValueError: A whole tube has no node where it is to be held. On all processes.
    """
    bcs = [_hold_surface(wall, V, name, 2) for name in ("opening_1", "opening_2")]
    if "symmetry_x" in wall.surfaces:
        planes = enumerate(("symmetry_x", "symmetry_y"))
        return bcs + [_hold_surface(wall, V, name, component) for component, name in planes]
    return bcs + [_hold_node(V, component, place) for component, place in NODES]


def _hold_surface(
    wall: Wall, V: dolfinx.fem.FunctionSpace, name: str, component: int
) -> dolfinx.fem.DirichletBC:
    """Hold one component on a surface."""
    part = V.sub(component)
    dofs = dolfinx.fem.locate_dofs_topological(part, 2, facets(wall, name))
    return dolfinx.fem.dirichletbc(0.0, dofs, part)


def _hold_node(
    V: dolfinx.fem.FunctionSpace, component: int, place: tuple[float, float, float]
) -> dolfinx.fem.DirichletBC:
    """Hold one component at the node at a place."""
    part = V.sub(component)
    at = np.array(place)[:, None]
    dofs, _ = dolfinx.fem.locate_dofs_geometrical(
        (part, part.collapse()[0]), lambda x: np.linalg.norm(x - at, axis=0) <= NEAR
    )
    owned = dofs < V.dofmap.index_map.size_local * V.dofmap.index_map_bs
    if V.mesh.comm.allreduce(int(np.count_nonzero(owned))) != 1:
        x, y, z = place
        raise ValueError(
            f"The tube has no node at ({x:g}, {y:g}, {z:g}) mm, where component {component} of the "
            "displacement is to be held: mesh it with a multiple of four elements around."
        )
    return dolfinx.fem.dirichletbc(0.0, dofs, part)
