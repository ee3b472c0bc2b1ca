# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The page of the linear study, from records on disk."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from collective import COMM, agree
from linear_study import EVERYTHING
from wall_files import on_first

from benchmarks.common import machine
from benchmarks.cube import page as report

pytestmark = pytest.mark.serial


def test_report_of_a_study(study_of, tmp_path, capsys):
    """The paper's values as records, and some more."""
    study_of("--subdomains-per-edge", "2", "--level", "1,2", "--pc", "dirichlet")
    folder = tmp_path / "report"
    solver = {"solver": "mumps", "level": 3, "subdomains": 512, "processes": 2, "dofs": 9}
    solver |= {"converged_reason": -11, "peak_mib": 99.0, "estimated_mib": 4321.0}
    solver |= {"machine": machine.describe(), "date": "2026-01-02T03:04:05+00:00"}

    def write() -> tuple[str, list[str]]:
        (tmp_path / "more.json").write_text(json.dumps([*EVERYTHING, solver]))
        files = [str(tmp_path / name) for name in ("records.json", "more.json")]
        text = report.main([*files, "--output", str(folder)])
        return text, sorted(path.name for path in folder.iterdir())

    markdown, names = on_first(write)
    agree(names == ["linear.md", "tables"], names)
    agree("source at (2, 2, 2)" in markdown and "2026-01-02" in markdown, markdown)
    agree("the condition numbers differ by at most 0.0 %" in markdown, markdown)
    agree("| MUMPS | 9 | 2 | needs 4 321 MiB |" in markdown, markdown)
    agree("| 2³ |" in markdown, markdown)


@pytest.mark.parametrize("text", ["", "{}", "[]", "[1, 2]", '[{"level": 1}]'])
def test_report_of_no_records(text, tmp_path, capsys):
    def write() -> int:
        (tmp_path / "file.json").write_text(text)
        with pytest.raises(SystemExit) as caught:
            report.main([str(tmp_path / "file.json"), "--output", str(tmp_path)])
        return caught.value.code

    agree(on_first(write) == 2)
    said = COMM.bcast(capsys.readouterr().err)
    agree("file.json holds no" in said, said)
    agree(not Path(tmp_path / "linear.md").exists())
