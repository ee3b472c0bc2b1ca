# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A path finds the dashpots in the forms, and advances them whatever the order of calls."""

from __future__ import annotations

import gc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from problems import cube, dirichlet, left, owned

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, materials, supports
from dolfinx_feti.loading import Checkpoint, Motion, Steps, TimeSteps, follow_load, follow_time

VISCOSITY = 8.0  # kPa s/mm
STEPS = Steps(first=0.5, least=0.1, growth=1.0)
TIMES = TimeSteps(first=0.1, least=0.01)
TIGHT = {"snes_rtol": 1e-10, "ksp_rtol": 1e-10}


class Block:
    """A block that a load pulls along x, with the Functions and Constants of its dashpots."""

    def __init__(self) -> None:
        self.mesh = cube(3, 2)
        self.V = dolfinx.fem.functionspace(self.mesh, ("Lagrange", 1, (3,)))
        self.u, self.u0, self.last = (dolfinx.fem.Function(self.V) for _ in range(3))
        self.dt = dolfinx.fem.Constant(self.mesh, 0.5)
        self.load = dolfinx.fem.Constant(self.mesh, 1.0)
        F = kinematics.deformation_gradient(self.u)
        C = kinematics.right_cauchy_green(F)
        J = kinematics.jacobian(F)
        psi = materials.neo_hookean(C, c=5.0, J=J) + materials.volumetric(J, 20.0)
        self.elastic = (psi - self.load * self.u[0]) * ufl.dx
        self.ds = ufl.Measure("ds", self.mesh)

    def dashpot(self, u=None, last=None, time_step=None) -> ufl.Form:
        """Return the energy of a dashpot; arguments replace u, its last value and the time step."""
        return supports.dashpot_energy(
            VISCOSITY,
            self.u if u is None else u,
            self.last if last is None else last,
            self.dt if time_step is None else time_step,
            self.ds,
            "all",
        )

    def problem(self, *more: ufl.Form) -> NonlinearProblem:
        """Create the problem of the block, with further terms added to its energy."""
        return NonlinearProblem(
            sum(more, self.elastic),
            self.u,
            bcs=[dirichlet(self.V, left)],
            subdomains=2,
            quadrature_degree=2,
            petsc_options=TIGHT,
        )

    def set_load(self, load: float) -> None:
        """Set the force along x."""
        self.load.value = load

    def creep(self, dashpot: ufl.Form, **arguments: object) -> list[np.ndarray]:
        """Return u after each of three steps under a constant load."""
        displacements: list[np.ndarray] = []
        follow_load(
            self.problem(dashpot),
            lambda t: None,
            [0.5, 1.0, 1.5],
            STEPS,
            on_step=lambda step: displacements.append(owned(self.u)),
            **arguments,
        )
        return displacements


def equilibrium(load: float) -> np.ndarray:
    """Return the displacement under a load without dashpots and inertia."""
    block = Block()
    block.set_load(load)
    block.problem().solve()
    return owned(block.u)


def in_another_space(block: Block) -> ufl.Form:
    """Return a dashpot whose last displacement is in another space than u."""
    W = dolfinx.fem.functionspace(block.mesh, ("Lagrange", 2, (3,)))
    return block.dashpot(last=dolfinx.fem.Function(W))


@pytest.mark.parametrize(
    "dashpot",
    [
        pytest.param(lambda block: block.dashpot(block.u + block.u0), id="sum"),
        pytest.param(lambda block: block.dashpot(1.0 * block.u), id="multiple"),
        pytest.param(in_another_space, id="last-in-P2"),
    ],
)
def test_creep_does_not_depend_on_the_spelling_of_a_dashpot(dashpot: Callable[[Block], ufl.Form]):
    """Creep depends neither on the spelling of a dashpot's displacement nor on its last space."""
    block = Block()
    other = Block()
    expected = block.creep(block.dashpot())
    actual = other.creep(dashpot(other))
    creep = np.abs(expected[2] - expected[0]).max(initial=0.0)
    agree(COMM.allreduce(creep) > 0.01, f"from step 1 to 3 u creeps by {creep} alone")
    for a, b in zip(actual, expected, strict=True):
        equal(a, b, 1e-7)


