# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Meshes of artery walls, and the meshes of the paper's studies. ``meshes/README.md`` has a guide.

The generators of walls, ``tube`` and ``vessel``, write files. ``surface`` and ``remesh`` prepare
the lumen, ``layers`` grows columns of prisms on it, ``bad_columns`` improves them, and ``files``
writes the result. ``walls`` generates such a file, or finds it, and reads it on all processes.

``bricks``, ``ellipsoid``, ``octant`` and ``cube`` create distributed meshes without a file; the
first two number their cells by ``lattice``. A new geometry of bricks is a file like ``ellipsoid``:
points and numbers of a lattice become ``WallArrays``, which ``distribute`` turns into a wall.

From the command line::

    python3 -m dolfinx_feti.meshes.vessel vessel.xdmf
    python3 -m dolfinx_feti.meshes.tube tube.xdmf --quarter

In the order of the data: arguments, surface, remesh, tags, quality, files, layers, bad_columns,
tube, random_lumen, vessel, walls, curved, lattice, bricks, ellipsoid, octant, cube.
"""
