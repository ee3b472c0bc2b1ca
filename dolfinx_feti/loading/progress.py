# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Progress of a load, and the signals that end it.

A bar (tqdm) on a terminal, and a line for each load step in the log. After Ctrl-C or SIGTERM all
processes end the path together, between two Newton steps: the first signal is noted and raised at
the next call of :meth:`Interrupts.check`, in work that fails on all processes if on one; the second
one has its usual effect at once.
"""

from __future__ import annotations

import itertools
import logging
import math
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

from tqdm import tqdm

from dolfinx_feti.loading.steps import LoadStep
from dolfinx_feti.runtime.collective import reason

__all__ = ["Interrupts", "Progress"]

#: Signals that end a path, with the handlers that have to be there: not those of a user.
DEFAULTS: dict[signal.Signals, Callable[[int, FrameType | None], object] | signal.Handlers] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
}
logger = logging.getLogger("dolfinx_feti")

#: Attribute of the SNES that holds the progress of the load that is being followed.
ATTRIBUTE = "progress"

FORMAT = "{percentage:3.0f} % {bar:10} {desc}{postfix}"


class Interrupts:
    """A context in which the first signal is noted."""

    def __init__(self) -> None:
        self._noted: int | None = None
        self._taken: list[signal.Signals] = []

    def check(self) -> None:
        """Raise KeyboardInterrupt after SIGINT, SystemExit after SIGTERM, with that status."""
        noted, self._noted = self._noted, None
        if noted is not None:
            raise KeyboardInterrupt if noted == signal.SIGINT else SystemExit(128 + noted)

    def __enter__(self) -> Interrupts:
        """Note signals, in the main thread."""
        if threading.current_thread() is threading.main_thread():
            self._taken = [s for s, usual in DEFAULTS.items() if signal.getsignal(s) == usual]
            for number in self._taken:
                signal.signal(number, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        """Let signals have their usual effect."""
        for number in self._taken:
            signal.signal(number, DEFAULTS[number])
        self._taken = []

    def _note(self, number: int, frame: FrameType | None) -> None:
        """Note a signal; the next one is not."""
        self._noted = number
        self.__exit__()


class _Bar(tqdm):  # type: ignore[type-arg]
    """Without tqdm's thread, which at exit waits for ever for the lock of a bar that has failed."""

    monitor_interval = 0


class Progress:
    """Says on the first process how far the load has come, and lets signals end it on all.

    A line for each load step goes to Python's logger ``dolfinx_feti``, as information. If stderr is
    a terminal, a bar shows which load is attempted from where, the time left, and the Newton step
    and residual that the SNES's monitor last reported.
    """

    def __init__(
        self,
        snes: PETSc.SNES,
        comm: MPI.Comm,
        interrupts: Interrupts,
        *,
        loads: Sequence[float],
        unit: str,
        number: int,
    ) -> None:
        """Announce that the loads are followed, from the first through others, up or down.

        The solver's monitor reports Newton steps, between which the interrupts are raised;
        ``number`` counts the load steps before this run.
        """
        self._length = math.fsum(abs(b - a) for a, b in itertools.pairwise(loads))
        self._goal, self._number = f"{loads[-1]:g} {unit}".rstrip(), number
        self._seconds, self._left = 0.0, ""
        self._snes, self._speaks, self._interrupts = snes, comm.rank == 0, interrupts
        self._bar = _Bar(disable=True)
        if self._speaks and sys.stderr.isatty():
            self._show(self._open)
        if not any(monitor is _report for monitor, _, _ in snes.getMonitor() or []):
            snes.setMonitor(_report)
        snes.setAttr(ATTRIBUTE, self)

    def attempt(self, load: float, to: float) -> None:
        """Say that a step from one load to another begins."""
        text = f"{self._left}{', ' * bool(self._left)}{load:.4g} → {to:.4g} of {self._goal}"
        self._show(lambda: self._bar.set_description_str(text))

    def newton(self, its: int, norm: float) -> None:
        """Show a Newton step with the residual before it, or let a signal end it."""
        self._interrupts.check()
        self._show(lambda: self._bar.set_postfix_str(f"Newton {its}  ‖r‖ = {norm:.1e}"))

    def accept(self, step: LoadStep) -> None:
        """Log a load step that has been accepted; the bar shows it with the next attempt."""
        self._bar.n += abs(step.increment)
        self._seconds += step.seconds
        self._number += 1
        share = self._bar.n / self._length if self._length > 0.0 else 1.0
        rest = tqdm.format_interval(self._seconds * (1.0 - share) / share)
        self._left = f"about {rest} left" if share < 1.0 - 1e-12 else ""
        newton = step.all_steps
        new = sum(s.tangent_lag == 0 for s in newton)
        linear = sum(s.linear_iterations for s in newton)
        failed = f" after {step.failures} failed attempt(s)" * (step.failures > 0)
        self._log(
            f"load step {self._number}: {step.load:.5g} of {self._goal}{failed}, {len(newton)} "
            f"Newton steps with {new} tangent{'s' * (new != 1)}, {linear} linear iterations, "
            f"residual {self._snes.getFunctionNorm():.1e}, {step.seconds:.1f} s"
            f"{', ' * bool(self._left)}{self._left}"
        )

    def refuse(self, load: float, error: Exception) -> None:
        """Log an attempt that failed."""
        self._log(f"no equilibrium at {load:.5g}: {reason(error)}")

    def close(self) -> None:
        """Clear the line and fall silent."""
        self._show(self._bar.close)
        self._snes.setAttr(ATTRIBUTE, None)

    def _log(self, text: str) -> None:
        """Log a line on the first process, and not into the bar."""
        self._show(self._bar.clear)
        if self._speaks:
            logger.info(text)

    def _open(self) -> None:
        how: Any = {"bar_format": FORMAT, "dynamic_ncols": True, "leave": False, "position": 0}
        self._bar = _Bar(total=self._length, file=sys.stderr, **how)

    def _show(self, draw: Callable[[], object]) -> None:
        """Draw; a terminal that fails is not drawn on again, as it is that of one process alone."""
        try:
            draw()
        except (OSError, ValueError):  # gone, closed, or without these characters
            self._bar.disable = True


def _report(snes: PETSc.SNES, its: int, norm: float) -> None:
    """Report a Newton step to the progress of the SNES, if there is one."""
    progress = snes.getAttr(ATTRIBUTE)
    if progress is not None:
        progress.newton(its, norm)
