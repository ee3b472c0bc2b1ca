# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Subdomains with kernels of all dimensions in one decomposition."""

from __future__ import annotations

from pathlib import Path

from petsc4py import PETSc

import numpy as np
import paper_cube
from collective import COMM, agree, small
from wall_files import on_first


def corners_and_edges(x: np.ndarray) -> np.ndarray:
    """Conditions on a cube of 3³ subcubes that leave kernels of all dimensions.

    A face of one subcube is clamped, and so an edge or a vertex of its neighbours; components are
    fixed in an edge of another one (two of them), and in two corners (one of them, and two).
    """
    face = (x[:, 0] == 0) & np.all(x <= 1, axis=1)
    mark = np.repeat(face[:, None], 3, axis=1)
    mark[(x[:, 0] == 3) & (x[:, 1] == 3) & (x[:, 2] <= 1), :2] = True
    mark[np.all(x == (3, 0, 0), axis=1), :2] = True
    mark[np.all(x == (3, 3, 3), axis=1), 0] = True
    return mark


def test_kernels_of_all_dimensions_in_one_decomposition(feti, tmp_path):
    """Theory bounds the eigenvalues from below by one, whatever is left of the rigid motions."""
    problem = paper_cube.cube(3, 1, fixed=corners_and_edges)
    options = {"type": "classical", "pc_type": "dirichlet", "scaling": "multiplicity"}
    options |= {"coarse_q": "identity", "coarse_modes": 0}
    ksp = feti(problem.A, **{f"feti_{name}": value for name, value in options.items()})
    load = np.random.default_rng(5).standard_normal(len(problem.dirichlet))
    b, x = problem.vector(load), problem.A.createVecRight()
    ksp.solve(b, x)
    context = ksp.getPythonContext()
    agree(context.report().kernels == (1, 2, 1, 1, 2, 1, 19), context.report().kernels)
    agree(context.eigenvalues[0] >= 1.0 - 1e-6, context.eigenvalues)
    small(context.residual, 1e-8)
    path = COMM.bcast(str(tmp_path / "view.txt"))
    viewer = PETSc.Viewer().createASCII(path, comm=COMM)
    ksp.view(viewer)
    viewer.destroy()
    said = on_first(Path(path).read_text)
    agree("1 of dimension 0, 2 of dimension 1, 1 of dimension 2, 1 of dimension 3" in said, said)
    agree("2 of dimension 4, 1 of dimension 5, 19 of dimension 6; 27 exact" in said, said)
    problem.destroy()
