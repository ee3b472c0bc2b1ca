# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Files and command lines of the generators."""

from __future__ import annotations

import re
import sys

import pytest
from collective import agree, raises
from wall_files import ROOT, on_first

from meshes import tube, vessel, wall_mesh

pytestmark = pytest.mark.serial


def test_files_are_whole_or_not_there(tmp_path, monkeypatch):
    path = tmp_path / "t.msh"
    on_first(lambda: path.write_text("mine"))

    def full(*args, **kwargs):
        raise OSError("no space left on device")

    monkeypatch.setattr(wall_mesh.np, "savetxt", full)
    with raises(OSError, "no space"):
        on_first(lambda: tube.create_tube(path, size=0.4))
    agree(path.read_text() == "mine" and [p.name for p in tmp_path.iterdir()] == ["t.msh"])


def test_example_is_what_the_generator_makes(tmp_path):
    """README.md names the command for meshes/example.msh."""
    readme = (ROOT / "meshes/README.md").read_text(encoding="utf-8")
    command = re.search(r"python3 -m meshes\.tube meshes/example\.msh (.*)`", readme)
    words = command[1].split()
    options = {k.removeprefix("--"): float(v) for k, v in zip(words[::2], words[1::2], strict=True)}
    on_first(lambda: tube.create_tube(tmp_path / "t.msh", **options))
    example = ROOT / "meshes/example.msh"
    agree((tmp_path / "t.msh").read_bytes() == example.read_bytes())
    agree(example.stat().st_size < 100_000)


def test_command_line_of_the_tube(tmp_path, monkeypatch):
    """That of the vessel is in ``test_vessel_mesh``."""
    words = ["--size", "0.4", "--quarter", "--through", "1", "1"]
    monkeypatch.setattr(sys, "argv", ["prog", str(tmp_path / "new" / "w.msh"), *words])
    on_first(tube.main)
    agree((tmp_path / "new" / "w.msh").read_text().startswith("$MeshFormat\n2.2 "))


@pytest.mark.parametrize(
    ("module", "words", "said"),
    [
        (tube, ["--size", "-1"], "argument --size: '-1' is not a positive number"),
        (tube, ["--around", "0"], "argument --around: '0' is not a number 1, 2, 3"),
        (vessel, ["--thickness", "nan"], "argument --thickness: 'nan' is not a positive number"),
        (vessel, ["--through", "1", "x"], "argument --through: 'x' is not a number 1, 2, 3"),
    ],
)
def test_wrong_words(tmp_path, monkeypatch, capsys, module, words, said):
    monkeypatch.setattr(sys, "argv", ["prog", str(tmp_path / "w.msh"), *words])
    with pytest.raises(SystemExit) as caught:
        module.main()
    assert caught.value.code == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
