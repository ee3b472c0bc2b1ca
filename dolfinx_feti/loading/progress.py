# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""How far a load has come: a bar on a terminal, a line for each load step in the log.

The time left follows from the pace of the last load steps: with the increments Δt_k of their loads,
the seconds s_k that they took and the remaining distance d, it is d Σ s_k / Σ abs(Δt_k).
"""

from __future__ import annotations

import itertools
import logging
import math
import shutil
import sys
import time
from collections.abc import Sequence
from types import TracebackType

from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_feti.loading.steps import LoadStep
from dolfinx_feti.runtime.collective import reason

__all__ = ["Progress", "duration", "time_left"]

logger = logging.getLogger("dolfinx_feti")

#: Characters of the bar itself.
WIDTH = 24

#: How many load steps the pace is taken from.
RECENT = 3

#: Attribute of the SNES that holds the bar of the load that is being followed.
BAR = "progress"


def time_left(steps: Sequence[LoadStep], distance: float) -> float | None:
    """Estimate the seconds that the rest of a load will take.

    Args:
        steps: The load steps so far, of this run.
        distance: How far the load has still to go, up and down.

    Returns:
        The seconds; None if nothing is known yet.
    """
    recent = steps[-RECENT:]
    covered = math.fsum(abs(step.increment) for step in recent)
    seconds = math.fsum(step.seconds for step in recent)
    return distance * seconds / covered if covered > 0.0 else None


def duration(seconds: float) -> str:
    """Say a time in words: ``45 s``, ``12 min``, ``3 h 20 min``."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / 60.0), 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"


def watch(snes: PETSc.SNES, bar: Progress) -> None:
    """Let a SNES report its Newton steps to a bar: one monitor, however many loads are followed."""
    if not any(monitor is _report for monitor, _, _ in snes.getMonitor() or []):
        snes.setMonitor(_report)
    snes.setAttr(BAR, bar)


def _report(snes: PETSc.SNES, its: int, norm: float) -> None:
    """Report a Newton step to the bar of the SNES, if there is one."""
    bar = snes.getAttr(BAR)
    if bar is not None:
        bar.newton(its, norm)


class Progress:
    """Says on the first process how far the load has come.

    A line for each load step goes to Python's logger ``dolfinx_feti``, as information. If stderr is
    a terminal, a bar shows which load is attempted from where, the time left, and the Newton step
    and residual that the SNES's monitor last reported. As a context manager it leaves the terminal
    as it was.
    """

    def __init__(
        self,
        snes: PETSc.SNES,
        comm: MPI.Comm,
        *,
        loads: Sequence[float],
        unit: str = "",
        number: int = 0,
    ) -> None:
        """Let the monitor of a SNES report to this bar, and no longer to an earlier one.

        Args:
            snes: The solver of the load steps.
            comm: Its communicator.
            loads: Load at the beginning, and those to be met one after the other, up or down.
            unit: Name of the load's unit.
            number: Load steps before this run.
        """
        self._length = math.fsum(abs(b - a) for a, b in itertools.pairwise(loads))
        self._covered, self._load, self._number = 0.0, loads[0], number
        self._goal = f"{loads[-1]:g} {unit}".rstrip()
        self._text, self._left = "", ""
        self._steps: list[LoadStep] = []
        self._snes, self._first = snes, comm.rank == 0
        self._shown = self._first and sys.stderr.isatty()
        self._began = time.perf_counter()
        if self._shown:
            watch(snes, self)

    def attempt(self, load: float, to: float) -> None:
        """Say that a step from one load to another begins.

        Args:
            load: The present load.
            to: The attempted load.
        """
        self._text = f"{load:.4g} → {to:.4g} of {self._goal}"
        self._show("")

    def accept(self, step: LoadStep) -> None:
        """Log a load step.

        Args:
            step: The step that has been accepted.
        """
        self._covered += abs(step.load - self._load)
        self._load, self._number = step.load, self._number + 1
        self._steps.append(step)
        self._began = time.perf_counter()
        self.clear()
        if self._first:
            newton = step.all_steps
            new = sum(s.tangent_lag == 0 for s in newton)
            tangents = f"{new} tangent{'s' * (new != 1)}"
            linear = sum(s.linear_iterations for s in newton)
            failed = f" after {step.failures} failed attempt(s)" * (step.failures > 0)
            remaining = self._time_left()
            logger.info(
                f"load step {self._number}: {step.load:.5g} of {self._goal}{failed}, {len(newton)} "
                f"Newton steps with {tangents}, {linear} linear iterations, "
                f"residual {self._snes.getFunctionNorm():.1e}, {step.seconds:.1f} s"
                f"{f', {remaining}' * bool(remaining)}"
            )

    def refuse(self, load: float, error: Exception) -> None:
        """Log an attempt that failed.

        Args:
            load: The load that was attempted.
            error: What went wrong.
        """
        self.clear()
        if self._first:
            logger.info(f"no equilibrium at {load:.5g}: {reason(error)}")

    def _time_left(self) -> str:
        """Say the time left; nothing as long as it is not known, or at the end."""
        distance = self._length - self._covered
        remaining = time_left(self._steps, distance)
        if remaining is None or distance <= 1e-12 * self._length:
            return ""
        return f"about {duration(max(remaining - (time.perf_counter() - self._began), 0.0))} left"

    def newton(self, its: int, norm: float) -> None:
        """Show a Newton step.

        Args:
            its: Its number.
            norm: ‖r‖ before it.
        """
        self._show(f"  Newton {its}  ‖r‖ = {norm:.1e}")

    def _show(self, more: str) -> None:
        if not self._shown:
            return
        done = self._covered / self._length if self._length > 0.0 else 1.0
        filled = round(WIDTH * min(done, 1.0))
        bar = "█" * filled + "░" * (WIDTH - filled)
        remaining = f"{self._time_left()}  ".lstrip()
        columns = shutil.get_terminal_size().columns - 1
        self._write(f"{bar} {100 * done:3.0f} %  {remaining}{self._text}{more}"[:columns])

    def clear(self) -> None:
        """Clear the line, for other output."""
        if self._shown:
            self._write("")

    def _write(self, line: str) -> None:
        """Replace the line; a terminal that fails is not written to again.

        It is that of the first process alone: nothing may be raised here.
        """
        try:
            sys.stderr.write(f"\r\x1b[K{line}")
            sys.stderr.flush()
        except (OSError, ValueError):  # gone, closed, or without these characters
            self._shown = False

    def __enter__(self) -> Progress:
        """Begin."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Clear the line and fall silent."""
        self.clear()
        self._snes.setAttr(BAR, None)
        self._shown = False
