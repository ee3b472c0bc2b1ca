# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Near the rounding errors of a residual: a definite matrix is not called anything else."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree
from problems import dirichlet, left

import dolfinx
import ufl

from dolfinx_feti import LinearProblem

#: Stiffness of stripes and of a disc over that of the rest, and λ/μ.
JUMP, RATIO = 1e3, 1e3


def stripes(x):
    return ufl.lt(ufl.cos(3 * np.pi * x[0]), 0.0)


def disc(x):
    return ufl.lt((x[0] - 0.5) ** 2 + (x[1] - 0.5) ** 2, 0.09)


@pytest.mark.parametrize(
    "options",
    [{}, {"feti_type": "classical"}, {"feti_formulation": "primal"}, {"feti_pc_type": "lumped"}],
    ids=["all-floating", "classical", "primal", "lumped"],
)
@pytest.mark.parametrize(
    ("cells", "length", "stiff"),
    [((9, 14), 3.0, stripes), ((11, 16), 10.0, stripes), ((6, 19), 3.0, disc)],
    ids=["short", "long", "disc"],
)
def test_rounding_is_no_negative_curvature(cells, length, stiff, options):
    """Linear elasticity, P1, cut into 13 subdomains: CG comes to curvatures that are rounding."""
    corners = [np.zeros(2), np.array([length, 1.0])]
    mesh = dolfinx.mesh.create_rectangle(COMM, corners, cells)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    mu = ufl.conditional(stiff(ufl.SpatialCoordinate(mesh)), JUMP, 1.0)
    strain = [ufl.sym(ufl.grad(w)) for w in (u, v)]
    a = mu * (2 * ufl.inner(*strain) + RATIO * ufl.div(u) * ufl.div(v))
    problem = LinearProblem(
        a * ufl.dx(metadata={"quadrature_degree": 1}),
        -v[1] * ufl.dx,
        bcs=[dirichlet(V, left)],
        subdomains=13,
        petsc_options_prefix="rounding_",
        petsc_options={"ksp_rtol": 1e-9, **options},
    )
    problem.solve()
    step = problem.history[0]
    agree(step.linear_residual <= np.fmax(1e-9, step.linear_floor) < 1e-6, step)
    agree(step.indefinite in (0, None), step)
