# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A thin tube with a sac, near its limit point: the path does not crawl, in any units."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, small
from walls import INNER, tube

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, loads
from dolfinx_feti.loading import LoadStep, Steps, follow_load

#: Length over that of the unit, and E over the pressure: 3 % above that of the limit point.
LENGTH, RATIO = 4.0, 24.0


def inflate(stiffness: float, unit: float, first: float) -> tuple[list[LoadStep], float]:
    """Follow a pressure from rest to 1; return the load steps, and max |u| over the unit."""
    mesh = tube(COMM, around=16, along=16, length=LENGTH)
    x = mesh.geometry.x
    r, height = np.hypot(x[:, 0], x[:, 1]), np.exp(-((x[:, 2] - LENGTH / 2) ** 2) / 0.3)
    thin = INNER + 0.3 * (r - INNER)
    x[:, :2] *= ((thin + 0.4 * INNER * height * (1 + x[:, 0] / r) / 2) / r)[:, None]
    mesh.topology.create_connectivity(2, 3)
    facets = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    nodes = dolfinx.mesh.entities_to_geometry(mesh, 2, facets)
    lumen = np.isclose(r[nodes], INNER).all(axis=1)
    x *= unit
    tags = dolfinx.mesh.meshtags(
        mesh, 2, np.sort(facets[lumen]), np.ones(lumen.sum(), dtype=np.int32)
    )
    ds = ufl.Measure("ds", mesh, subdomain_data=tags)(1)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u, v, du = dolfinx.fem.Function(V), ufl.TestFunction(V), ufl.TrialFunction(V)
    ends = dolfinx.mesh.locate_entities_boundary(
        mesh, 2, lambda x: np.isclose(x[2], 0.0) | np.isclose(x[2] / unit, LENGTH)
    )
    bcs = [dolfinx.fem.dirichletbc(np.zeros(3), dolfinx.fem.locate_dofs_topological(V, 2, ends), V)]
    p, E = dolfinx.fem.Constant(mesh, 0.0), dolfinx.fem.Constant(mesh, 1.0)
    F = ufl.Identity(3) + ufl.grad(u)
    J = ufl.det(F)
    psi = E * ((ufl.inner(F, F) - 3 - 2 * ufl.ln(J)) / 6 + ufl.ln(J) ** 2 / 2)
    elastic = ufl.derivative(psi * ufl.dx, u, v)
    tangent = ufl.derivative(elastic, u, du) + loads.follower_pressure_tangent(
        p, u, v, du, ds, bcs=bcs
    )
    problem = NonlinearProblem(
        elastic + loads.follower_pressure(p, u, v, ds),
        u,
        bcs=bcs,
        J=tangent,
        subdomains=8,
        quadrature_degree=2,
    )
    E.value = stiffness

    def set_load(load: float) -> None:
        p.value = load * stiffness / RATIO

    steps = follow_load(problem, set_load, [1.0], Steps(first=first, least=0.01), state=[u])
    return steps, COMM.allreduce(np.abs(u.x.array).max(initial=0.0), op=max) / unit


@pytest.mark.parametrize("first", [0.25, 0.1])
def test_no_crawl(first):
    """At most 22 Newton steps and 600 iterations, as many in MPa and mm as in Pa and m."""
    found = []
    for stiffness, unit in ((1.0, 1.0), (1e6, 1e-3)):
        steps, largest = inflate(stiffness, unit, first)
        taken = [step for each in steps for step in each.all_steps]
        iterations = sum(step.linear_iterations for step in taken)
        agree(len(taken) <= 22 and iterations <= 600, (len(taken), iterations))
        agree(min(step.step_length for step in taken) > 0.1, taken)
        found.append((len(taken), largest))
    (one, u), (other, w) = found
    agree(one == other and u > 0.5, found)
    small(w / u - 1.0, 1e-6)
