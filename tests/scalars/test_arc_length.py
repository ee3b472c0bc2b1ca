# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Arc length along a straight path, where the load is known."""

from __future__ import annotations

from collective import equal
from problems import cube, dirichlet, left

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem
from dolfinx_feti.loading import Steps, follow_load
from dolfinx_feti.scalars import ArcLength


def test_steps_along_a_straight_path():
    """With u proportional to the load, each step is Δs of the load."""
    mesh = cube(3, 2)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u = dolfinx.fem.Function(V)
    load = dolfinx.fem.Constant(mesh, 0.0)
    energy = (ufl.inner(ufl.grad(u), ufl.grad(u)) / 2 - load * u[0]) * ufl.dx
    problem = NonlinearProblem(
        ufl.derivative(energy, u),
        u,
        bcs=[dirichlet(V, left)],
        scalars=[ArcLength(u, load)],
        subdomains=4,
        petsc_options={"snes_rtol": 1e-10, "ksp_rtol": 1e-10},
    )
    loads = []
    steps = Steps(first=0.1, least=0.05, growth=1.0)
    follow_load(
        problem, lambda s: None, [0.2], steps, on_step=lambda step: loads.append(float(load.value))
    )
    equal(loads, [0.1, 0.2], 1e-7)
