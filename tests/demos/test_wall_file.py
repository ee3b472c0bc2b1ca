# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Cases in TOML files: what they say, units, and what is refused in one line."""

from __future__ import annotations

import importlib
import math
import re

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from demo_runs import DEMOS, EXAMPLE, read_summary
from wall_files import ROOT, on_first

from dolfinx_feti import loads
from dolfinx_feti.wall import Clamp, Dashpot, Pressure, Slide, Spring, read_wall
from dolfinx_feti.wall.wallfile import NUMBERS, read_raw_wall
from meshes.wall_mesh import WallMesh, write_msh

LAYERS = "[layers.media]\nc = 3.0\n[layers.adventitia]\nc = 0.3\n"
LEAST = f'mesh = "{EXAMPLE}"\n{LAYERS}[surfaces.lumen]\npressure = 1.0\n'
CLAMP = '[surfaces.opening_1]\nhold = "clamp"\n'


@pytest.fixture
def wall_file(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "demos"))
    return importlib.import_module("artery.wall_file")


@pytest.fixture
def read(wall_file, tmp_path):
    """Read a case from a text."""

    def case(text):
        path = tmp_path / "wall.toml"
        on_first(lambda: path.write_text(text, encoding="utf-8"))
        return wall_file.read_case(path, COMM)

    return case


def test_the_example(wall_file):
    tissue = wall_file.Tissue
    case = wall_file.read_case(DEMOS / "wall.toml", COMM)
    agree(case.mesh == "tube" and case.scale == 1.0 and case.stretch == 1.0 and case.axis is None)
    agree(case.layers["media"] == tissue(3.0, 2.3632, 0.8393, 29.0), case.layers)
    agree(case.layers["adventitia"] == tissue(0.3, 0.562, 0.7112, 62.0), case.layers)
    agree(case.has_fibres and case.pressure == 10.0 and case.rate == 100.0)
    expected = {
        "lumen": (Pressure(),),
        "outer": (Spring(0.5), Dashpot(0.05)),
        "opening_1": (Clamp(),),
        "opening_2": (Spring(1.0, "all"), Slide()),
    }
    agree(case.conditions == expected, case.conditions)


def test_the_documents_examples(read):
    """The first is the demos' own, the second a wall of one layer."""
    page = (ROOT / "docs/walls.md").read_text(encoding="utf-8")
    first, second = re.findall(r"^```toml\n(.*?)^```", page, re.M | re.S)
    agree(first in (DEMOS / "wall.toml").read_text(encoding="utf-8"))
    case = read(second)
    agree(case.layers["wall"].c == 40.0 and not case.has_fibres)


def test_units(read):
    case = read(
        LEAST.replace("= 3.0", '= "3 Pa"').replace("= 1.0", '= "2 kPa"')
        + '[surfaces.outer]\nspring = "4 kPa/cm"\ndashpot = "5e6 Pa s/m"\npressure = "1 kPa"\n'
        + '[surfaces.opening_1]\nhold = "slide"\nspring = "7 Pa/m"\n'
        + '[loading]\nrate = "1 kPa/s"\n'
    )
    equal(case.layers["media"].c, 3e-3, 1e-12)
    equal(case.pressure * loads.mmhg(1.0), 2.0, 1e-12)
    equal(case.rate * loads.mmhg(1.0), 1.0, 1e-12)
    share, spring, dashpot = case.conditions["outer"]
    equal([share.share, spring.stiffness, dashpot.viscosity], [0.5, 0.4, 5.0], 1e-12)
    agree(not case.has_fibres and math.isclose(case.conditions["opening_1"][0].stiffness, 7e-6))


def test_prestretch_and_fibres(read):
    ends = '[fibres]\ninner = "in"\nends = ["a", "b"]\n'
    case = read(LEAST + f'{ends}[prestretch]\naxis = "x"\nstretch = 1.2\n')
    agree((case.axis, case.stretch) == ("x", 1.2))
    agree(case.fibres == {"inner": "in", "ends": ["a", "b"]}, case.fibres)


