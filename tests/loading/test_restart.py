# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Restarted paths repeat uninterrupted ones; other problems and bad starts are refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from problems import cube, dirichlet, left
from walls import Wall, tube, wall

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, loads, materials, supports
from dolfinx_feti.fem.user_forms.form_content import content_of
from dolfinx_feti.loading import (
    Checkpoint,
    LoadStep,
    Motion,
    Steps,
    TimeSteps,
    follow_load,
    follow_time,
)
from dolfinx_feti.loading.step_length import StepLengthRule
from dolfinx_feti.runtime.compat import interpolation_points

STEPS = Steps(first=0.5, least=0.1, growth=1.0)
TIMES = TimeSteps(first=0.1, least=0.01)


class Pulled:
    """A block under a body force, with its stiffness as a Constant and κ as a number."""

    def __init__(self, *, c: float = 3.0, kappa: float = 10.0) -> None:
        self.mesh = cube(3, 2)
        V = dolfinx.fem.functionspace(self.mesh, ("Lagrange", 1, (3,)))
        self.u = dolfinx.fem.Function(V)
        self.load, self.c = (dolfinx.fem.Constant(self.mesh, value) for value in (0.0, c))
        F = kinematics.deformation_gradient(self.u)
        C = kinematics.right_cauchy_green(F)
        J = kinematics.jacobian(F)
        psi = materials.neo_hookean(C, c=self.c, J=J) + materials.volumetric(J, kappa)
        self.energy = (psi - self.load * self.u[0]) * ufl.dx
        self.bcs = [dirichlet(V, left)]

    def problem(self, more: ufl.Form | None = None) -> NonlinearProblem:
        energy = self.energy if more is None else self.energy + more
        return NonlinearProblem(energy, self.u, bcs=self.bcs, subdomains=2, quadrature_degree=2)

    def set_load(self, load: float) -> None:
        self.load.value = load

    def follow(
        self, targets: list[float], checkpoint: Checkpoint | None = None, steps: Steps = STEPS
    ):
        return follow_load(self.problem(), self.set_load, targets, steps, checkpoint=checkpoint)


@pytest.mark.parametrize(
    ("other", "match"),
    [
        ({"c": 4.0}, "a Constant of the forms is 3.0 there and 4.0 here"),
        ({"kappa": 20.0}, "its forms, such as the energy of a material, .* differ"),
    ],
)
def test_restart_with_another_material(tmp_path, other, match):
    """A restart refuses another material unless allowed, and accepts another load."""
    Pulled().follow([0.5], Checkpoint(tmp_path, COMM))
    with raises(ValueError, f"{match}.*allow_changes=True"):
        Pulled(**other).follow([0.5, 1.0], Checkpoint(tmp_path, COMM, restart=True))
    changed = Pulled(**other)
    checkpoint = Checkpoint(tmp_path, COMM, restart=True, allow_changes=True)
    agree([step.load for step in changed.follow([0.5, 1.0], checkpoint)] == [0.5, 1.0])
    small(float(changed.load.value) - 1.0, 0.0)
    agree(float(changed.c.value) == other.get("c", 3.0))


def test_signature_of_what_is_made_again():
    """The signature of equal forms does not depend on UFL's numbering of Constants."""
    numbers = set()
    for _ in range(30):
        body = Pulled()
        more = dolfinx.fem.Constant(body.mesh, 1.0) * body.c * body.u[1] ** 2 * ufl.dx
        forms = [body.energy, ufl.derivative(body.energy + more, body.u)]
        numbers.add(content_of([body.u], forms).signature)
    agree(len(numbers) == 1, numbers)
    one, other = (
        content_of([body.u], [k * body.c * body.u[0] * ufl.dx]).signature for k in (1.0, 2.0)
    )
    agree(one != other)


