# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What a benchmark knows about its machine."""

from __future__ import annotations

import os

import numpy as np
from collective import COMM, agree, raises, small
from wall_files import on_first

from benchmarks.common import machine


def test_available_memory_is_what_the_kernel_and_the_container_leave(tmp_path, monkeypatch):
    def write() -> None:
        (tmp_path / "meminfo").write_text("MemTotal: 4096000 kB\nMemAvailable: 2048000 kB\n")

    on_first(write)
    monkeypatch.setattr(machine, "PROC", tmp_path)
    monkeypatch.setattr(machine, "CGROUP", tmp_path)
    small(machine.available_mib(COMM) - 2000.0, 1e-9)
    on_first(lambda: (tmp_path / "memory.max").write_text(f"{900 * 2**20}\n"))
    on_first(lambda: (tmp_path / "memory.current").write_text(f"{200 * 2**20}\n"))
    small(machine.available_mib(COMM) - 700.0, 1e-9)
    on_first(lambda: (tmp_path / "memory.max").write_text("max\n"))
    small(machine.available_mib(COMM) - 2000.0, 1e-9)
    on_first(lambda: (tmp_path / "meminfo").unlink())
    agree(np.isinf(machine.available_mib(COMM)))


def test_memory_that_is_limited_cannot_be_taken():
    """Some is there, more than that is not, and afterwards all is as before."""
    n = 2**23  # 64 MiB
    with machine.limited_memory(COMM, 100.0 * COMM.size) as room:
        agree(room <= 100.0 * COMM.size)
        agree(np.ones(n)[-1] == 1.0)
        with raises(MemoryError, "Unable to allocate"):
            np.ones(16 * n)  # no gap that earlier tests have left holds so much
    agree(np.ones(4 * n)[-1] == 1.0)


def test_threads_are_those_of_openmp_or_the_cores(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    agree(machine.threads() == 3)
    monkeypatch.delenv("OMP_NUM_THREADS")
    agree(1 <= machine.threads() <= (os.cpu_count() or 1))
