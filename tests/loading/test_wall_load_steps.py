# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Load steps on a wall."""

from __future__ import annotations

from collective import agree, equal, small
from mixed import by_place
from walls import Wall, tube, wall

from dolfinx_feti import NonlinearProblem, loads
from dolfinx_feti.loading.load_steps import follow_load
from dolfinx_feti.loading.steps import LoadStep, Steps


def small_wall() -> Wall:
    return wall(tube(around=6, along=2), degree=1)


def follow_wall(
    body: Wall, problem: NonlinearProblem, targets: list[float], steps: Steps, **arguments: object
) -> list[LoadStep]:
    return follow_load(
        problem,
        lambda pressure: setattr(body.load, "value", loads.mmhg(pressure)),
        targets,
        steps,
        state=[body.u, body.p],
        **arguments,
    )


def test_wall_up_and_down():
    """The way does not matter: as solved at once, in steps, and on the way back."""
    tight = {"snes_rtol": 1e-11}
    direct, stepped = small_wall(), small_wall()
    direct.inflate(direct.problem(4, tight), [4.0])
    problem = stepped.problem(4, tight)
    steps = Steps(first=1.0, least=0.25)
    for start, targets in ((0.0, [4.0]), (4.0, [7.0, 4.0])):
        record = follow_wall(
            stepped, problem, targets, steps, start=start, unloading=len(targets) > 1
        )
        agree(record[-1].load == 4.0 and not any(step.failures for step in record))
        equal(by_place(stepped.u), by_place(direct.u), 1e-8)
        equal(by_place(stepped.p), by_place(direct.p), 1e-7)
        small(max(s.linear_residual / s.linear_rtol for r in record for s in r.history), 1.0)


def test_wall_with_steps_that_fail():
    """Too few Newton steps for the wanted increment, enough for a half of it."""
    body = small_wall()
    problem = body.problem(4, {"snes_max_it": 3})
    record = follow_wall(body, problem, [60.0], Steps(first=60.0, least=0.1))
    agree(sum(step.failures for step in record) > 0 and record[-1].load == 60.0)
    direct = small_wall()
    direct.inflate(direct.problem(4, {"snes_rtol": 1e-11}), [10.0, 30.0, 60.0])
    equal(by_place(body.u), by_place(direct.u), 1e-6)
