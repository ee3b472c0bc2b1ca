# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The report of the linear study: from records on disk to pages and pictures."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from collective import COMM, agree
from linear_study import EVERYTHING
from wall_files import on_first

from benchmarks import report
from benchmarks.common import machine

pytestmark = pytest.mark.serial


def test_report_of_a_study(study_of, tmp_path, capsys):
    """From records on disk to Markdown, LaTeX and pictures."""
    study_of("--subdomains-per-edge", "2", "--level", "1,2", "--pc", "dirichlet")
    folder = tmp_path / "report"
    solver = {"solver": "mumps", "level": 3, "subdomains": 512, "processes": 2, "dofs": 9}
    solver |= {"converged_reason": -11, "peak_mib": 99.0, "estimated_mib": 4321.0}
    solver |= {"machine": machine.describe(), "date": "2026-01-02T03:04:05+00:00"}

    def write() -> tuple[str, str, list[str]]:
        (tmp_path / "more.json").write_text(json.dumps([*EVERYTHING, solver]))
        files = [str(tmp_path / name) for name in ("records.json", "more.json")]
        assert report.main([*files, "--output", str(folder), "--remark", "Quiet."]) == 0
        names = sorted(path.name for path in folder.iterdir())
        return (folder / "linear.md").read_text(), (folder / "linear.tex").read_text(), names

    markdown, latex, names = on_first(write)
    agree(names == ["linear.md", "linear.tex", "linear_p1.png"], names)
    agree("source at (2, 2, 2)" in markdown and "2026-01-02" in markdown, markdown)
    agree("the condition numbers differ by at most 0.0 %" in markdown, markdown)
    agree("\n\nQuiet.\n\n" in markdown, markdown)
    agree("| MUMPS | 9 | 2 | needs 4 321 MiB |" in markdown, markdown)
    agree("| 2³ |" in markdown and "![" in markdown, markdown)
    agree(latex.count(r"\toprule") == latex.count(r"\end{table}") == markdown.count("--: |\n"))


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
