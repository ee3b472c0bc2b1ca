# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The five points of a wall at which displacement and stress are followed."""

from __future__ import annotations

import numpy as np
from collective import agree, small, whole
from walls import tube

import dolfinx

from benchmarks.load_stepping.points import five_points


def test_points_do_not_depend_on_the_processes():
    """Five places far from each other, the same cells on any number of processes."""
    mesh = tube()
    points = five_points(mesh)
    n = mesh.topology.index_map(3).size_local
    X = dolfinx.mesh.compute_midpoints(mesh, 3, np.arange(n, dtype=np.int32))
    places = [whole(X[cell]) for cell in points]
    agree(all(place.shape == (1, 3) for place in places))
    x = np.concatenate(places)
    apart = np.linalg.norm(x[:, None] - x, axis=-1)[~np.eye(5, dtype=bool)]
    agree(apart.min() > 0.5, apart)
    everything = whole(X)
    nearest = np.linalg.norm(everything - everything.mean(axis=0), axis=1)
    small(np.linalg.norm(x[0] - everything.mean(axis=0)) / nearest.max() - 1.0, 1e-12)