@pytest.mark.parametrize(
    "element",
    [
        ("Lagrange", 3, (3,)),
        ("N1curl", 2),
        ("RT", 3),
        basix.ufl.quadrature_element("tetrahedron", degree=3),
    ],
    ids=["P3", "N1curl", "RT", "quadrature"],
)
def test_elements_on_other_numbers_of_processes(tmp_path, element):
    """A field restarted on another number of processes is the same, for each element."""

    def create(comm):
        mesh = dolfinx.mesh.create_unit_cube(comm, 2, 3, 2)
        return dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element))

    f = create(COMM)
    alone = create(MPI.COMM_SELF)
    for g in (f, alone):
        x = ufl.SpatialCoordinate(g.function_space.mesh)
        values = ufl.as_vector([1 + x[0] * x[1], x[2] ** 2 - x[0], x[1] + 2 * x[2]])
        points = interpolation_points(g.function_space)
        g.interpolate(dolfinx.fem.Expression(values if g.ufl_shape else values[0], points))
    Checkpoint(tmp_path, COMM).write([f], {})
    before = alone.x.array.copy()
    alone.x.array[:] = 0.0
    Checkpoint(tmp_path, MPI.COMM_SELF, restart=True).read([alone])
    equal(alone.x.array, before, 1e-13)


def test_what_is_refused_when_a_motion_begins():
    """A motion refuses forms without its inertia, unfit dashpots and descending times."""
    body = Pulled()
    motion = Motion(body.u, 1.0)
    last = dolfinx.fem.Function(body.u.function_space)
    resists = supports.dashpot_energy(1.0, body.u, last, 0.1, ufl.ds(body.mesh))
    right = body.problem(motion.inertia)
    for problem, start, targets, match in (
        (body.problem(), 0.0, [0.1], "do not hold the inertia of this Motion"),
        (body.problem(motion.inertia + resists), 0.0, [0.1], "with a number as its time step"),
        (right, 1.0, [0.7, 0.5], r"start=1.0, targets=\[0.7, 0.5\]: times ascend from the start"),
        (right, 0.0, [0.2, 0.1], "turns back"),
    ):
        with raises(ValueError, match):
            follow_time(problem, motion, body.set_load, targets, TIMES, start=start)
    with raises(ValueError, "rho = 1.5: give a spectral radius"):
        Motion(body.u, 1.0, rho=1.5)


def test_equilibria_after_a_motion():
    """Load steps after a motion have equilibria without inertia and velocity."""
    body = Pulled()
    motion = Motion(body.u, 1e-3)
    last = dolfinx.fem.Function(body.u.function_space)
    dt = dolfinx.fem.Constant(body.mesh, np.inf)
    resists = supports.dashpot_energy(1.0, body.u, last, dt, ufl.ds(body.mesh))
    problem = body.problem(motion.inertia + resists)
    problem.solver.setTolerances(rtol=1e-10)
    follow_time(problem, motion, lambda t: body.set_load(t), [0.5], TIMES)
    follow_load(problem, body.set_load, [1.0], STEPS, start=0.5)
    other = Pulled()
    other.follow([1.0])
    equal(body.u.x.array, other.u.x.array, 1e-6)


# -- from where a run was interrupted


def follow(
    folder: Path,
    target: float,
    *,
    restart: bool,
    rtol: float | None = None,
    on_step: Callable[[LoadStep], object] | None = None,
    body: Wall | None = None,
):
    body = body or wall(tube(around=4, along=2), degree=1)
    steps = follow_load(
        body.problem(3),
        lambda mmhg: setattr(body.load, "value", loads.mmhg(mmhg)),
        [1.0, target],
        Steps(first=0.9, least=0.1, growth=1.3, rtol=rtol),
        checkpoint=Checkpoint(folder, COMM, restart=restart),
        on_step=on_step,
    )
    return steps, body


def interrupted(folder: Path, rtol: float | None = None) -> LoadStep:
    """Follow a load, interrupt the second step beyond 1 mmHg, and return the first one."""
    beyond: list[LoadStep] = []

    def stop(step: LoadStep) -> None:
        if beyond:
            raise InterruptedError
        if step.load > 1.0:
            beyond.append(step)

    with raises(InterruptedError, ""):
        follow(folder, 3.0, restart=False, rtol=rtol, on_step=stop)
    return beyond[0]