def test_meshes_are_beside_the_file(read, tmp_path):
    agree(read(LEAST.replace(str(EXAMPLE), "own/wall.msh")).mesh == tmp_path / "own/wall.msh")
    agree(read(LEAST).mesh == EXAMPLE)
    agree(read(LEAST.replace(str(EXAMPLE), "vessel")).mesh == "vessel")


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (
            "pressure",
            "pressures",
            r"\[surfaces.lumen\] pressures = 1.0: there is no such key.*'pressure'",
        ),
        (
            "pressure = 1.0",
            'pressure = "1 bar"',
            r"pressure = '1 bar': .* in mmHg, .*mmHg, kPa, Pa",
        ),
        ("pressure = 1.0", "pressure = -1", r"\[surfaces.lumen\] pressure = -1: give a positive"),
        ("pressure = 1.0", "pressure = nan", "pressure = nan: give a positive number in mmHg"),
        ("pressure = 1.0", "pressure = true", "pressure = True: give a positive"),
        ("pressure = 1.0", "spring = 1.0", "surfaces = .*name the surface under pressure"),
        ("pressure = 1.0", 'spring = "1 kPa"', r"\[surfaces.lumen\] spring = '1 kPa': .*kPa/mm"),
        ("pressure = 1.0", 'hold = "glue"', r"hold = 'glue': choose one of 'clamp', 'slide'"),
        ("pressure = 1.0", "", r"\[surfaces.lumen\] holds nothing"),
        ("pressure = 1.0", 'pressure = 1\nhold = "clamp"', "hold = 'clamp': nothing else"),
        ("pressure = 1.0", 'pressure = 1\ndirection = "all"', "direction = 'all': has no effect"),
        ("pressure = 1.0", "pressure = 1\ndashpot = 1", r"\[loading\] rate is missing: dashpots"),
        ("c = 3.0", "c = 0", r"\[layers.media\] c = 0: give a positive number in kPa"),
        ("c = 3.0", "", r"\[layers.media\] c is missing: give a positive"),
        ("c = 3.0", "c = 3.0\nk1 = 1.0", r"\[layers.media\] k2 is missing: fibres need k1, k2"),
        (
            "c = 3.0",
            "c = 3\nk1 = 1\nk2 = 1\nangle = 100",
            "angle = 100: give a number from 0 to 90",
        ),
        (LAYERS, "layers = 3\n", "layers = 3: this is to be a table"),
        (LAYERS, "", "layers name the layers of the wall"),
        ("mesh", "Mesh", "Mesh = .*no such key.*did you mean 'mesh'"),
        (f'"{EXAMPLE}"', "3", "mesh = 3: give a text"),
        ("[layers.media]", "scale = 0\n[layers.media]", "scale = 0: give a positive number"),
        ("[layers.media]", "[layers.media", "is no TOML file: "),
        (
            LAYERS,
            f'{LAYERS}[prestretch]\naxis = "r"\n',
            r"\[prestretch\] axis = 'r': choose one of",
        ),
        (LAYERS, f'{LAYERS}[prestretch]\naxis = "z"\n', r"\[prestretch\] stretch is missing"),
        (LAYERS, f'{LAYERS}[prestretch]\naxis = "z"\nstretch = 1\n', "stretch = 1: this is no pre"),
        (LAYERS, f'{LAYERS}[fibres]\nends = "a"\n', r"\[fibres\] ends = 'a': give a list of texts"),
        (LAYERS, f"{LAYERS}[fibres]\nlumen = 1\n", r"\[fibres\] lumen = 1: there is no such key"),
    ],
)
def test_what_is_refused(read, old, new, match):
    """The message names the file, the table, the key, its value and the remedy."""
    agree(old in LEAST)
    with raises(ValueError, f"wall.toml.*{match}"):
        read(LEAST.replace(old, new, 1))


def test_no_file(wall_file, tmp_path):
    with raises(FileNotFoundError, "no file .*nowhere.toml: give --wall a TOML file"):
        wall_file.read_case(tmp_path / "nowhere.toml", COMM)


