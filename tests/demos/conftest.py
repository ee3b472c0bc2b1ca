# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Demos as scripts on the processes of a test."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from demo_runs import DEMOS


@pytest.fixture
def run(monkeypatch) -> Iterator[Callable[..., dict[str, Any]]]:
    """Run a demo as a script on the processes of this test; return its variables."""
    known = set(sys.modules)
    monkeypatch.syspath_prepend(str(DEMOS))

    def script(name: str, *arguments: object) -> dict[str, Any]:
        path = str(DEMOS / name)
        monkeypatch.setattr(sys, "argv", [path, *map(str, arguments)])
        return runpy.run_path(path, run_name="__main__")

    yield script
    for name in set(sys.modules) - known:
        if DEMOS in Path(getattr(sys.modules[name], "__file__", None) or "/").parents:
            del sys.modules[name]
