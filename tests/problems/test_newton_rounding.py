# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Large κ, slender, lightly loaded: Newton's method ends where the residual is rounding, not above.

The reference is Newton's method on the uncondensed system in (u, p), whose residual κ does not
enter, with a sparse LU.
"""

from __future__ import annotations

import logging
from dataclasses import replace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, equal, logged_messages, raises
from mixed import Mixed, by_place
from walls import beam, tube, wall

import dolfinx_feti
from dolfinx_feti import loads
from dolfinx_feti.runtime.norms import norm

Reason = PETSc.SNES.ConvergedReason

#: On the beam [kPa].
PRESSURE = 0.004


class Reference(Mixed):
    """Newton's method that counts its steps."""

    def follow(self, load: float) -> int:
        """Make full steps until the residual is 1e-8 of that at the start; return their number."""
        self.body.load.value = load
        fixed = np.concatenate([bc._cpp_object.dof_indices()[0] for bc in self.body.bcs])
        start = None
        for steps in range(40):
            norm = np.linalg.norm(np.delete(self.residual(), fixed))
            start = start or norm
            if norm <= 1e-8 * start:
                return steps
            self.make_step()
        raise AssertionError("the reference did not converge")


def slender(comm, kappa):
    """Create Land's beam with a bulk modulus."""
    return beam(comm, "symmetric", kappa=kappa, cells=(10, 1, 1))


def compare(create, pressures, kappa):
    """Follow loads and require the reference's states and tangents; return FETI's Newton steps."""
    body = create(COMM)
    reference = Reference(create(MPI.COMM_SELF))
    problem = body.problem(8)
    steps = []
    for load in pressures:
        body.load.value = load
        problem.solve()
        steps += problem.history
        allowed = max(1e-10, problem.history[-1].floor)
        expected = reference.follow(load)
        tangents = [step.tangent_lag for step in problem.history].count(0)
        agree(tangents <= expected, (load, tangents, expected))
        agree(len(problem.history) <= expected + 2, (load, problem.history, expected))
        agree(problem.residual_norm() <= max(allowed, 1e-8 * problem.history[0].residual))
        equal(by_place(body.u), by_place(reference.body.u), 1e-7)
    for step in steps:
        agree(step.linear_residual <= np.fmax(step.linear_rtol, step.linear_floor), step)
        agree(not step.linear_floor > 1e-7 * max(1.0, kappa / 1e4), step)
    return steps


ALONE = [pytest.param(*c, marks=pytest.mark.serial) for c in ((1e3, 2), (1e4, 5), (1e6, 5))]


@pytest.mark.parametrize(("kappa", "count"), [(1e5, 2), *ALONE])
def test_slender_beam_takes_no_more_tangents_than_the_reference(kappa, count):
    """A slender beam converges with at most the reference's tangents, to the reference's state."""
    pressures = PRESSURE * np.arange(1, count + 1) / 5
    steps = compare(lambda comm: slender(comm, kappa), pressures, kappa)
    agree((steps[0].linear_floor > 0.0) == (kappa > 1e4), steps[0])


def test_tube_with_a_penalty_of_a_million_shear_moduli():
    """A tube with κ a million times the shear modulus converges as the reference does."""
    kappa = 3e6
    compare(lambda comm: wall(tube(comm), kappa=kappa), [loads.mmhg(5.0), loads.mmhg(10.0)], kappa)


def light_beam(**options):
    body = slender(COMM, 1e6)
    body.load.value = PRESSURE / 5
    return body, body.problem(8, {"snes_atol": 0.0, **options})


def test_equilibrium_is_solved_for_again():
    """A second solve from equilibrium ends after one step, at the floor of rounding."""
    _, problem = light_beam()
    found = problem.diagnose()
    agree("at the floor of rounding" in str(found), found)
    agree("residual that is rounding" in {piece.quantity for piece in found.advice}, found)
    problem.solve()
    before = by_place(problem.u)
    problem.solve()
    agree(problem.solver.getConvergedReason() == Reason.CONVERGED_FNORM_ABS)
    agree(len(problem.history) == 1 and problem.history[0].residual <= problem.history[0].floor)
    equal(by_place(problem.u), before, 1e-7)


def test_residual_above_rounding_is_not_converged(monkeypatch):
    """A residual 100 times above its rounding floor does not count as converged."""
    _, problem = light_beam(snes_max_it=15)
    system = problem._system
    assembled = type(system).residual
    random = np.random.default_rng(COMM.rank)

    def disturbed(self):
        here = assembled(self)
        noise = self.conditions.free(random.standard_normal(self.owned))
        scale = 100 * problem.history[-1].floor if problem.history else 0.0
        return replace(here, condensed=here.condensed + scale / norm(self.comm, noise) * noise)

    monkeypatch.setattr(type(system), "residual", disturbed)
    with raises(dolfinx_feti.ConvergenceError, "steps|step length"):
        problem.solve()
    last = problem.history[-1]
    agree(last.residual > 10 * last.floor, last)


def test_load_change_below_rounding_causes_a_warning(caplog):
    """A load change below rounding causes a warning that recommends larger steps."""
    body, problem = light_beam()
    problem.solve()
    body.load.value *= 1.0 + 1e-8
    with caplog.at_level(logging.WARNING, "dolfinx_feti"):
        problem.solve()
    said = logged_messages(caplog)
    agree(len(said) == 1 and "doubtful" in said[0] and "larger steps" in said[0], said)
