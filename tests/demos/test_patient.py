# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""`demo_patient.py` on a wall as small as can be."""

from __future__ import annotations

import numpy as np
import pytest
from collective import agree, small
from demo_runs import DEMOS, EXAMPLE, read_summary
from wall_files import on_first

pytest.importorskip("gmsh")
pytest.importorskip("matplotlib")

FEW = ["--subdomains", "4"]


def write_case(folder, image: float):
    """The example's case on another mesh, a tube with two openings."""
    text = (DEMOS / "patient.toml").read_text(encoding="utf-8")
    text = text.replace('"vessel"', f'"{EXAMPLE}"').replace("= 80.0 ", f"= {image} ")
    text = text.replace('[surfaces.opening_3]\nhold = "clamp"\n', "")
    path = folder / "case.toml"
    on_first(lambda: path.write_text(text, encoding="utf-8"))
    return path


@pytest.mark.processes(2)
def test_back_to_the_image(run, tmp_path):
    """The image again, for less than three inflations; two pictures."""
    from matplotlib.image import imread

    run("demo_patient.py", "--case", write_case(tmp_path, 80.0), *FEW, "--output", tmp_path)
    summary = read_summary(tmp_path)
    small(summary["loaded_wall_off_the_image_mm"], 1e-6)
    agree(summary["unloaded_wall_receded_by_mm"] > 1e-3, summary)
    agree(0 < summary["iterations_unloading"] <= 3 * summary["iterations_back"], summary)
    for name in ("unloaded", "stress"):
        agree(on_first(lambda n=name: float(np.ptp(imread(tmp_path / f"{n}.png")))) > 0.5, name)


def test_image_beyond_the_pressure(run, tmp_path, capsys):
    with pytest.raises(SystemExit) as end:
        run("demo_patient.py", "--case", write_case(tmp_path, 130.0), "--output", tmp_path)
    said = capsys.readouterr().err
    agree(end.value.code == 2 and said.count("\n") <= 1, said)
