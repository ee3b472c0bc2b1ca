# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Meshes of artery walls, and the meshes of the paper's studies. ``meshes/README.md`` has a guide.

================================================  ================================================
function                                          result
================================================  ================================================
``tube.write_tube``, ``vessel.write_vessel``      a file, written by one process, and its quality
``walls.open_wall``, ``walls.create_tube_wall``   a ``Wall`` on all processes, from such a file
``bricks.create_brick_tube``,                     a ``Wall`` on all processes, without a file
``ellipsoid.create_ellipsoid``
``octant.create_octant``, ``cube.create_cube``    a mesh of dolfinx, without layers and surfaces
``random_lumen.write_random_lumen``               an STL file of a lumen, for ``write_vessel``
================================================  ================================================

For a file, ``surface`` and ``remesh`` prepare the lumen, ``layers`` grows columns of prisms on it,
``bad_columns`` improves them, and ``files`` writes the result. ``lattice`` numbers the cells of
``bricks`` and ``ellipsoid``.

A new geometry of bricks is a file like ``ellipsoid``: points and numbers of a lattice become
``WallArrays``, which ``distribute`` turns into a wall. It does not check them: inverted cells have
a negative quality in ``walls.wall_quality``. Layers and surfaces may have any names; ``tags`` lists
the usual ones. A case names a generator, as in ``mesh = "tube"``, if that writes a file and is in
``walls.GENERATORS``.

From the command line::

    python3 -m dolfinx_feti.meshes.vessel vessel.xdmf
    python3 -m dolfinx_feti.meshes.tube tube.xdmf --quarter

In the order of the data: arguments, surface, remesh, tags, quality, files, layers, bad_columns,
tube, random_lumen, vessel, walls, curved, lattice, bricks, ellipsoid, octant, cube.
"""
