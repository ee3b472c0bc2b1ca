# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A tube that is pulled along its axis and then inflated, beside its semi-analytical solution."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, small

from benchmarks.common.bodies import create_solid
from benchmarks.common.walls.inflated_tube import create_slice
from benchmarks.common.walls.oracle import Wall, inflate
from benchmarks.common.walls.problem import tube_fibres
from dolfinx_feti import NonlinearProblem, loads, materials
from dolfinx_feti.wall import Pressure, Slide, apply_conditions

pytestmark = pytest.mark.serial

KAPPA, STRETCH, PRESSURE, SIZE = 1000.0, 1.15, 10.0, 0.26  # kPa, -, mmHg, mm
CONDITIONS = {"lumen": Pressure()} | {
    name: Slide() for name in ("opening_1", "opening_2", "symmetry_x", "symmetry_y")
}


@pytest.fixture(scope="module")
def states():
    """Mean radii of the lumen and of the outer wall [mm], pulled, and pulled and inflated."""
    wall, tissue = create_slice(COMM, size=SIZE), materials.ArteryParameters()
    parameters = {"c": tissue.c, "k1": tissue.k1, "k2": tissue.k2}
    fibres = tube_fibres(wall.mesh)
    solid = create_solid(
        wall.mesh,
        lambda C, J: materials.holzapfel_gasser_ogden(C, *fibres, **parameters, J=J),
        kappa=KAPPA, held=[], pressures=("DG", 0),
    )  # fmt: skip
    u, energy, V = solid.u, solid.energy, solid.u.function_space
    boundary = apply_conditions(wall, u, CONDITIONS, axis="z")
    problem = NonlinearProblem(
        energy + boundary.energy, u, bcs=boundary.bcs, condense=solid.p,
        subdomains=2, petsc_options_prefix="pulled_", quadrature_degree=4,
    )  # fmt: skip
    found = []
    for stretch, pressure in (
        (1 + 0.5 * (STRETCH - 1), 0.0),
        (STRETCH, 0.0),
        *((STRETCH, share * PRESSURE) for share in (0.25, 0.5, 0.75, 1.0)),
    ):
        boundary.set_stretch(stretch)
        boundary.pressure.value = loads.mmhg(pressure)
        problem.solve()
        if stretch == STRETCH and pressure in (0.0, PRESSURE):
            found.append((pressure, [radius(u, R) for R in (0.71, 1.10)]))
    length = float(wall.mesh.comm.allreduce(wall.mesh.geometry.x[:, 2].max(), op=max))
    x = V.tabulate_dof_coordinates()
    top = u.x.array.reshape(-1, 3)[np.isclose(x[:, 2], length), 2]
    small(float(np.abs(top - (STRETCH - 1) * length).max(initial=0.0)), 1e-9)
    return dict(found)


def radius(u, R):
    """Deformed mean radius of the nodes at a reference radius, those on chords left out."""
    V = u.function_space
    n = V.dofmap.index_map.size_local
    X = V.tabulate_dof_coordinates()[:n]
    x = X + u.x.array[: 3 * n].reshape(-1, 3)
    here = np.isclose(np.hypot(X[:, 0], X[:, 1]), R, rtol=1e-9)
    radii = np.concatenate(COMM.allgather(np.hypot(x[here, 0], x[here, 1])))
    agree(np.ptp(radii) <= 0.02 * R, radii)
    return float(radii.mean())


@pytest.mark.parametrize("pressure", [0.0, PRESSURE])
def test_radii_are_those_of_the_theory(states, pressure):
    """Within what chords in place of circles cost; far closer than without the stretch."""
    tube = inflate(loads.mmhg(pressure), Wall(kappa=KAPPA, stretch=STRETCH))
    at_rest = inflate(loads.mmhg(pressure), Wall(kappa=KAPPA))
    for found, R in zip(states[pressure], (0.71, 1.10), strict=True):
        error = abs(found - tube.radius(R))
        small(error, 0.01 * R)
        agree(error <= 0.1 * abs(found - at_rest.radius(R)), (found, tube.radius(R)))
