# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Messages, bytes, neighbours and reductions of each process, counted below PETSc and mpi4py.

PETSc's own log does not see what mpi4py sends, so both are counted where they meet: a small C
library takes the place of MPI's functions by the profiling interface that the standard provides
(``traffic.c``). It is compiled when it is needed, and comes into a run by ``LD_PRELOAD``; a run
without it sends the same messages. What MUMPS sends is called from Fortran and not counted: its
factors of the subdomains are each on one process, and so is that of the coarse problem up to 4000
unknowns.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np
import numpy.typing as npt

__all__ = [
    "COUNTERS",
    "Traffic",
    "compile_library",
    "gather",
    "is_counted",
    "since_reset",
    "start_count",
]

SOURCE = Path(__file__).with_name("traffic.c")


@dataclass(frozen=True, slots=True)
class Traffic:
    """What a process has sent; the comments in ``traffic.c`` say what counts.

    Attributes:
        messages: Point-to-point messages.
        bytes: Their bytes.
        neighbours: Processes that they went to.
        reductions: Collective calls on all processes.
        contributed: Bytes that this process puts into them.
        others: Collective calls on fewer processes.
    """

    messages: float
    bytes: float
    neighbours: float
    reductions: float
    contributed: float
    others: float


#: Names of the counters.
COUNTERS = tuple(field.name for field in fields(Traffic))


def compile_library(folder: Path) -> Path:
    """Compile the library for the MPI of this machine, and return its path.

    Args:
        folder: Where it is put.

    Raises:
        FileNotFoundError: There is no ``mpicc``.
        subprocess.CalledProcessError: It does not compile.
    """
    library = folder / "libtraffic.so"
    if shutil.which("mpicc") is None:
        raise FileNotFoundError("mpicc is missing, which counting messages needs")
    folder.mkdir(parents=True, exist_ok=True)
    words = ["mpicc", "-std=c11", "-O2", "-Wall", "-shared", "-fPIC", "-o", library, SOURCE]
    subprocess.run(list(map(str, words)), check=True)
    return library.resolve()


def is_counted() -> bool:
    """Tell whether this process runs with the library."""
    return _library() is not None


def start_count() -> None:
    """Count from zero on."""
    library = _library()
    if library is not None:
        library.traffic_reset()


def since_reset() -> Traffic:
    """Return what was counted; zeros without the library."""
    values = (ctypes.c_double * len(COUNTERS))()
    library = _library()
    if library is not None:
        library.traffic_read(values)
    return Traffic(*values)


def gather(traffic: Traffic, comm: object) -> npt.NDArray[np.float64]:
    """Return the counts of all processes on all of them, (processes, counters).

    Note:
        Collective.
    """
    return np.array(comm.allgather(astuple(traffic)))


def _library() -> ctypes.CDLL | None:
    """Return the library if it was loaded before the program."""
    named = [word for word in os.environ.get("LD_PRELOAD", "").split(":") if "libtraffic" in word]
    return ctypes.CDLL(named[0]) if named else None
