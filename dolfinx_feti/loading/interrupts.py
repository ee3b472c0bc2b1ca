# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Ctrl-C and SIGTERM on a path: all processes end it together, between two Newton steps.

The first signal is noted and raised at the next call of :meth:`Interrupts.check`, in work that
fails on all processes if on one; the second one has its usual effect at once.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType

__all__ = ["Interrupts"]

#: Signals that end a path, with the handlers that have to be there: not those of a user.
DEFAULTS: dict[signal.Signals, Callable[[int, FrameType | None], object] | signal.Handlers] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
}


class Interrupts:
    """A context in which the first signal is noted."""

    def __init__(self) -> None:
        self._noted: int | None = None
        self._taken: list[signal.Signals] = []

    def check(self) -> None:
        """Raise KeyboardInterrupt after SIGINT, SystemExit after SIGTERM, with that status."""
        noted, self._noted = self._noted, None
        if noted == signal.SIGINT:
            raise KeyboardInterrupt
        if noted is not None:
            raise SystemExit(128 + noted)

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
