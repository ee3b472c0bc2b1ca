# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checks that folders and files can be written, made before hours of computing."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from mpi4py import MPI

from dolfinx_feti.runtime.collective import on_first, reason


def writable_folder(path: Path | str, comm: MPI.Comm) -> Path:
    """Create a folder, with its parents, and check that a file can be written in it. Collective.

    Raises:
        OSError: It cannot be created, or nothing can be written in it, on all processes.
    """
    return try_to_write(_write_in_folder, Path(path), "folder", comm)


def try_to_write(attempt: Callable[[Path], object], path: Path, what: str, comm: MPI.Comm) -> Path:
    """Let the first process try to write what is a ``file`` or ``folder``. Collective.

    Raises:
        OSError: It failed, on all processes.
    """
    try:
        on_first(lambda: attempt(path), comm)
    except OSError as error:
        raise OSError(
            f"The output {what} {path} cannot be written ({reason(error)}): choose another one."
        ) from error
    return path


def _write_in_folder(path: Path) -> None:
    path.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=path) as file:
        file.write(b"\0" * 4096)
