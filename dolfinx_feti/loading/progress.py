# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A bar that shows the progress of a load on a terminal, and nothing elsewhere."""

from __future__ import annotations

import itertools
import math
import shutil
import sys
from collections.abc import Sequence
from types import TracebackType

from mpi4py import MPI
from petsc4py import PETSc

__all__ = ["Progress"]

#: Characters of the bar itself.
WIDTH = 24


class Progress:
    """Shows on the first process, if its stderr is a terminal, how far the load has come.

    The line says which load is attempted from where, and the Newton step and residual that the
    SNES's monitor last reported. As a context manager it leaves the terminal as it was.
    """

    def __init__(
        self, snes: PETSc.SNES, comm: MPI.Comm, *, loads: Sequence[float], unit: str = ""
    ) -> None:
        """Hook into the monitor of a SNES.

        Args:
            snes: The solver of the load steps.
            comm: Its communicator.
            loads: Load at the beginning, and those to be met one after the other, up or down.
            unit: Name of the load's unit.
        """
        self._length = math.fsum(abs(b - a) for a, b in itertools.pairwise(loads))
        self._covered, self._load = 0.0, loads[0]
        self._goal = f"{loads[-1]:g} {unit}".rstrip()
        self._text = ""
        self._shown = comm.rank == 0 and sys.stderr.isatty()
        if self._shown:
            snes.setMonitor(self._newton)

    def attempt(self, load: float, to: float) -> None:
        """Say that a step from one load to another begins.

        Args:
            load: The present load.
            to: The attempted load.
        """
        self._covered += abs(load - self._load)
        self._load = load
        self._text = f"{load:.4g} → {to:.4g} of {self._goal}"
        self._show("")

    def _newton(self, _snes: PETSc.SNES, its: int, norm: float) -> None:
        self._show(f"  Newton {its}  ‖r‖ = {norm:.1e}")

    def _show(self, more: str) -> None:
        if not self._shown:
            return
        done = self._covered / self._length if self._length > 0.0 else 1.0
        filled = round(WIDTH * min(done, 1.0))
        bar = "█" * filled + "░" * (WIDTH - filled)
        columns = shutil.get_terminal_size().columns - 1
        self._write(f"{bar} {100 * done:3.0f} %  {self._text}{more}"[:columns])

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
        self._shown = False
