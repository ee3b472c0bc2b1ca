# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A bar on the terminal that shows how many cases of a study are done."""

from __future__ import annotations

import shutil
import sys

from mpi4py import MPI
from petsc4py import PETSc

__all__ = ["Bar"]

#: Characters of the bar itself.
WIDTH = 24


class Bar:
    """Shows on the first process, if its stderr is a terminal, where a study stands."""

    def __init__(self, total: int, comm: MPI.Comm) -> None:
        """Begin.

        Args:
            total: Number of cases.
            comm: Communicator of the study.
        """
        self._total, self._done, self._text = total, 0, ""
        self.shown = comm.rank == 0 and sys.stderr.isatty()

    def begin(self, text: str) -> None:
        """Name the case that begins."""
        self._text = text
        self._show("")

    def end(self) -> None:
        """Count a case as done, and clear the line for other output."""
        self._done += 1
        self.clear()

    def monitor(self, _ksp: PETSc.KSP, its: int, norm: float) -> None:
        """Show an iteration, as a monitor of the solver."""
        self._show(f": iteration {its}, ‖b − A x‖ = {norm:.1e}")

    def clear(self) -> None:
        """Clear the line."""
        if self.shown:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()

    def _show(self, more: str) -> None:
        if not self.shown:
            return
        filled = WIDTH * self._done // max(self._total, 1)
        bar = "█" * filled + "░" * (WIDTH - filled)
        columns = shutil.get_terminal_size().columns - 1
        line = f"{bar} {self._done}/{self._total}  {self._text}{more}"[:columns]
        sys.stderr.write(f"\r\x1b[K{line}")
        sys.stderr.flush()
