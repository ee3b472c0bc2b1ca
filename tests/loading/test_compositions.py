# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Random combinations of the features of a path agree with a scalar model integrated by hand.

Memory, inertia, dashpots, a moving base, pressure, a plate, step lengths; steps that are refused,
interrupts by exceptions and signals, and restarts on one process or on all of them.
"""

from __future__ import annotations

import copy
import os
import shutil
import signal
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
from collective import COMM, agree, small
from hypothesis import HealthCheck, Phase, example, given, settings
from hypothesis import strategies as st
from one_scalar import Block, Law, Scalar, exact
from programs import finish, start

from dolfinx_feti import ConvergenceError
from dolfinx_feti.loading import Checkpoint

TOLERANCE = 1e-10


class StopError(Exception):
    """Raised in ``on_step`` to end a run."""


@dataclass(frozen=True)
class Event:
    """What happens during an attempt, on the last process alone."""

    kind: str  #: ``refuse``, ``interrupt`` by an exception or a ``signal``, ``stop`` in ``on_step``
    newton: int  #: in which Newton step
    restart: bool  #: whether the run goes on from the checkpoint, not from what is in memory
    alone: bool  #: whether it then does so on one process


LAWS = st.builds(
    Law,
    inertia=st.sampled_from([None, None, 0.0, 0.8, 1.0]),
    share=st.sampled_from([0.0, 0.5]),
    viscosity=st.sampled_from([0.0, 0.3]),
    base=st.sampled_from([0.0, 0.1]),
    pressure=st.sampled_from([0.0, 0.4, -0.2]),
    stop=st.sampled_from([None, None, 0.002, 0.01]),
)
EVENTS = st.dictionaries(
    st.integers(0, 7),
    st.builds(
        Event,
        kind=st.sampled_from(["refuse", "interrupt", "signal", "stop"]),
        newton=st.integers(0, 1),
        restart=st.booleans(),
        alone=st.booleans(),
    ),
    max_size=3,
)
GAPS = st.lists(st.sampled_from([0.02, 0.05, 0.07, 0.1]), min_size=1, max_size=3)


@cache
def block(alone: bool, inertia: float | None, stopped: bool) -> Block:
    """Return the block, on each process alone or distributed, whose monitor triggers the event."""
    made = Block(MPI.COMM_SELF if alone else COMM, inertia, stopped=stopped)
    made.problem.solver.setMonitor(lambda snes, it, norm: MONITOR[0](it))
    return made


def no_monitor(_it: int) -> None:
    """Do nothing in a Newton step."""


MONITOR: list[Callable[[int], object]] = [no_monitor]


class Run:
    """A path of the block and of the scalar model, interrupted by events."""

    def __init__(self, law: Law, targets: list[float], first: float, growth: float) -> None:
        self.law = law
        self.targets = targets
        self.first = first
        self.growth = growth
        self.folder = Path(COMM.bcast(tempfile.mkdtemp()))
        self.block = block(False, law.inertia, law.stop is not None)
        self.block.reset(law)
        self.scalar = Scalar(law)
        self.known = {0.0: copy.deepcopy(self.scalar)}  # by time
        self.increments: dict[float, float] = {}
        self.place = self.folder / "all"
        self.checkpoint = Checkpoint(self.place, COMM)
        self.attempts = 0

    def matches(self) -> None:
        """Require the state and memory of the scalar model at its time."""
        at = self.scalar.t
        scalar = self.scalar
        block = self.block
        least, most = block.face()
        small(max(abs(least - scalar.u[1]), abs(most - scalar.u[1])), TOLERANCE)
        small(abs(float(block.g.value) - self.law.g(at)), 0.0)
        small(abs(float(block.p.value) - self.law.p(at)), 0.0)
        expected = (scalar.S, scalar.Q, scalar.seen)
        small(np.abs(np.subtract(block.remembered(), expected)).max(), TOLERANCE)

    def on_step(self, event: Event | None) -> Callable[[object], None]:
        def shown(step) -> None:
            before = self.scalar.S
            self.scalar.step(step.increment)
            self.scalar.t = step.load
            self.known[step.load] = copy.deepcopy(self.scalar)
            self.increments[step.load] = step.increment
            assert self.block.problem.residual_norm() <= TOLERANCE
            assert abs(self.block.remembered()[0] - before) <= TOLERANCE
            assert abs(self.block.remembered()[2] - self.scalar.seen) <= TOLERANCE
            dissipated = getattr(step, "dissipated", self.scalar.dissipated)
            assert abs(dissipated - self.scalar.dissipated) <= TOLERANCE
            assert max(abs(x - self.scalar.u[1]) for x in self.block.face()) <= TOLERANCE
            if event is not None and event.kind == "stop" and self.acts():
                raise StopError

        return shown

    def acts(self) -> bool:
        comm = self.block.comm
        return comm.rank == comm.size - 1

    def go(self, event: Event | None, attempt: int) -> bool:
        """Follow the path until an event ends it; return True if it has reached its end."""
        solves = 0

        def monitor(it: int) -> None:
            nonlocal solves
            if it == 0:
                solves += 1
            if event is None or solves != 1 + attempt or it != event.newton or not self.acts():
                return
            solves += 1  # once
            if event.kind == "refuse":
                raise ConvergenceError("refused")
            if event.kind == "interrupt":
                raise KeyboardInterrupt
            if event.kind == "signal":
                os.kill(os.getpid(), signal.SIGTERM)

        start = self.scalar.t
        left = [t for t in self.targets if t > start]
        restart = self.checkpoint.restart
        if not restart and left:
            self.scalar.start(min(self.first, left[0] - start))
        MONITOR[0] = monitor
        try:
            self.block.follow(
                self.law,
                self.targets if restart else left,
                self.first,
                start=0.0 if restart else start,
                growth=self.growth,
                checkpoint=self.checkpoint,
                on_step=self.on_step(event),
            )
        except (KeyboardInterrupt, SystemExit, StopError):
            return False
        finally:
            MONITOR[0] = no_monitor
            self.matches()
        return True

    def restart(self, alone: bool) -> None:
        """Restart from the checkpoint, if any, after the memory was overwritten."""
        COMM.barrier()
        old = self.folder / "all" if self.block.comm == COMM else self.folder / "alone 0"
        new = self.folder / (f"alone {COMM.rank}" if alone else "all")
        found = COMM.bcast((old / "state.npz").exists())
        if found and (alone or COMM.rank == 0) and old != new:
            new.mkdir(exist_ok=True)
            shutil.copy(old / "state.npz", new / "state.npz")
        COMM.barrier()
        self.block = block(alone, self.law.inertia, self.law.stop is not None)
        self.block.reset(self.law, 0.37 if found else 0.0)
        self.block.g.value = self.block.p.value = 0.0
        self.block.dt.value = 0.0
        self.checkpoint = Checkpoint(new, self.block.comm, restart=found)
        at = self.checkpoint.record["loads"][-1] if found else 0.0
        self.scalar = copy.deepcopy(self.known[at])


@pytest.mark.processes(1, 2, 3)
@settings(
    max_examples={1: 300, 2: 40}.get(COMM.size, 8),
    derandomize=True,
    database=None,
    deadline=None,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=list(HealthCheck),
)
@example(  # all steps are of one length
    law=Law(inertia=1.0, base=0.1),
    gaps=[0.02, 0.07, 0.07],
    first=0.05,
    growth=1.0,
    events={0: Event("interrupt", 0, False, True), 1: Event("signal", 1, True, True)},
)
@given(
    law=LAWS,
    gaps=GAPS,
    first=st.sampled_from([0.03, 0.05, 0.1]),
    growth=st.sampled_from([1.0, 1.5]),
    events=EVENTS,
)
def test_each_step_agrees_with_the_scalar_model(law, gaps, first, growth, events):
    """Each step has the scalar model's state, also after interruptions and restarts."""
    targets = [round(t, 12) for t in np.cumsum(gaps)]
    run = Run(law, targets, first, growth)
    for attempt, event in sorted(events.items()):
        if run.go(event, attempt):
            break
        if event.restart:
            run.restart(event.alone)
        else:
            run.checkpoint.restart = False
    else:
        agree(run.go(None, 0))
    small(run.scalar.t - targets[-1], 0.0)
    COMM.barrier()
    if COMM.rank == 0:
        shutil.rmtree(run.folder)
    if any(e.kind == "refuse" or not e.restart for e in events.values()):
        return
    undisturbed = Run(law, targets, first, growth)
    agree(undisturbed.go(None, 0))
    agree(undisturbed.increments == run.increments, (undisturbed.increments, run.increments))
    small(undisturbed.scalar.u[1] - run.scalar.u[1], TOLERANCE)
    COMM.barrier()
    if COMM.rank == 0:
        shutil.rmtree(undisturbed.folder)


