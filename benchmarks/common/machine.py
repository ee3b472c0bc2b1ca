# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The machine: its name, its memory, and a limit on what a run takes of it."""

from __future__ import annotations

import ctypes
import os
import platform
import resource
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import dolfinx

__all__ = ["available_mib", "describe", "limited_memory", "now", "threads"]

PROC = Path("/proc")
CGROUP = Path("/sys/fs/cgroup")


def available_mib(comm: MPI.Comm) -> float:
    """Return the memory that the processes may still take on all their machines [MiB].

    Infinite where the system does not report it. Collective.
    """
    machine = comm.Split_type(MPI.COMM_TYPE_SHARED)
    share = _available_here() / machine.size
    machine.Free()
    return comm.allreduce(share)


def _available_here() -> float:
    """Return what the kernel can give, or what is left of a container's limit, if less [MiB]."""
    left = [_field(PROC / "meminfo", "MemAvailable")]
    with suppress(OSError, ValueError):  # no limit
        limit, used = ((CGROUP / f"memory.{name}").read_text() for name in ("max", "current"))
        left.append((float(limit) - float(used)) / 2**20)
    return min(left)


@contextmanager
def limited_memory(comm: MPI.Comm, most: float) -> Iterator[float]:
    """Let allocations fail on all processes that go beyond the memory there is, or a limit.

    A solver that fails for it can be recorded; else the kernel would end the program. Yields what
    they may take together beside what they have [MiB], infinite where it is not known. Collective.
    """
    _trim()  # free memory of earlier work would still be to be had
    room = min(most, available_mib(comm))
    own = _field(PROC / "self/status", "VmData")
    before = resource.getrlimit(resource.RLIMIT_DATA)
    if np.isfinite(room) and np.isfinite(own):
        limit = int((own + room / comm.size) * 2**20)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, before[1]))
    try:
        yield room
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


def describe() -> dict[str, str | int]:
    """Name the processor, the memory, the kernels of BLAS and the versions."""
    memory = _field(PROC / "meminfo", "MemTotal")
    return {
        "processor": _processor(),
        "memory_gib": round(memory / 2**10) if np.isfinite(memory) else 0,
        "blas": _blas(),
        "python": platform.python_version(),
        "dolfinx": dolfinx.__version__,
        "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
    }


def threads() -> int:
    """Return the threads that a process may use: OMP_NUM_THREADS, or its cores."""
    return int(os.environ.get("OMP_NUM_THREADS", 0)) or len(os.sched_getaffinity(0))


def now() -> str:
    """Return date and time to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def _processor() -> str:
    lines = _lines(PROC / "cpuinfo")
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{len(names)} × {names[0]}" if names else platform.machine()


def _blas() -> str:
    """Name OpenBLAS's kernels, by the processor that they are made for; empty for another BLAS."""
    maps = {line.split()[-1] for line in _lines(PROC / "self/maps") if "openblas" in line}
    with suppress(AttributeError, OSError, StopIteration):
        name = ctypes.CDLL(next(iter(maps))).openblas_get_corename
        name.restype = ctypes.c_char_p
        return f"OpenBLAS for {name().decode()}"
    return ""


def _field(file: Path, name: str) -> float:
    """Return a size from a file of /proc [MiB]; infinite if it is not there."""
    found = (line.split()[1] for line in _lines(file) if line.startswith(name + ":"))
    return next((float(kib) / 2**10 for kib in found), np.inf)


def _lines(file: Path) -> list[str]:
    return file.read_text().splitlines() if file.is_file() else []


def _trim() -> None:
    with suppress(AttributeError):  # another C library than GNU's
        ctypes.CDLL(None).malloc_trim(0)
