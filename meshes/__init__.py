# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Meshes of artery walls, and the cube of the paper's linear study. See README.md.

The generators of walls write files; they need numpy and scipy, and dolfinx for XDMF alone.
``walls``, ``bricks``, ``ellipsoid``, ``octant`` and ``cube`` make distributed meshes of DOLFINx.

In the order of the data: arguments, surface, remesh, wall_mesh, layers, tube, lumen, vessel,
walls, bricks, ellipsoid, octant, cube.
"""
