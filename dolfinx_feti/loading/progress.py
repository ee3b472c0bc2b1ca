# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Progress of a load, and the signals that end it.

A bar (tqdm) on a terminal, and a line for each load step in the log. After Ctrl-C or SIGTERM all
processes end the path together, between two Newton steps: the first signal is noted and raised at
the next check, in work that fails on all processes if on one; the second one has its usual effect.
"""

from __future__ import annotations

import itertools
import logging
import math
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

from tqdm import tqdm

from dolfinx_feti.loading.steps import LoadStep
from dolfinx_feti.runtime.collective import reason

__all__ = ["Progress", "noted_signals"]

#: Signals that end a path, with the handlers that have to be there: not those of a user.
DEFAULTS: dict[signal.Signals, Callable[[int, FrameType | None], object] | signal.Handlers] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
}
logger = logging.getLogger("dolfinx_feti")

#: Attribute of the SNES that holds the progress of the load that is being followed.
ATTRIBUTE = "progress"

#: Without tqdm's thread, which at exit waits for ever for the lock of a bar that has failed.
Bar = type("Bar", (tqdm,), {"monitor_interval": 0})
FORMAT = "{percentage:3.0f} % {bar:10} {desc}{postfix}"


@contextmanager
def noted_signals() -> Iterator[Callable[[], None]]:
    """Note the first signal, in the main thread; yield the check that raises it.

    The check raises KeyboardInterrupt after SIGINT, SystemExit after SIGTERM, with that status.
    """
    noted: list[int] = []
    main = threading.current_thread() is threading.main_thread()
    taken = [s for s, usual in DEFAULTS.items() if main and signal.getsignal(s) == usual]

    def let_go() -> None:
        for number in taken:
            signal.signal(number, DEFAULTS[number])
        taken.clear()

    def note(number: int, frame: FrameType | None) -> None:
        noted.append(number)
        let_go()

    def check() -> None:
        if noted:
            number = noted.pop()
            raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(128 + number)

    for number in taken:
        signal.signal(number, note)
    try:
        yield check
    finally:
        let_go()


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
        check: Callable[[], None],
        *,
        loads: Sequence[float],
        unit: str,
        number: int,
    ) -> None:
        """Announce that the loads are followed, from the first through others, up or down.

        The solver's monitor reports Newton steps, between which signals are checked; ``number``
        counts the load steps before this run.
        """
        self._length = math.fsum(abs(b - a) for a, b in itertools.pairwise(loads))
        self._goal, self._number = f"{loads[-1]:g} {unit}".rstrip(), number
        self._seconds, self._left = 0.0, list[str]()  # the time left, once it is known
        self._snes, self._first, self._check = snes, comm.rank == 0, check
        self._bar = Bar(disable=True)
        if self._first and sys.stderr.isatty():
            self._show(self._open)
        if not any(monitor is _report for monitor, _, _ in snes.getMonitor() or []):
            snes.setMonitor(_report)
        snes.setAttr(ATTRIBUTE, self)

    def attempt(self, load: float, to: float) -> None:
        """Say that a step from one load to another begins."""
        text = [*self._left, f"{load:.4g} → {to:.4g} of {self._goal}"]
        self._show(lambda: self._bar.set_description_str(", ".join(text)))

    def newton(self, its: int, norm: float) -> None:
        """Show a Newton step with the residual before it, or let a signal end it."""
        self._check()
        self._show(lambda: self._bar.set_postfix_str(f"Newton {its}  ‖r‖ = {norm:.1e}"))

    def accept(self, step: LoadStep) -> None:
        """Log a load step that has been accepted; the bar shows it with the next attempt."""
        self._bar.n += abs(step.increment)
        self._seconds += step.seconds
        self._number += 1
        share = self._bar.n / self._length if self._length > 0.0 else 1.0
        rest = tqdm.format_interval(self._seconds * (1.0 - share) / share)
        self._left = [f"about {rest} left"] if share < 1.0 - 1e-12 else []
        newton = step.all_steps
        new = sum(each.tangent_lag == 0 for each in newton)
        linear = sum(each.linear_iterations for each in newton)
        failed = f" after {step.failures} failed attempt(s)" * (step.failures > 0)
        said = [
            f"load step {self._number}: {step.load:.5g} of {self._goal}{failed}",
            f"{len(newton)} Newton steps with {new} tangent{'s' * (new != 1)}",
            f"{linear} linear iterations",
            f"residual {self._snes.getFunctionNorm():.1e}",
            f"{step.seconds:.1f} s",
        ]
        self._log(", ".join([*said, *self._left]))

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
        if self._first:
            logger.info(text)

    def _open(self) -> None:
        how: Any = {"bar_format": FORMAT, "dynamic_ncols": True, "leave": False, "position": 0}
        self._bar = Bar(total=self._length, file=sys.stderr, **how)

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
