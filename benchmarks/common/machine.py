# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The machine that a record was made on."""

from __future__ import annotations

import ctypes
import os
import platform
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from petsc4py import PETSc

import numpy as np

import dolfinx

__all__ = ["describe", "now", "threads"]

PROC = Path("/proc")


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
