# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Subdomains that touch a clamped rim in a few points, and the volume ratios of elements."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from collective import COMM, agree, equal, raises

import dolfinx

from benchmarks.common.walls.volume import summarise, volume_ratios
from benchmarks.nonlinear.rims import POINTS, partition
from dolfinx_feti.wall import facets, openings
from meshes.walls import create_tube_wall


def points_on_rim(wall, part, number):
    """Count the vertices of a subdomain of this process that are clamped."""
    V = dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 1))
    rims = np.concatenate([facets(wall, name) for name in openings(wall)])
    held = dolfinx.fem.locate_dofs_topological(V, 2, rims)
    return len(np.intersect1d(V.dofmap.list[: len(part)][part == number], held))


def test_one_subdomain_loses_the_rim():
    wall = create_tube_wall(COMM, length=3.0, through=(1, 1), around=12, along=12)
    whole, few, none = (partition(wall, 6, contact) for contact in ("whole", "few", "none"))
    changed = np.unique(whole[whole != none])
    agree(COMM.allreduce(len(changed)) == 1, changed)
    number = changed[0] if len(changed) else -1
    found = [points_on_rim(wall, part, number) for part in (whole, few, none)]
    agree(number == -1 or (found[0] > found[1] == POINTS and found[2] == 0), found)
    agree(np.all(few[few != none] < none[few != none]))  # those cells stay where they were
    agree(0 < COMM.allreduce(np.count_nonzero(few != none)) <= 3 * 24)
    with raises(ValueError, "touches a rim"):
        partition(wall, COMM.allreduce(len(whole)), "few")


@pytest.mark.parametrize("degree", [1, 2])
def test_volume_ratio_of_a_stretch(degree):
    """J = (1 + a)(1 + b x) has the mean 1 + b x at the centroid, up to the quadrature."""
    mesh = dolfinx.mesh.create_unit_cube(COMM, 2, 2, 2)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    u = dolfinx.fem.Function(V)
    b = 0.1 * (degree - 1)
    u.interpolate(lambda x: np.array([b * x[0] ** 2 / 2, 0.02 * x[1], 0.0 * x[2]]))
    n = mesh.topology.index_map(3).size_local
    x = dolfinx.mesh.compute_midpoints(mesh, 3, np.arange(n, dtype=np.int32))[:, 0]
    J = volume_ratios(u)
    equal(J, 1.02 * (1 + b * x), 1e-12)
    found = summarise(J, COMM)
    low, high = (
        COMM.allreduce(float(f(J)), op=op) for f, op in ((np.min, MPI.MIN), (np.max, MPI.MAX))
    )
    equal([found["min_J"], found["max_J"], found["share_J"]], [low, high, 1.0], 1e-14)
    equal(found["mean_J"] - 1.0, found["mean_deviation_J"], 1e-10)
