# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checks that output can be written, made before hours of computing."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from mpi4py import MPI

from dolfinx_feti.runtime.collective import error_message, on_root


def writable_folder(path: Path | str, comm: MPI.Comm) -> Path:
    """Create a folder, with its parents, and check that a file can be written in it. Collective.

    Raises:
        OSError: It cannot be created or written in; on all processes.
    """
    return try_to_write(_write_in_folder, Path(path), "folder", comm)


def try_to_write(attempt: Callable[[Path], object], path: Path, kind: str, comm: MPI.Comm) -> Path:
    """Check on the first process that a file or folder can be written. Collective.

    Args:
        attempt: Writes to the path; raises an OSError if it cannot.
        path: The file or folder.
        kind: The word ``file`` or ``folder`` for the message.
        comm: All processes.

    Returns:
        The path.

    Raises:
        OSError: The attempt failed; on all processes.
    """
    try:
        on_root(lambda: attempt(path), comm)
    except OSError as error:
        raise OSError(
            f"The output {kind} {path} cannot be written ({error_message(error)}): choose another "
            "one."
        ) from error
    return path


def _write_in_folder(path: Path) -> None:
    """Create a folder and write a file in it.

    The file is as large as a block of most file systems, 4 KiB: a full disk may still have room for
    an empty file.
    """
    path.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=path) as file:
        file.write(b"\0" * 4096)
