# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The commands of the benchmarks: each is there as a module and as a file, and explains itself."""

from __future__ import annotations

import re
import runpy
import sys

import pytest
from wall_files import ROOT

pytest.importorskip("matplotlib")
pytestmark = pytest.mark.serial

COMMANDS = sorted(path.stem for path in (ROOT / "benchmarks").glob("[a-z]*.py"))
PAGES = [ROOT / "Makefile", ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]


@pytest.mark.parametrize("name", COMMANDS)
def test_command_explains_itself(name, monkeypatch, capsys):
    """As ``python3 -m benchmarks.compare --help`` and ``python3 benchmarks/compare.py --help``."""
    file = str(ROOT / "benchmarks" / f"{name}.py")
    monkeypatch.setattr(sys, "argv", [file, "--help"])
    monkeypatch.delitem(sys.modules, f"benchmarks.{name}", raising=False)
    for run, what in ((runpy.run_module, f"benchmarks.{name}"), (runpy.run_path, file)):
        with pytest.raises(SystemExit) as caught:
            run(what, run_name="__main__")
        said = capsys.readouterr().out
        assert caught.value.code == 0
        assert said.startswith(f"usage: {name} ")
        assert "--json" in said or "--output" in said


def test_commands_that_are_documented_exist():
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    named = set(re.findall(r"-m benchmarks\.(\w+)", text)) | set(
        re.findall(r"benchmarks/(\w+)\.py", text)
    )
    assert named <= set(COMMANDS), named
    assert {"compare", "linear", "report", "tube", "load_stepping"} <= named
    files = re.findall(r"(?<!tests/)(?:benchmarks|demos|meshes)/\w+(?:/\w+)*\.py", text)
    assert not [name for name in set(files) if not (ROOT / name).is_file()]
