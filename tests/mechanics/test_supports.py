# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Springs and dashpots on one face of a cube: their energies, and the work of their tractions."""

from __future__ import annotations

import functools

from mpi4py import MPI

import numpy as np
import pytest
from ufl_values import scalar

import dolfinx
import ufl

from dolfinx_feti import supports

STIFFNESS, VISCOSITY, STEP = 1.7, 0.3, 0.2
EPS = 1e-12

directions = pytest.mark.parametrize("direction", ["normal", "all"])


@functools.cache
def cube():
    """Unit cube, a P2 space, a measure whose tag 1 is the face x = 0."""
    mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_WORLD, 2, 2, 2)
    face = dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[0], 0))
    tags = dolfinx.mesh.meshtags(mesh, 2, np.sort(face), np.ones(len(face), dtype=np.int32))
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    return V, ufl.Measure("ds", mesh, subdomain_data=tags)


def constant(*values):
    f = dolfinx.fem.Function(cube()[0])
    f.interpolate(lambda x: np.outer(values, np.ones_like(x[0])))
    return f


@directions
def test_energy_of_springs(direction):
    """k/2 A |w|² of a translation, with its component along x alone for the normal."""
    u, ds = constant(0.3, -0.2, 0.4), cube()[1]
    square = 0.3**2 if direction == "normal" else 0.3**2 + 0.2**2 + 0.4**2
    energy = supports.spring_energy(STIFFNESS, u, ds(1), direction)
    assert scalar(energy) == pytest.approx(STIFFNESS / 2 * square, rel=EPS)


@directions
def test_traction_of_springs_pushes_back(direction):
    """The residual is minus the work of the traction −k w: it is positive along w."""
    (V, ds), u = cube(), constant(0.3, -0.2, 0.4)
    residual = ufl.derivative(
        supports.spring_energy(STIFFNESS, u, ds(1), direction), u, ufl.TestFunction(V)
    )
    for i, component in enumerate((0.3, -0.2, 0.4)):
        expected = STIFFNESS * component * (i == 0 or direction == "all")
        e = constant(*np.eye(3)[i])
        assert scalar(residual, e) == pytest.approx(expected, rel=EPS, abs=EPS)


@directions
def test_dashpots_resist_the_rate(direction):
    """η (w − w⁰)/Δt against the motion; without effect in an infinite time step, or at rest."""
    (V, ds), u, last = cube(), constant(0.3, -0.2, 0.4), constant(0.1, 0.2, -0.1)
    step = dolfinx.fem.Constant(V.mesh, STEP)
    energy = supports.dashpot_energy(VISCOSITY, u, last, step, ds(1), direction)
    residual = ufl.derivative(energy, u, ufl.TestFunction(V))
    for i, rate in enumerate(np.array([0.2, -0.4, 0.5]) / STEP):
        expected = VISCOSITY * rate * (i == 0 or direction == "all")
        assert scalar(residual, constant(*np.eye(3)[i])) == pytest.approx(expected, abs=EPS)
    step.value = np.inf
    assert scalar(energy) == 0.0
    step.value, last.x.array[:] = STEP, u.x.array
    assert scalar(energy) == 0.0
