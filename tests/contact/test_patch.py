# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A uniform contact pressure results for any cells, units, processes and subdomains."""

from __future__ import annotations

import numpy as np
import pytest
from collective import agree, equal, small
from problems import Cell
from touching import block, bump, plate

BODIES = {
    "triangles-P1": (2, 4, Cell.triangle, 1),
    "triangles-P2": (2, 4, Cell.triangle, 2),
    "quadrilaterals-Q2": (2, 4, Cell.quadrilateral, 2),
    "tetrahedra-P1": (3, 3, Cell.tetrahedron, 1),
    "tetrahedra-P2": (3, 3, Cell.tetrahedron, 2),
    "hexahedra-Q1": (3, 3, Cell.hexahedron, 1),
    "hexahedra-Q2": (3, 2, Cell.hexahedron, 2),
}


#: Force and Newton steps of the block above a bump, on one process with four subdomains.
FORCE = [0.002972108406783, 0.002972108406783, 0.024055257313281]
STEPS = 9


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("held_by", ["contact", "conditions"])
def test_pressure_is_uniform(body, held_by):
    """A block pressed on a plate has a uniform pressure, supported by it or not."""
    dim, n, cell, degree = BODIES[body]
    load = 0.1 if held_by == "contact" else None
    touching = block(plate(dim), dim=dim, n=n, cell=cell, degree=degree, pressure=load)
    if load is None:
        touching.numbers["height"].value = 0.05
    touching.problem.solve()
    least, most = touching.pressures()
    force = touching.contact.force()
    small(most / least - 1.0, 1e-8)
    small(force[-1] / least - 1.0, 1e-8)  # of a face of area one
    small(np.abs(force[:-1]).max() / least, 1e-10)
    if load is not None:
        small(least / load - 1.0, 1e-8)
    agree(touching.contact.penetration() <= 1e-3 / n)


@pytest.mark.processes(1, 2, 3)
@pytest.mark.parametrize("subdomains", [4, 12])
def test_answer_does_not_depend_on_processes_and_subdomains(subdomains):
    """Steps and forces are those of the record, whatever the decomposition."""
    touching = block(bump(3), subdomains=subdomains)
    touching.numbers["height"].value = 0.08
    touching.problem.solve()
    force = touching.contact.force()
    steps = [(step.step_length, step.shift) for step in touching.problem.history]
    equal(force, FORCE, 1e-12)
    agree(steps == [(1.0, 0.0)] * STEPS, steps)


@pytest.mark.parametrize(("length", "stress"), [(1e-3, 1e6), (1e3, 1e-3), (1.0, 1e3)])
def test_answer_does_not_depend_on_units(length, stress):
    """In other units, steps and the force over stress and area are the same."""
    results = []
    for unit, kind in ((1.0, 1.0), (length, stress)):
        touching = block(bump(3, unit), length=unit, stiffness=kind, n=2)
        touching.numbers["height"].value = 0.08 * unit
        touching.problem.solve()
        steps = [(step.step_length, step.shift) for step in touching.problem.history]
        results.append((touching.contact.force() / (kind * unit**2), steps))
    (one, steps), (other, other_steps) = results
    equal(other, one, 1e-10)
    agree(steps == other_steps, (steps, other_steps))


def test_residual_finds_the_same_state_as_an_energy():
    """A residual, whose potential is not known, has the solution of the energy."""
    forces = []
    for as_residual in (False, True):
        touching = block(bump(2), dim=2, cell=Cell.triangle, n=6, as_residual=as_residual)
        touching.numbers["height"].value = 0.08
        touching.problem.solve()
        forces.append(touching.contact.force())
    equal(forces[1], forces[0], 1e-9)


def test_second_solve_changes_little():
    """A second solve changes the force by at most the tolerance of the contact."""
    touching = block(bump(2), dim=2, cell=Cell.triangle, n=6)
    touching.numbers["height"].value = 0.08
    touching.problem.solve()
    small(touching.problem.residual_norm() / touching.contact.force()[-1], 1e-9)
    before = touching.contact.force()
    touching.problem.solve()
    equal(touching.contact.force(), before, 1e-4)
