# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What a benchmark says on its way: lines of text, and a bar for the cases of a study."""

from __future__ import annotations

import contextlib
import shutil
import sys
from typing import IO

from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_feti.collective import on_first

__all__ = ["Bar", "say"]

#: Characters of the bar itself.
WIDTH = 24


def say(text: str, comm: MPI.Comm, file: IO[str] | None = None) -> None:
    """Print a line on the first process.

    Args:
        text: The line.
        comm: Communicator of the study.
        file: Stream; stdout if not given.

    Raises:
        OSError: It cannot be printed, say into a file on a full disk. On all processes.

    Note:
        Collective.
    """
    on_first(lambda: print(text, file=file, flush=True), comm)


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
        self._write("")

    def monitor(self, _ksp: PETSc.KSP, its: int, norm: float) -> None:
        """Show an iteration, as a monitor of the solver."""
        self._show(f": iteration {its}, ‖b − A x‖ = {norm:.1e}")

    def _show(self, more: str) -> None:
        filled = WIDTH * self._done // max(self._total, 1)
        bar = "█" * filled + "░" * (WIDTH - filled)
        columns = shutil.get_terminal_size().columns - 1
        self._write(f"{bar} {self._done}/{self._total}  {self._text}{more}"[:columns])

    def _write(self, line: str) -> None:
        """Write in the place of the last line; a terminal that is gone does not end the study."""
        if self.shown:
            with contextlib.suppress(OSError):
                sys.stderr.write(f"\r\x1b[K{line}")
                sys.stderr.flush()
