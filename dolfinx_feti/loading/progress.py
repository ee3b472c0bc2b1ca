# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Progress of a path, and the signals that end it.

A bar (tqdm) on a terminal, and a line for each load step in the log. After Ctrl-C or SIGTERM all
processes end the path together, between two Newton steps: the first signal is noted, and raised at
the next check. Checks are called inside of ``on_all`` or PETSc's monitors, which raise on all
processes what one raises. A second signal has its usual effect.
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
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any, Literal

from mpi4py import MPI
from petsc4py import PETSc

from tqdm import tqdm

from dolfinx_feti.loading.load_step import LoadStep
from dolfinx_feti.runtime.collective import error_message

__all__ = ["Progress", "noted_signals"]

#: Signals that end a path, with their usual handlers. A signal with a handler of the user's is left
#: to that handler.
DEFAULTS: dict[signal.Signals, Callable[[int, FrameType | None], object] | signal.Handlers] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
}
logger = logging.getLogger("dolfinx_feti")

#: Attribute of the SNES that holds the progress of the present path, for a monitor of the SNES.
#: PETSc can only remove all monitors at once. So the monitor stays, and serves later paths too.
ATTRIBUTE = "progress"

#: Share of a path above which only rounding is left, and no remaining time is shown: the share is a
#: sum of up to 10⁴ increments, which errs by 5e-13.
COMPLETE = 1.0 - 1e-12

#: Format of the bar, for tqdm.
FORMAT = "{percentage:3.0f} % {bar:10} {desc}{postfix}"


class Bar(tqdm):  # type: ignore[type-arg]
    """A bar without tqdm's monitor thread.

    After an error in a bar, its lock stays closed, and the thread would wait for it at exit.
    """

    monitor_interval = 0


@contextmanager
def noted_signals() -> Iterator[Callable[[], None]]:
    """Return a context, whose value is a check that raises after the first signal inside of it.

    It raises KeyboardInterrupt after SIGINT, and SystemExit after SIGTERM, with the status
    128 + number of the signal. Outside the main thread, where Python allows no handlers, no signal
    is noted.
    """
    noted: list[int] = []
    replaced: list[signal.Signals] = []  # signals whose handler is ours

    def restore_handlers() -> None:
        for number in replaced:
            signal.signal(number, DEFAULTS[number])
        replaced.clear()

    def note(number: int, frame: FrameType | None) -> None:
        noted.append(number)
        restore_handlers()

    def check() -> None:
        if not noted:
            return
        number = noted.pop()
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        raise SystemExit(128 + number)

    if threading.current_thread() is threading.main_thread():
        for number, usual in DEFAULTS.items():
            if signal.getsignal(number) == usual:
                replaced.append(number)
                signal.signal(number, note)
    try:
        yield check
    finally:
        restore_handlers()