def test_last_displacement_follows_a_sum_that_changes():
    """After a step, the last displacement of a dashpot on u + u0 is u + u0 with the new u0."""
    block = Block()
    problem = block.problem(block.dashpot(block.u + block.u0))
    expected = [np.zeros_like(block.u.x.array)]

    def set_load(t: float) -> None:
        block.u0.x.array[:] = 0.01 * t

    def compare_last(step) -> None:
        equal(block.last.x.array, expected[-1], 1e-12)
        expected.append(block.u.x.array + block.u0.x.array)

    follow_load(problem, set_load, [0.5, 1.0], STEPS, on_step=compare_last)
    equal(block.last.x.array, expected[-1], 1e-12)


@pytest.mark.parametrize("rtol", [None, 1e-2], ids=["exact", "rough"])
def test_restart_with_a_dashpot_on_a_sum_repeats_one_run(tmp_path: Path, rtol: float | None):
    """A restarted path has the end of an uninterrupted one, also if its first step is repeated."""
    steps = Steps(first=0.25, least=0.1, growth=1.0, rtol=rtol)

    def follow(name: str, targets: list[float], *, restart=False, until=np.inf) -> np.ndarray:
        block = Block()

        def interrupt(step) -> None:
            if step.load > until:
                raise InterruptedError

        checkpoint = Checkpoint(tmp_path / name, COMM, restart=restart)
        follow_load(
            block.problem(block.dashpot(block.u + block.u0)),
            block.set_load,
            targets,
            steps,
            checkpoint=checkpoint,
            on_step=interrupt,
        )
        return np.append(owned(block.u), owned(block.last))

    expected = follow("whole", [0.5, 1.0])
    with raises(InterruptedError, ""):
        follow("parts", [1.0], until=0.6)
    equal(follow("parts", [0.5, 1.0], restart=True), expected, 1e-8)


def test_motion_ignores_dashpots_that_are_not_in_the_forms():
    """A motion ignores a dashpot that is not in the forms, and sets the time step of others."""
    block = Block()
    motion = Motion(block.u, 1e-3)
    block.dashpot(time_step=0.1)  # of the first run of the cell
    problem = block.problem(motion.inertia, block.dashpot())
    follow_time(problem, motion, lambda t: None, [0.1], TIMES)
    agree(float(block.dt.value) != 0.5, "the motion has not set the time step of the dashpot")


