# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Intervals: subdomains in a row, which the coarse problem alone nearly solves."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, equal

import dolfinx
import ufl

from dolfinx_feti import LinearProblem

LENGTH = 2.5


@pytest.mark.parametrize("options", [{}, {"feti_formulation": "dual"}, {"feti_type": "classical"}])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("ends", ["held", "springs", "one held"])
def test_any_number_of_subdomains(degree, ends, options):
    """−k u″ = 1 with u = 0, or −k u′ = k u, at the ends; in any unit of k."""
    mesh = dolfinx.mesh.create_interval(COMM, 40, [0.0, LENGTH])
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree))
    u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), V.tabulate_dof_coordinates()[:, 0]
    a, at = (
        ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        {"held": (0.0, LENGTH), "one held": (0.0,)},
    )
    if ends == "springs":
        a += u * v * ufl.ds
    value = {"held": x * (LENGTH - x), "one held": x * (2 * LENGTH - x)}
    expected = value.get(ends, LENGTH + x * (LENGTH - x)) / 2
    bcs = [
        dolfinx.fem.dirichletbc(
            0.0, dolfinx.fem.locate_dofs_geometrical(V, lambda x, end=end: np.isclose(x[0], end)), V
        )
        for end in at.get(ends, ())
    ]
    for k in (1.0, 1e-9, 1e9):
        for subdomains in (2, 3, 4, 5, 6, 7, 8, 10, 13):
            problem = LinearProblem(
                k * a,
                v * ufl.dx,
                bcs=bcs,
                subdomains=subdomains,
                petsc_options={"ksp_rtol": 1e-11, **options},
            )
            equal(k * problem.solve().x.array, expected, 1e-8)
