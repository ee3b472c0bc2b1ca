# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What several tests of the benchmarks ask for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from linear_study import run_cube


@pytest.fixture
def study_of(tmp_path: Path) -> Callable[..., tuple[int, list[dict]]]:
    """Run the study of the cube, time and again with one file; see :func:`run_cube`."""
    return lambda *arguments: run_cube(tmp_path / "records.json", *arguments)
