# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Arc length along a straight path, where the load is known."""

from __future__ import annotations

import pytest
from collective import agree, equal
from problems import cube, dirichlet, left

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem
from dolfinx_feti.loading import Steps, follow_load
from dolfinx_feti.scalars import ArcLength


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e9])
def test_steps_along_a_straight_path(unit):
    """With u proportional to the load, each step is Δs of the load, and needs no second attempt.

    The prediction of u is exact, so that only the load changes in each step.
    """
    mesh = cube(3, 2)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u = dolfinx.fem.Function(V)
    load = dolfinx.fem.Constant(mesh, 0.0)
    energy = unit * (ufl.inner(ufl.grad(u), ufl.grad(u)) / 2 - load * u[0]) * ufl.dx
    problem = NonlinearProblem(
        ufl.derivative(energy, u),
        u,
        bcs=[dirichlet(V, left)],
        scalars=[ArcLength(u, load)],
        subdomains=4,
        petsc_options={"snes_rtol": 1e-10},
    )
    loads = []
    failures = []

    def note(step):
        loads.append(float(load.value))
        failures.append(step.failures)

    follow_load(
        problem, lambda s: None, [0.6], Steps(first=0.1, least=0.01, growth=1.0), on_step=note
    )
    equal(loads, [0.1, 0.2, 0.3, 0.4, 0.5, 0.6], 1e-7)
    agree(failures == [0] * 6)