@pytest.mark.serial
@pytest.mark.parametrize(
    ("law", "order"),
    [
        (Law(1.0, 0.5, 0.3, 0.1, 0.4), 2),
        (Law(0.8, 0.5, 0.3, 0.1, 0.4), 2),
        (Law(0.0, 0.0, 0.3, 0.1, 0.0), 2),
        (Law(0.8, 0.5, 0.0, 0.0, 0.4), 2),
        (Law(None, 0.5, 0.3, 0.1, 0.4), 1),
    ],
)
def test_scalar_model_converges_with_its_known_order(law, order):
    """The steps of the scalar model converge to its differential equation with their known order.

    Long and short steps take turns. Dashpots without inertia are of first order. With it the work
    on dashpots is of the order of the displacement.
    """
    errors = []
    for n in (40, 80, 160):
        scalar = Scalar(law)
        found = []
        work = [0.0]
        lengths = np.tile([1.4, 0.6, 1.0], n)[:n]
        lengths *= 0.8 / lengths.sum()
        scalar.start(lengths[0])
        for h in lengths:
            scalar.step(h)
            found.append(scalar.u[1])
            work.append(work[-1] + scalar.dissipated)
        u, dissipated = exact(law, np.minimum(np.cumsum(lengths), 0.8))
        lacking = np.abs(work[1:] - dissipated).max() if law.inertia is not None else 0.0
        errors.append((np.abs(found - u).max(), lacking))
    ratios = np.divide(errors[:-1], np.maximum(errors[1:], 1e-15))
    moves = np.array(errors[0]) > 0.0
    agree(np.all(ratios[:, moves] > 0.8 * 2.0**order), (errors, ratios))


@pytest.mark.serial
@pytest.mark.parametrize("kind", ["equilibria", "inertia"])
def test_killed_path_restarts_with_the_same_steps(tmp_path, kind):
    """A path killed at random restarts on 2, 3 and 1 processes with the scalar model's steps."""
    finish(start(kind, tmp_path / "whole"))
    random = np.random.default_rng(len(kind))
    killed = 0
    for n in (1, 2, 3):
        words = (kind, tmp_path / "parts", random.uniform(1.5, 15.0), random.integers(n))
        process = start(*words, processes=n)
        process.communicate(timeout=120)
        if process.returncode != 0:
            killed += 1
    finish(start(kind, tmp_path / "parts"))
    whole, parts = (np.load(tmp_path / f"{name}.npz") for name in ("whole", "parts"))
    assert killed == 3
    assert np.abs(whole["path"] - parts["path"]).max() == 0.0
    assert np.abs(whole["found"] - parts["found"]).max() <= TOLERANCE
