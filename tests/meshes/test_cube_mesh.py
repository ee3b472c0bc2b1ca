# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The mesh of the unit cube: its volume, its nodes, and the place of each subcube."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, equal, small, whole

import dolfinx
import ufl

from meshes.cube import create_cube


@pytest.mark.parametrize(("subdomains", "cells"), [(2, 1), (2, 2), (3, 1)])
def test_mesh_fills_the_cube_and_keeps_subcubes_together(subdomains, cells):
    mesh, part = create_cube(COMM, subdomains, cells)
    n = mesh.topology.index_map(3).size_local
    agree(len(part) == n and mesh.topology.index_map(3).num_ghosts == 0)
    volume = COMM.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(1.0 * ufl.dx(mesh))))
    small(volume - 1.0, 1e-12)
    edge = subdomains * cells
    nodes = (edge + 1) ** 3 + edge**3 + 3 * edge**2 * (edge + 1)
    agree(mesh.topology.index_map(0).size_global == nodes)
    middle = dolfinx.mesh.compute_midpoints(mesh, 3, np.arange(n, dtype=np.int32))
    place = np.floor(subdomains * middle).astype(int)
    equal(np.ravel_multi_index(tuple(place.T), (subdomains,) * 3), part)
    count = np.bincount(whole(part), minlength=subdomains**3)
    agree(np.all(count == 24 * cells**3), count)
    mine = COMM.allgather(set(part.tolist()))
    agree(sum(map(len, mine)) == subdomains**3, mine)  # none on two processes