def test_a_restart_goes_the_way_of_one_run(tmp_path, caplog):
    """A restarted path repeats steps, increments, predictions and iterations."""
    whole, one = follow(tmp_path / "whole", 3.0, restart=False)
    agree(all(step.history[0].lag == 0 for step in whole), "a checkpoint has no preconditioner")
    interrupted(tmp_path / "parts")
    parts, other = follow(tmp_path / "parts", 3.0, restart=True)
    agree([step.load for step in parts] == [step.load for step in whole])
    agree(len(parts) > 4 and other.load.value == one.load.value == loads.mmhg(3.0))
    for a, b in zip(parts, whole, strict=True):
        agree(len(a.history) == len(b.history) and a.failures == b.failures)
    equal(other.u.x.array, one.u.x.array, 1e-9)
    caplog.clear()
    caplog.set_level("INFO", logger="dolfinx_feti")
    again, finished = follow(tmp_path / "parts", 3.0, restart=True)
    agree([step.load for step in again] == [step.load for step in parts], "nothing is left to do")
    restart = f"after load step {len(parts)}, at 3 of 3: nothing is left to do"
    agree(COMM.bcast(restart in caplog.text), caplog.text)
    equal(finished.u.x.array, other.u.x.array, 1e-14)


@pytest.mark.parametrize("rtol", [None, 1e-2])
def test_a_target_that_was_met_on_the_way(rtol, tmp_path):
    """A restart solves a reached target again only if it was solved with a loose tolerance."""
    kept = interrupted(tmp_path, rtol)
    shown: list[float] = []
    again, body = follow(
        tmp_path, kept.load, restart=True, rtol=rtol, on_step=lambda step: shown.append(step.load)
    )
    agree(shown == ([] if rtol is None else [kept.load]), f"shown again: {shown}")
    agree(again[-1].increment == kept.increment, again[-1].increment - kept.increment)
    agree([step.load for step in again].count(kept.load) == 1, [step.load for step in again])
    small(body.load.value - loads.mmhg(kept.load), 0.0)


def test_a_foreign_record(tmp_path):
    """A record of another program or with other fields is refused and left unchanged."""
    _, body = follow(tmp_path / "steps", 1.0, restart=False)
    other = Checkpoint(tmp_path / "steps", COMM, restart=True)
    other.record["steps"][0]["history"][0]["renamed"] = 1.0
    other.record["loads"] = [1.0]
    other.write([body.u, body.p], other.record)
    Checkpoint(tmp_path / "else", COMM).write([body.u, body.p], {"t": 1.0})
    for name in ("steps", "else"):
        body = wall(tube(around=4, along=2), degree=1)
        with raises(ValueError, "not written by follow_load of this version: name another folder"):
            follow(tmp_path / name, 2.0, restart=True, body=body)
        agree(not body.u.x.array.any() and body.load.value == 0.0)


class Alternating(StepLengthRule[LoadStep]):
    """A step-length rule with a state: long and short steps alternate."""

    def __init__(self, first, least):
        super().__init__(first, least)
        self.is_long = True

    def adapt(self, step, *, n_updates):
        self.present *= 0.5 if self.is_long else 2.0
        self.is_long = not self.is_long

    def record(self):
        return {**super().record(), "is_long": self.is_long}

    def restore(self, record):
        super().restore(record)
        self.is_long = record["is_long"]


@dataclass(frozen=True)
class AlternatingSteps(Steps):
    """Steps with the rule that alternates long and short ones."""

    def length_rule(self):
        return Alternating(self.first, self.least)


def test_a_record_of_another_step_length_rule(tmp_path):
    """A rule reads its own records, and refuses those of another rule."""
    Pulled().follow([0.5], Checkpoint(tmp_path / "usual", COMM))
    steps = AlternatingSteps(first=0.5, least=0.1)
    body = Pulled()
    checkpoint = Checkpoint(tmp_path / "usual", COMM, restart=True)
    with raises(ValueError, "'is_long', which Alternating .* name another folder"):
        body.follow([0.5, 1.0], checkpoint, steps)
    agree(not body.u.x.array.any() and body.load.value == 0.0)
    Pulled().follow([0.5], Checkpoint(tmp_path / "own", COMM), steps)
    again = Pulled().follow([0.5, 1.0], Checkpoint(tmp_path / "own", COMM, restart=True), steps)
    agree([step.load for step in again] == [0.5, 0.75, 1.0])
