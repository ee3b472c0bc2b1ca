# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Conditions on surfaces: the dofs they prescribe, their potentials, and bad arguments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from collective import agree, equal, raises
from ufl_values import scalar
from wall_files import tube_wall

import dolfinx
import ufl

from dolfinx_feti.wall import (
    Clamp,
    Condition,
    Contribution,
    Dashpot,
    Pressure,
    Slide,
    Spring,
    apply_conditions,
    area,
)

LENGTH = 1.0


@pytest.fixture(scope="module")
def wall(tmp_path_factory):
    """A whole tube."""
    return tube_wall(tmp_path_factory.mktemp("whole"), length=LENGTH, size=0.5)


@pytest.fixture(scope="module")
def quarter(tmp_path_factory):
    """A quarter of a tube."""
    return tube_wall(tmp_path_factory.mktemp("quarter"), length=LENGTH, size=0.5, quarter=True)


ENDS = {"opening_1": Slide(), "opening_2": Slide()}
QUARTER = ENDS | {"symmetry_x": Slide(), "symmetry_y": Slide()}


def displacement(wall, degree=1):
    return dolfinx.fem.Function(dolfinx.fem.functionspace(wall.mesh, ("Lagrange", degree, (3,))))


def translate(u, by):
    """Set u to one vector everywhere."""
    u.interpolate(lambda x: np.outer(by, np.ones_like(x[0])))


# -- Dirichlet conditions


def held(boundary, u):
    """Return True for each value of u that a condition prescribes, (nodes, 3)."""
    mask = np.zeros(len(u.x.array), dtype=bool)
    for bc in boundary.bcs:
        mask[bc.dof_indices()[0]] = True
    return mask.reshape(-1, 3)


def test_clamps_and_slides_hold_their_nodes(quarter):
    """Clamps fix all components on their surface, and slides the normal one."""
    u = displacement(quarter, 2)
    boundary = apply_conditions(
        quarter, u, {"opening_1": Clamp(), "opening_2": Slide(), "symmetry_x": [Slide()]}
    )
    x = u.function_space.tabulate_dof_coordinates()
    below = np.isclose(x[:, 2], 0.0)
    above = np.isclose(x[:, 2], LENGTH)
    side = np.isclose(x[:, 0], 0.0)
    expected = np.column_stack([below | side, below, below | above])
    equal(held(boundary, u), expected)


def test_stretch_moves_ends(quarter):
    """A prestretch prescribes (λ − 1) z on the ends, and zero elsewhere."""
    u = displacement(quarter, 2)
    conditions = {"opening_1": Clamp(), "opening_2": Slide(), "symmetry_x": Slide()}
    for first, second in (("opening_1", "opening_2"), ("opening_2", "opening_1")):
        ends = {first: Clamp(), second: Slide()}
        boundary = apply_conditions(quarter, u, conditions | ends, axis="z")
        boundary.set_stretch(1.2)
        u.x.array[:] = 0.0
        for bc in boundary.bcs:
            bc.set(u.x.array)
        z = u.function_space.tabulate_dof_coordinates()[:, 2]
        top = np.isclose(z, LENGTH)
        equal(u.x.array.reshape(-1, 3), np.outer(top, [0.0, 0.0, 0.2 * LENGTH]), 1e-12)
        boundary.set_stretch(1.0)
        agree(not boundary.clamped_displacement.x.array.any())


# -- forms


def test_energy_of_springs_and_dashpots(wall):
    """A translation by d stores k/2 A |d|² in springs, and η/(2 Δt) A d_z² in dashpots.

    Dashpots have no energy with an infinite time step, nor if u has not changed.
    """
    u = displacement(wall)
    d = np.array([0.1, -0.2, 0.3])
    k = 1.3
    η = 0.7
    dt = 0.05
    outer = [Spring(k, "all"), Dashpot(2 * η, "all")]
    end = [Dashpot(η), Spring(2 * k)]
    boundary = apply_conditions(wall, u, {"outer": outer, "opening_2": end})
    translate(u, d)
    outside = area(wall, "outer") * d @ d
    top = area(wall, "opening_2") * d[2] ** 2
    springs = k / 2 * outside + k * top
    dashpots = η / dt * outside + η / (2 * dt) * top
    equal(scalar(boundary.energy), springs, 1e-12)
    boundary.time_step.value = dt
    equal(scalar(boundary.energy), springs + dashpots, 1e-12)
    equal(scalar(boundary.residual, u), 2 * (springs + dashpots), 1e-12)
    boundary.advance(u)
    equal(scalar(boundary.energy), springs, 1e-12)


def test_pressure_has_a_potential_where_its_rims_are_held(wall, quarter):
    """The pressure has a potential if its rims are clamped or slide along an axis, or else none."""
    inside = {"lumen": Pressure()}
    whole = displacement(wall)
    part = displacement(quarter)
    for ends, has in (
        ({"opening_1": Clamp(), "opening_2": Clamp()}, True),
        (ENDS, True),
        ({"opening_1": Clamp(), "opening_2": Slide()}, True),
        ({"opening_1": Clamp()}, False),
        ({"opening_1": Spring(1.0), "opening_2": Spring(1.0)}, False),
    ):
        boundary = apply_conditions(wall, whole, inside | ends)
        agree((boundary.energy is not None) == has, ends)
    agree(apply_conditions(quarter, part, inside | QUARTER).energy is not None)
    stretched = apply_conditions(quarter, part, inside | QUARTER, axis="z")
    agree(stretched.energy is not None)


