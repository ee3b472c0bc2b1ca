# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""`demo_artery.py` and `demo_patient.py` with walls in TOML files."""

from __future__ import annotations

import numpy as np
import pytest
from collective import agree, small
from demo_runs import DEMOS, EXAMPLE, check_pictures, read_summary
from wall_files import on_first

from dolfinx_feti.wall.wallfile import read_raw_wall
from meshes.wall_mesh import TAGS, WallMesh, write_mesh

pytest.importorskip("gmsh")
pytest.importorskip("matplotlib")

PARTS = ["--subdomains", "4"]


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
    run("demo_patient.py", "--case", write_case(tmp_path, 80.0), *PARTS, "--output", tmp_path)
    summary = read_summary(tmp_path)
    small(summary["loaded_wall_off_the_image_mm"], 1e-6)
    agree(summary["unloaded_wall_receded_by_mm"] > 1e-3, summary)
    agree(0 < summary["iterations_unloading"] <= 3 * summary["iterations_back"], summary)
    check_pictures(tmp_path, "unloaded.png", "stress.png", height=300, width=500)


def test_image_beyond_the_pressure(run, tmp_path, capsys):
    with pytest.raises(SystemExit) as end:
        run("demo_patient.py", "--case", write_case(tmp_path, 130.0), "--output", tmp_path)
    said = capsys.readouterr().err
    agree(end.value.code == 2 and said.count("\n") <= 1, said)


def test_case_in_a_file(run, tmp_path):
    """The example: springs and dashpots, which hold the wall back, and an end that slides."""
    few = "--size 1 --degree 1 --steps 2 --subdomains 4".split()
    demo = run("demo_artery.py", "--wall", DEMOS / "wall.toml", *few, "--output", tmp_path)
    summary = read_summary(tmp_path)
    agree({name: tissue.c for name, tissue in demo["tissues"]} == {"media": 3.0, "adventitia": 0.3})
    boundary = demo["boundary"]
    before, last = summary["load_steps"][-2:]
    small(float(boundary.time_step.value) - (last - before) / 100, 1e-12)
    agree(boundary.last.x.array.any() and boundary.energy is not None)


def test_prestretch_of_one_layer(run, tmp_path):
    """A wall without fibres, which all read, is pulled, and inflated beyond the file's pressure."""
    names = {"wall": 1} | {k: v for k, v in TAGS.items() if v > 2}

    def write() -> None:
        raw = read_raw_wall(EXAMPLE)
        layers = np.ones_like(raw.layers)
        mesh = WallMesh(raw.points, raw.cells, layers, raw.facets, raw.surfaces)
        write_mesh(tmp_path / "own.xdmf", mesh, names)
        text = 'mesh = "own.xdmf"\n[layers.wall]\nc = 20\n[surfaces.lumen]\npressure = 1\n'
        text += '[surfaces.opening_1]\nhold = "clamp"\n[surfaces.opening_2]\nhold = "clamp"\n'
        text += '[prestretch]\naxis = "z"\nstretch = 1.1\n'
        (tmp_path / "own.toml").write_text(text)

    on_first(write)
    few = "--degree 1 --steps 2 --subdomains 4 --pressure 2".split()
    demo = run("demo_artery.py", *few, "--output", tmp_path, "--wall", tmp_path / "own.toml")
    summary = read_summary(tmp_path)
    agree(summary["load_steps"] == [1.0, 2.0] and demo["case"].layers["wall"].c == 20.0, summary)
    x = demo["V"].tabulate_dof_coordinates()
    top = demo["u"].x.array.reshape(-1, 3)[np.isclose(x[:, 2], 1.0)]
    small(float(np.abs(top - [0.0, 0.0, 0.1]).max(initial=0.0)), 1e-9)
    agree(not on_first((tmp_path / "fibres.png").exists))
