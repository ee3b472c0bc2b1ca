# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What fails on the last process alone fails on all: options, compilation, monitors, assembly."""

from __future__ import annotations

import gc

import numpy as np
import pytest
from bodies import block, yeoh
from collective import COMM, agree, equal, raises
from problems import cube, poisson, torn
from walls import tube, wall

import dolfinx

from dolfinx_feti.fem import assembly
from dolfinx_feti.fem.condensation import Condensation

LAST = COMM.rank == COMM.size - 1


def broken(*_: object, **__: object) -> None:
    raise FloatingPointError("on purpose")


@pytest.mark.parametrize("name", ["form", "Expression"])
def test_compilation(name, monkeypatch):
    """As where the cache of one machine cannot be written."""
    original = getattr(dolfinx.fem, name)

    def compiled(*args: object, **options: object) -> object:
        result = original(*args, **options)  # all take part in it
        if LAST:
            raise RuntimeError("the cache is full")
        return result

    body = block(yeoh, (0.3, 0.1))
    monkeypatch.setattr(dolfinx.fem, name, compiled)
    with raises(RuntimeError, "the cache is full"):
        body.problem()


def solvers(which: str) -> tuple[object, object]:
    """Return a problem and one of its solvers."""
    problem = torn(poisson(cube(2, 4))) if which == "linear" else block(yeoh, (0.3, 0.1)).problem()
    return problem, problem.solver.getKSP() if which == "KSP" else problem.solver


@pytest.mark.parametrize(
    ("which", "collected"),
    [("SNES", False), ("KSP", False), ("linear", False), ("KSP", True), ("linear", True)],
)
def test_monitor_of_the_users_own(which, collected):
    """It fails on one process; or on all, while garbage is collected."""
    problem, solver = solvers(which)

    def monitor(solver: object, its: int, norm: float) -> None:
        for _ in range(100 * collected):
            cycle: list[object] = []
            cycle.append(cycle)
        if its == 1 and (LAST or collected):
            raise ZeroDivisionError("in the monitor")

    solver.setMonitor(monitor)
    before = gc.get_threshold()
    gc.set_threshold(*((1,) if collected else before))
    try:
        with raises(ZeroDivisionError, "in the monitor"):
            problem.solve()
    finally:
        gc.set_threshold(*before)
    assert gc.isenabled()
    agree(which != "SNES" or len(problem.history) == 1)


def test_volume_ratio(monkeypatch):
    body = block(yeoh, (0.3, 0.1))
    problem = body.problem()
    if LAST:
        monkeypatch.setattr(problem._system, "_own_volume_ratio", broken)
    with raises(FloatingPointError, "on purpose"):
        problem.solve()


@pytest.mark.parametrize("name", ["assemble", "residual", "subtract_from"])
def test_condensation(name, monkeypatch):
    body = wall(tube(), degree=1)
    problem = body.problem(4)
    body.load.value = 1.0
    if LAST:
        monkeypatch.setattr(Condensation, name, broken)
    with raises(FloatingPointError, "on purpose"):
        problem.solve()


def test_potential(monkeypatch):
    """The pressure is the user's again, on all processes."""
    body = wall(tube(), degree=1)
    problem = body.problem(4)
    system = problem._system
    body.p.x.array[:] = before = np.arange(len(body.p.x.array), dtype=float)
    potential = broken if LAST else lambda _: 1.0
    monkeypatch.setattr(system, "_energy", object())
    monkeypatch.setattr(assembly, "integrate", potential)
    with raises(FloatingPointError, "on purpose"):
        system.potential()
    equal(body.p.x.array, before)
