# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What a benchmark knows about its machine."""

from __future__ import annotations

import numpy as np
from collective import COMM, agree, small
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