class Progress:
    """The progress of a path, shown on the first process; checks signals on all.

    A line for each load step goes to Python's logger ``dolfinx_feti``, level ``INFO``. If stderr is
    a terminal, a bar shows the present attempt, the remaining time, and the Newton step and
    residual that the SNES's monitor last reported.
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
        quantity: Literal["load", "time"] = "load",
    ) -> None:
        """Open the bar.

        Args:
            snes: The Newton solver, whose monitor reports Newton steps.
            comm: Communicator of the problem.
            check: Raises after a signal; called at each Newton step.
            loads: The present load or time, then those to be met, up or down.
            unit: Name of their unit.
            number: Number of steps before this run.
            quantity: What a step increases, for the log.
        """
        self._length = math.fsum(abs(b - a) for a, b in itertools.pairwise(loads))
        self._goal = f"{loads[-1]:g} {unit}".rstrip()
        self._number = number
        self._quantity = quantity
        self._seconds = 0.0
        self._remaining = ""  # the remaining time in words; empty if it is not known
        self._snes = snes
        self._is_root = comm.rank == 0
        self._check = check
        self._bar = Bar(disable=True)
        if self._is_root and sys.stderr.isatty():
            self._show(self._open)
        has_monitor = any(monitor is _report for monitor, _, _ in snes.getMonitor() or [])
        if not has_monitor:
            snes.setMonitor(_report)
        snes.setAttr(ATTRIBUTE, self)

    def show_attempt(self, load: float, to: float) -> None:
        """Show that a step from one load to another begins."""
        text = _joined(self._remaining, f"{load:.4g} → {to:.4g} of {self._goal}")
        self._show(partial(self._bar.set_description_str, text))

    def show_newton_step(self, its: int, norm: float) -> None:
        """Show a Newton step with the residual before it; raise if there was a signal."""
        self._check()
        self._show(partial(self._bar.set_postfix_str, f"Newton {its}  ‖r‖ = {norm:.1e}"))

    def log_step(self, step: LoadStep) -> None:
        """Log a load step that has been accepted; the bar shows it with the next attempt."""
        self._bar.n += abs(step.increment)
        self._seconds += step.seconds
        self._number += 1
        self._remaining = self._remaining_time()
        newton_steps = step.all_steps
        new_tangents = sum(newton_step.tangent_lag == 0 for newton_step in newton_steps)
        linear_iterations = sum(newton_step.linear_iterations for newton_step in newton_steps)
        tangents = "tangent" if new_tangents == 1 else "tangents"
        failed = ""
        if step.failures > 0:
            failed = f" after {step.failures} failed attempt(s)"
        line = _joined(
            f"{self._quantity} step {self._number}: {step.load:.5g} of {self._goal}{failed}",
            f"{len(newton_steps)} Newton steps with {new_tangents} {tangents}",
            f"{linear_iterations} linear iterations",
            f"residual {self._snes.getFunctionNorm():.1e}",
            f"{step.seconds:.1f} s",
            self._remaining,
        )
        self._log(line)

    def _remaining_time(self) -> str:
        """Return in words the time that the rest takes at the speed so far; empty at the end."""
        if self._length == 0.0:
            return ""
        share = self._bar.n / self._length
        if not 0.0 < share < COMPLETE:
            return ""
        rest = tqdm.format_interval(self._seconds * (1.0 - share) / share)
        return f"about {rest} left"

    def log_restart(self, load: float, folder: Path) -> None:
        """Log where a path continues, and whether anything is left of it.

        Args:
            load: Its last load or time.
            folder: The folder of its checkpoint.
        """
        rest = "" if self._length > 0.0 else ": nothing is left to do"
        steps = f"{self._quantity} step {self._number}"
        self._log(f"restart from {folder}: after {steps}, at {load:.5g} of {self._goal}{rest}")

    def log_failure(self, load: float, error: Exception) -> None:
        """Log an attempt that failed."""
        missing = "equilibrium" if self._quantity == "load" else "state"
        self._log(f"no {missing} at {load:.5g}: {error_message(error)}")

    def close(self) -> None:
        """Close the bar; later solves of the SNES show nothing."""
        self._show(self._bar.close)
        self._snes.setAttr(ATTRIBUTE, None)

    def _log(self, text: str) -> None:
        """Log a line on the first process, on a line without the bar."""
        self._show(self._bar.clear)
        if self._is_root:
            logger.info(text)

    def _open(self) -> None:
        how: Any = {"bar_format": FORMAT, "dynamic_ncols": True, "leave": False, "position": 0}
        self._bar = Bar(total=self._length, file=sys.stderr, **how)

    def _show(self, draw: Callable[[], object]) -> None:
        """Draw the bar; draw no more after an error of the terminal, which only one process has."""
        try:
            draw()
        except (OSError, ValueError):  # gone, closed, or without these characters
            self._bar.disable = True


def _report(snes: PETSc.SNES, its: int, norm: float) -> None:
    """Report a Newton step to the progress of the SNES, if there is one."""
    progress = snes.getAttr(ATTRIBUTE)
    if progress is not None:
        progress.show_newton_step(its, norm)


def _joined(*parts: str) -> str:
    """Return the parts that are not empty, joined by commas."""
    return ", ".join(part for part in parts if part)
