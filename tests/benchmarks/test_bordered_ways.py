# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The study of scalars: its ways solve one system, and records are kept."""

from __future__ import annotations

import json

import pytest
from collective import agree

from benchmarks.scalars import STUDY

pytestmark = pytest.mark.serial


def test_ways_solve_one_system(tmp_path):
    """Of a body that nothing supports; a second call reads the records."""
    path = tmp_path / "scalars.json"
    words = ["--part", "ways", "--state", "no support", "--json", str(path)]
    first = STUDY.main(words)
    agree(STUDY.main(words) == first == json.loads(path.read_text()))
    agree(max(r["left_of_forces"] for r in first) < 1e-7, first)
    agree(max(r["left_of_scalars"] for r in first) < 1e-10, first)
    text = STUDY.write_page([path], tmp_path)
    agree("| no support, six means |" in text, text)