@pytest.mark.parametrize(
    ("more", "match"),
    [
        ("", r"\[surfaces\]: nothing holds 6 of the wall's six rigid body motions"),
        (CLAMP.replace("clamp", "slide"), r"nothing holds 3 of"),
        (CLAMP.replace("opening_1", "openin_1"), r"\[surfaces.openin_1\]: the wall has no surface"),
        (
            CLAMP + "[layers.fat]\nc = 1\n",
            r"\[layers.fat\]: the wall has no layer 'fat'; it has med",
        ),
    ],
)
def test_what_does_not_fit_the_wall(read, more, match):
    wall = read_wall(EXAMPLE, COMM)
    with raises(ValueError, match):
        read(LEAST + more).check(wall)


def test_what_fits_the_wall(read):
    wall = read_wall(EXAMPLE, COMM)
    read(LEAST + CLAMP).check(wall)
    with raises(ValueError, r"\[layers.adventitia\] is missing"):
        read(LEAST.replace("[layers.adventitia]\nc = 0.3\n", "") + CLAMP).check(wall)
    case = importlib.import_module("artery.case").default_case(wall, EXAMPLE, c=2.0, pressure=3.0)
    case.check(wall)
    agree(case.layers["media"].c == 2.0 and case.layers["adventitia"].angle == 62.0)
    agree(case.conditions["opening_2"] == (Clamp(),) and case.conditions["lumen"] == (Pressure(),))


# -- they run


def test_case_in_a_file(run, tmp_path):
    """The example: springs and dashpots, which hold the wall back, and an end that slides."""
    few = "--size 1 --degree 1 --steps 2 --subdomains 4".split()
    demo = run("demo_artery.py", "--wall", DEMOS / "wall.toml", *few, "--output", tmp_path)
    summary = read_summary(tmp_path)
    agree(summary["pressure_mmhg"] == 10.0 and summary["max_linear_ratio"] <= 1.0)
    agree(summary["c_kpa"] == {"media": 3.0, "adventitia": 0.3})
    boundary = demo["boundary"]
    small(
        float(boundary.time_step.value) - (summary["load_steps"][-1] - demo["reached"][-2]) / 100,
        1e-12,
    )
    agree(boundary.last.x.array.any() and boundary.energy is not None)


def test_prestretch_of_one_layer(run, tmp_path):
    """By a file: a wall without fibres is pulled, and inflated from a checkpoint on."""
    pytest.importorskip("adios4dolfinx")
    names = {"wall": 1} | {k: v for k, v in NUMBERS.items() if v > 2}

    def write() -> None:
        raw = read_raw_wall(EXAMPLE)
        layers = np.ones_like(raw.layers)
        mesh = WallMesh(raw.points, raw.cells, layers, raw.facets, raw.surfaces)
        write_msh(tmp_path / "own.msh", mesh, names)
        text = 'mesh = "own.msh"\n[layers.wall]\nc = 20\n[surfaces.lumen]\npressure = {}\n'
        text += '[surfaces.opening_1]\nhold = "clamp"\n[surfaces.opening_2]\nhold = "clamp"\n'
        text += '[prestretch]\naxis = "z"\nstretch = 1.1\n'
        for pressure in (1, 2):
            (tmp_path / f"{pressure}.toml").write_text(text.format(pressure))

    on_first(write)
    few = "--degree 1 --steps 1 --subdomains 4 --checkpoint".split()
    words = [*few, tmp_path / "run", "--output", tmp_path, "--wall"]
    run("demo_artery.py", *words, tmp_path / "1.toml")
    demo = run("demo_artery.py", *words, tmp_path / "2.toml", "--restart")
    summary = read_summary(tmp_path)
    agree(summary["load_steps"] == [1.0, 2.0] and summary["c_kpa"] == {"wall": 20.0}, summary)
    x = demo["V"].tabulate_dof_coordinates()
    top = demo["u"].x.array.reshape(-1, 3)[np.isclose(x[:, 2], 1.0)]
    small(float(np.abs(top - [0.0, 0.0, 0.1]).max(initial=0.0)), 1e-9)
    agree(not on_first((tmp_path / "fibres.png").exists))