def test_tangent_follows_from_the_rim_where_there_is_no_potential(tmp_path):
    """Rims in two planes off the origin have no potential −p V, but a symmetric tangent."""
    wall = tube_wall(tmp_path, length=LENGTH, size=0.5, quarter=True)
    wall.mesh.geometry.x[:, :2] += (1.0, 2.0)
    u, d, w = (displacement(wall) for _ in range(3))
    d.interpolate(lambda x: np.sin([x[1] + x[2], 2 * x[0], x[0] + x[1]]))
    w.interpolate(lambda x: np.cos([2 * x[2], x[0] + x[1], 3 * x[1]]))
    for conditions, symmetric in ((QUARTER, True), (ENDS, False)):
        boundary = apply_conditions(wall, u, {"lumen": Pressure()} | conditions)
        boundary.pressure.value = 1.0
        agree(boundary.energy is None)
        a, a_T = (scalar(boundary.tangent, second, first) for first, second in ((d, w), (w, d)))
        agree((abs(a - a_T) <= 1e-12 * abs(a)) == symmetric, (conditions, a, a_T))


def test_shares_of_the_pressure(wall):
    """The residual of a pressure is proportional to its share."""
    u = displacement(wall)
    v = displacement(wall)
    translate(v, [0.0, 0.0, 1.0])
    v.x.array[:] *= u.function_space.tabulate_dof_coordinates().ravel()
    results = []
    for share in (1.0, 0.5, -2.0):
        boundary = apply_conditions(wall, u, {"lumen": Pressure(share), "opening_1": Clamp()})
        boundary.pressure.value = 3.0
        results.append(scalar(boundary.residual, v) / share)
    equal(results, np.full(3, results[0]), 1e-12)


# -- other kinds


@dataclass(frozen=True, slots=True)
class Tether(Condition):
    """Springs along z, given by an energy or by a residual alone."""

    stiffness: float
    has_potential: bool

    def contribution(self, surface):
        u = surface.state.u
        k = surface.constant(self.stiffness)
        if self.has_potential:
            return Contribution(energy=k / 2 * u[2] ** 2 * surface.ds)
        return Contribution(residual=k * u[2] * ufl.TestFunction(surface.V)[2] * surface.ds)


@pytest.mark.parametrize("has_potential", [True, False])
def test_condition_of_another_kind(wall, has_potential):
    """A user's condition may have an energy or a residual; residual and tangent are derived."""
    u = displacement(wall)
    d = displacement(wall)
    translate(u, [0.1, -0.2, 0.3])
    translate(d, [0.0, 0.0, 1.0])
    boundary = apply_conditions(wall, u, {"outer": [Tether(2.0, has_potential), Spring(1.0)]})
    agree((boundary.energy is not None) == has_potential)
    spring = apply_conditions(wall, u, {"outer": Spring(1.0)})
    outer = area(wall, "outer")
    equal(scalar(boundary.residual, d), scalar(spring.residual, d) + 0.6 * outer, 1e-12)
    equal(scalar(boundary.tangent, d, d), scalar(spring.tangent, d, d) + 2.0 * outer, 1e-12)


# -- what is refused


@pytest.mark.parametrize(
    ("conditions", "match"),
    [
        ({"outr": Spring(1.0)}, "no surface 'outr'; it has lumen, outer, opening_1"),
        ({"lumen": Slide()}, "surface 'lumen' lies in no plane"),
        ({"outer": [Clamp(), Spring(1.0)]}, "'outer'.* holds a clamp and another condition"),
        ({"outer": [Spring(1.0), Spring(2.0)]}, "'outer'.* holds a condition twice"),
        ({"outer": ["spring"]}, r"'outer'.* holds 'spring': give Pressure\(\), Spring\(stiffness"),
        ({"outer": "clamp"}, r"'outer'.* holds 'clamp': give Pressure\(\), .* or Clamp\(\)\."),
        ({"outer": 3.0}, r"'outer'.* holds 3.0: give Pressure\(\) .*set_pressure"),
        ({"outer": Pressure}, r"'outer'.* the class Pressure: .* in parentheses, Pressure\(\)"),
        ({"outer": [Spring]}, r"'outer'.* the class Spring: .*, Spring\(stiffness\)"),
    ],
)
def test_bad_conditions(wall, conditions, match):
    """Unknown surfaces, conflicting conditions and wrong types are refused with a remedy."""
    with raises(ValueError, match):
        apply_conditions(wall, displacement(wall), conditions)


@pytest.mark.parametrize("pressure", [np.nan, np.inf])
def test_pressure_that_is_not_finite_is_refused(wall, pressure):
    """The message names the argument, and the pressure stays as it is."""
    boundary = apply_conditions(wall, displacement(wall), ENDS)
    with raises(ValueError, "pressure = .*give a finite number"):
        boundary.set_pressure(pressure)
    agree(boundary.pressure.value == 0.0)


@pytest.mark.parametrize(
    ("axis", "stretch", "match"),
    [
        ("r", 1.1, "axis='r': choose 'x', 'y'"),
        ("x", 1.1, "axis='x': a prestretch pulls"),
        (None, 1.1, "no axis"),
        ("z", 0.0, "stretch ="),
        ("z", -1.0, "stretch ="),
    ],
)
def test_bad_stretch(wall, axis, stretch, match):
    """A prestretch without an axis, or that is not positive, is refused."""
    with raises(ValueError, match):
        apply_conditions(wall, displacement(wall), ENDS, axis=axis).set_stretch(stretch)
