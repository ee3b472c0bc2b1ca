# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Meshes of artery walls, and the meshes of the paper's studies. ``meshes/README.md`` has a guide.

The generators of walls, ``tube`` and ``vessel``, write files: ``surface`` and ``remesh`` prepare
the lumen, ``layers`` grows prisms on it, and ``wall_mesh`` has the arrays of the wall and writes
them. ``walls`` generates such a file, or finds it, and reads it on all processes. ``bricks``,
``ellipsoid``, ``octant`` and ``cube`` create distributed meshes of DOLFINx without a file. From the
command line::

    python3 -m dolfinx_feti.meshes.vessel vessel.xdmf
    python3 -m dolfinx_feti.meshes.tube tube.xdmf --quarter

In the order of the data: arguments, surface, remesh, wall_mesh, layers, tube, lumen, vessel,
walls, curved, bricks, ellipsoid, octant, cube.
"""
