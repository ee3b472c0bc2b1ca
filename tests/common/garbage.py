# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""PETSc objects that waited for Python's collector on several processes, and wait in PETSc now."""

from __future__ import annotations

import ctypes
import os
import re
import sys
import tempfile

from mpi4py import MPI
from petsc4py import PETSc


def garbage(comm: MPI.Comm) -> str:
    """Return PETSc's own list of its garbage on a communicator; empty without any. Collective."""
    sys.stdout.flush()
    with tempfile.TemporaryFile() as file:
        screen = os.dup(1)
        os.dup2(file.fileno(), 1)
        try:
            PETSc.garbage_view(comm)
            PETSc.Sys.syncFlush(comm)
            ctypes.CDLL(None).fflush(None)
        finally:
            os.dup2(screen, 1)
            os.close(screen)
        file.seek(0)
        text = file.read().decode()
    text = comm.bcast(text)
    entries = sum(map(int, re.findall(r"Total entries: (\d+)", text)))
    return text if entries else ""
