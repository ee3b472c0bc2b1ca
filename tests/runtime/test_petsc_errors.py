# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Python code that PETSc calls: its garbage is collected, and its errors reach the caller."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable, Iterator

import pytest
from collective import agree, raises
from problems import cube, dirichlet, left, poisson, torn

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem

#: Cycles that a monitor makes each time it is called: in four calls above the threshold of the
#: collector, 700 to 2000 new objects (Python 3.12 to 3.14).
CYCLES = 500

#: Calls after which no cycle may be alive any more.
MAX_CALLS_ALIVE = 6


class Node:
    """An object in a cycle with itself."""

    def __init__(self) -> None:
        self.me = self


class Monitor:
    """A monitor that leaves cycles behind.

    Attributes:
        calls: How often it was called.
        max_alive: The most cycles that were alive when it was called.
        fails_at: The call in which it raises; None for none.
    """

    def __init__(self, fails_at: int | None = None) -> None:
        self.calls = 0
        self.max_alive = 0
        self.fails_at = fails_at
        self._alive: weakref.WeakSet[Node] = weakref.WeakSet()

    def __call__(self, solver: object, its: int, norm: float) -> None:
        self.calls += 1
        self.max_alive = max(self.max_alive, len(self._alive))
        for _ in range(CYCLES):
            self._alive.add(Node())
        if self.calls == self.fails_at:
            raise ZeroDivisionError("in the monitor")


@pytest.fixture
def eager_collector() -> Iterator[None]:
    """Collect garbage whenever an object is made."""
    before = gc.get_threshold()
    gc.set_threshold(1)
    yield
    gc.set_threshold(*before)


def create_linear(*options: str) -> Callable[[Monitor], Callable[[], object]]:
    """Return a function that creates a linear problem with a monitor and returns its ``solve``."""

    def create(monitor: Monitor) -> Callable[[], object]:
        settings = dict(option.split() for option in options)
        problem = torn(poisson(cube(2, 8)), 8, ksp_rtol=1e-12, **settings)
        problem.solver.setMonitor(monitor)
        return problem.solve

    return create


def create_nonlinear(solver: str) -> Callable[[Monitor], Callable[[], object]]:
    """Return the same for a problem of some eight Newton steps; SNES or KSP has the monitor."""

    def create(monitor: Monitor) -> Callable[[], object]:
        V = dolfinx.fem.functionspace(cube(2, 8), ("Lagrange", 1))
        u = dolfinx.fem.Function(V)
        v = ufl.TestFunction(V)
        F = ((1.0 + u**2) * ufl.inner(ufl.grad(u), ufl.grad(v)) - 50.0 * v) * ufl.dx
        problem = NonlinearProblem(F, u, bcs=[dirichlet(V, left)], subdomains=8)
        snes = problem.solver
        (snes if solver == "SNES" else snes.getKSP()).setMonitor(monitor)
        return problem.solve

    return create


SOLVERS = pytest.mark.parametrize(
    "create",
    [
        pytest.param(create_linear("feti_formulation primal"), id="primal"),
        pytest.param(create_linear("feti_formulation dual"), id="dual"),
        pytest.param(
            create_linear("feti_formulation dual", "feti_dual_ksp_rtol 1e-10"), id="own-test"
        ),
        pytest.param(create_linear("feti_dual_ksp_type gmres"), id="gmres"),
        pytest.param(create_nonlinear("SNES"), id="SNES"),
        pytest.param(create_nonlinear("KSP"), id="KSP-of-SNES"),
    ],
)


@SOLVERS
def test_garbage_is_collected_during_a_solve(create):
    """Cycles that a monitor leaves are freed while the solve goes on."""
    monitor = Monitor()
    create(monitor)()
    agree(monitor.calls > MAX_CALLS_ALIVE, f"{monitor.calls} calls show nothing")
    agree(
        monitor.max_alive <= MAX_CALLS_ALIVE * CYCLES,
        f"{monitor.max_alive} of {monitor.calls * CYCLES} cycles were alive at a time",
    )
    assert gc.isenabled()


@SOLVERS
@pytest.mark.parametrize("call", [1, 3])
@pytest.mark.usefixtures("eager_collector")
def test_error_of_a_monitor_survives_garbage_collection(create, call):
    """The exception is raised by the solve, although the collector runs at each allocation."""
    solve = create(Monitor(fails_at=call))
    with raises(ZeroDivisionError, "in the monitor"):
        solve()
    assert gc.isenabled()


@SOLVERS
@pytest.mark.usefixtures("without_collector")
def test_disabled_collector_stays_disabled(create):
    """A user may have disabled it for reasons of speed."""
    monitor = Monitor()
    create(monitor)()
    agree(
        monitor.max_alive == (monitor.calls - 1) * CYCLES,
        f"{monitor.max_alive} of {(monitor.calls - 1) * CYCLES} cycles were alive",
    )
    assert not gc.isenabled()