REFUSED = {
    "time-sum": (
        lambda block: block.dashpot(block.u + block.u0),
        "A dashpot of .* cannot follow the motion of .*: give dashpot_energy the displacement",
    ),
    "time-number": (
        lambda block: block.dashpot(time_step=0.1),
        "with a number as its time step, time_step=0.1,",
    ),
    "time-space": (in_another_space, "in the space of the displacement"),
    "time-last": (
        lambda block: block.dashpot(last=block.last + block.u0),
        "A dashpot with last=.* cannot follow",
    ),
    "load-last": (
        lambda block: block.dashpot(last=block.last + block.u0),
        "A dashpot has last=.*, which a path of loads cannot advance",
    ),
    "load-one-last": (
        lambda block: block.dashpot() + block.dashpot(block.u + block.u0),
        "Two dashpots, .*, have one last displacement",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_path_refuses_dashpots_that_it_cannot_advance(case):
    """A path refuses dashpots that it cannot advance, with u unchanged."""
    dashpot, match = REFUSED[case]
    block = Block()
    motion = Motion(block.u, 1e-3)
    problem = block.problem(motion.inertia, dashpot(block))
    with raises(ValueError, match):
        if case.startswith("time"):
            follow_time(problem, motion, lambda t: None, [0.1], TIMES)
        else:
            follow_load(problem, block.set_load, [1.0], STEPS)
    small(np.abs(block.u.x.array).max(initial=0.0), 0.0)


def test_dashpot_refuses_u_as_its_last_displacement():
    """A dashpot refuses u itself as its last displacement."""
    block = Block()
    with pytest.raises(ValueError, match="last is u itself: give another Function"):
        block.dashpot(last=block.u)


# -- equilibria after a motion


def problem_after_motion(block: Block, *more: ufl.Form, rate: float = 0.0) -> NonlinearProblem:
    """Return the problem of a block after a motion whose Motion is deleted.

    Args:
        block: The block.
        more: Further terms of its energy, such as dashpots.
        rate: Factor of the motion's velocity in the residual.
    """
    motion = Motion(block.u, 1e-3)
    v = ufl.TestFunction(block.V)
    damped = rate * ufl.inner(motion.rate, v) * ufl.dx(block.mesh)
    F = ufl.derivative(sum(more, block.elastic + motion.inertia), block.u, v) + damped
    problem = NonlinearProblem(
        F,
        block.u,
        bcs=[dirichlet(block.V, left)],
        subdomains=2,
        quadrature_degree=2,
        petsc_options=TIGHT,
    )
    follow_time(problem, motion, lambda t: None, [0.2], TIMES)
    return problem


@pytest.mark.parametrize("rate", [0.0, 1.0], ids=["inertia", "and-rate"])
@pytest.mark.parametrize("has_dashpot", [False, True], ids=["free", "dashpot"])
def test_equilibrium_after_a_deleted_motion_has_no_inertia(rate, has_dashpot):
    """After its Motion is deleted, a problem has equilibria without inertia and dashpots."""
    block = Block()
    problem = problem_after_motion(block, *([block.dashpot()] if has_dashpot else []), rate=rate)
    gc.collect()
    follow_load(problem, block.set_load, [1.5], STEPS, start=1.0)
    equal(owned(block.u), equilibrium(1.5), 1e-7)
    if has_dashpot:
        agree(np.isinf(block.dt.value))


def test_velocity_of_a_motion_does_not_act_in_equilibria():
    """The velocity of a motion does not contribute to the equilibria of another problem."""
    block = Block()
    motion = Motion(block.u, 1e-3)
    follow_time(block.problem(motion.inertia), motion, lambda t: None, [0.2], TIMES)
    v = ufl.TestFunction(block.V)
    F = ufl.derivative(block.elastic, block.u, v) + ufl.inner(motion.rate, v) * ufl.dx(block.mesh)
    problem = NonlinearProblem(
        F,
        block.u,
        bcs=[dirichlet(block.V, left)],
        subdomains=2,
        quadrature_degree=2,
        petsc_options=TIGHT,
    )
    follow_load(problem, block.set_load, [1.5], STEPS, start=1.0)
    equal(owned(block.u), equilibrium(1.5), 1e-7)


def test_time_step_set_between_two_load_paths_is_kept():
    """A time step set between two load paths is kept, so that the dashpots resist in the second."""
    block = Block()
    problem = problem_after_motion(block, block.dashpot())
    follow_load(problem, block.set_load, [1.5], STEPS, start=1.0)
    block.dt.value = 0.5
    follow_load(problem, block.set_load, [2.0], STEPS, start=1.5)
    small(float(block.dt.value) - 0.5, 0.0)
    slow = owned(block.u)
    fast = equilibrium(2.0)
    moved = COMM.allreduce(float(np.abs(slow - fast).max(initial=0.0)))
    agree(moved > 1e-3, f"the dashpots have held the block back by {moved} alone")


def test_motion_after_equilibria_is_that_of_a_new_block():
    """After load steps in between, a motion has the end and the dissipation of a new block's."""
    ends = []
    for between in (False, True):
        block = Block()
        motion = Motion(block.u, 1e-3)
        problem = block.problem(motion.inertia, block.dashpot())
        if between:
            follow_time(problem, motion, lambda t: None, [0.1], TIMES)
            follow_load(problem, block.set_load, [1.0], STEPS, start=0.5)
            block.u.x.array[:] = 0.0
            for f in motion.histories:
                f.x.array[:] = 0.0
        steps = follow_time(problem, motion, lambda t: None, [0.2], TIMES)
        ends.append(np.append(owned(block.u), [step.dissipated for step in steps]))
    equal(ends[1], ends[0], 1e-7)
