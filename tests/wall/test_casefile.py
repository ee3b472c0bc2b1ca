# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Cases in TOML files: their contents, units, and errors of one line."""

from __future__ import annotations

import math
import re

import pytest
from collective import COMM, agree, equal, raises
from wall_files import DEMOS, EXAMPLE, ROOT, on_first

import dolfinx

from dolfinx_feti import loads
from dolfinx_feti.scalars import Windkessel, create_cavities
from dolfinx_feti.wall import (
    Clamp,
    Dashpot,
    Filling,
    LayerMaterial,
    Pressure,
    Slide,
    Spring,
    read_case,
    read_wall,
)

LAYERS = "[layers.media]\nc = 3.0\n[layers.adventitia]\nc = 0.3\n"
LUMEN = "[surfaces.lumen]\npressure = 1.0\n"
LEAST = f'mesh = "{EXAMPLE}"\n{LAYERS}{LUMEN}'
CLAMP = '[surfaces.opening_1]\nhold = "clamp"\n'


@pytest.fixture
def read(tmp_path):
    """Return a function that reads a case from a text."""

    def case(text):
        path = tmp_path / "wall.toml"
        on_first(lambda: path.write_text(text, encoding="utf-8"))
        return read_case(path, COMM)

    return case


def test_the_example():
    """The example case has the values of its file."""
    case = read_case(DEMOS / "wall.toml", COMM)
    agree(case.mesh == "tube" and case.scale == 1.0)
    agree(case.prestretch == 1.0 and case.prestretch_axis is None)
    agree(case.layers["media"] == LayerMaterial(3.0, 2.3632, 0.8393, 29.0), case.layers)
    agree(case.layers["adventitia"] == LayerMaterial(0.3, 0.562, 0.7112, 62.0), case.layers)
    agree(case.pressure == 10.0 and case.rate == 100.0)
    expected = {
        "lumen": (Pressure(),),
        "outer": (Spring(0.5), Dashpot(0.05)),
        "opening_1": (Clamp(),),
        "opening_2": (Spring(1.0, "all"), Slide()),
    }
    agree(case.conditions == expected, case.conditions)


def test_the_documents_examples(read):
    """The examples of docs/cases.md are valid, and the first is part of the demo's file."""
    page = (ROOT / "docs/cases.md").read_text(encoding="utf-8")
    first, second, _ = re.findall(r"^```toml\n(.*?)^```", page, re.M | re.S)
    agree(first in (DEMOS / "wall.toml").read_text(encoding="utf-8"))
    case = read(second)
    agree(case.layers["wall"] == LayerMaterial(40.0))


def test_units(read):
    """Values may have units or none."""
    case = read(
        LEAST.replace("= 3.0", '= "3 Pa"').replace("= 1.0", '= "2 kPa"')
        + '[surfaces.outer]\nspring = "4 kPa/cm"\ndashpot = "5e6 Pa s/m"\npressure = "1 kPa"\n'
        + '[surfaces.opening_1]\nhold = "slide"\nspring = "7 Pa/m"\n'
        + '[loading]\nrate = "1 kPa/s"\n[fibres]\ninner = "in"\nends = ["a", "b"]\n'
        + '[prestretch]\naxis = "x"\nstretch = 1.2\n'
    )
    equal(case.layers["media"].c, 3e-3, 1e-12)
    equal(case.pressure * loads.mmhg(1.0), 2.0, 1e-12)
    equal(case.rate * loads.mmhg(1.0), 1.0, 1e-12)
    share, spring, dashpot = case.conditions["outer"]
    equal([share.share, spring.stiffness, dashpot.viscosity], [0.5, 0.4, 5.0], 1e-12)
    agree(math.isclose(case.conditions["opening_1"][0].stiffness, 7e-6))
    agree(case.layers["media"] == LayerMaterial(case.layers["media"].c))
    agree((case.prestretch_axis, case.prestretch) == ("x", 1.2))
    agree(case.fibres == {"inner": "in", "ends": ["a", "b"]}, case.fibres)


CAVITY = LEAST.replace(LUMEN, "[cavity.lumen]\n")
VESSELS = '[cavity.lumen.windkessel]\nresistance = "2 mmHg s/ml"\ncompliance = "1 ml/mmHg"\n'


def test_cavities(read):
    """A cavity has a volume or a Windkessel, in any unit; an open one needs its axis."""
    wall = read_wall(EXAMPLE, COMM)
    u = dolfinx.fem.Function(dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 1, (3,))))
    case = read(f'{CAVITY}volume = "2 ml"\n{CLAMP}')
    case.check(wall)
    (cavity,) = create_cavities(wall, u, case.cavities)
    equal([case.pressure, float(cavity.volume.value)], [0.0, 2000.0], 1e-12)
    case = read(CAVITY + VESSELS)
    given = case.cavities["lumen"].windkessel
    mmhg = loads.mmhg(1.0)
    equal([given["resistance"], given["compliance"]], [2e-3 * mmhg, 1e3 / mmhg], 1e-12)
    (windkessel,) = create_cavities(wall, u, case.cavities)
    agree(isinstance(windkessel, Windkessel) and windkessel.cavity.present_volume() > 0.0)
    # of a tube with open ends, by its axis
    agree(read(f'{CAVITY}volume = 1\naxis = "x"\n').cavities["lumen"] == Filling(1.0, axis="x"))


#: What a cavity is refused with.
CAVITIES = [
    ("", r"\[cavity.lumen\]: give a volume or a windkessel"),
    ("volume = 1\n" + VESSELS, r"\[cavity.lumen\]: give a volume or a windkessel"),
    ("volume = 1\n[cavity.lumen.windkessel]", r"\[cavity.lumen\]: give a volume or a windkessel"),
    ("volume = 0", r"\[cavity.lumen\] volume = 0: give a positive number in mm³"),
    ('volume = "1 l"', "volume = '1 l': .*mm³, ml"),
    ("volumes = 1", "volumes = 1: there is no such key.*'volume'"),
    ('volume = 1\naxis = "r"', r"\[cavity.lumen\] axis = 'r': choose one of"),
    (VESSELS.replace('"2 mmHg s/ml"', "-1"), r"lumen.windkessel\] resistance = -1: give a pos"),
    (VESSELS.replace("compliance", "impedance"), r"impedance = '1 ml/mmHg': give a positive"),
    ("windkessel = 3", "windkessel = 3: give a table"),
    ("[cavity.lumen.windkessel]\nresistance = 1", r"\[cavity.lumen\]: .*and perhaps an imp"),
    ("volume = 1\n[surfaces.lumen]\npressure = 1", r"\[surfaces.lumen\] pressure: leave it"),
]


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("pressure", "pressures", r"\[surfaces.lumen\] pressures = 1.0: .*no such key.*'pressure'"),
        ("pressure = 1.0", 'pressure = "1 bar"', r"'1 bar': .* in mmHg, .*mmHg, kPa, Pa"),
        ("pressure = 1.0", "pressure = -1", r"\[surfaces.lumen\] pressure = -1: give a positive"),
        ("pressure = 1.0", "pressure = nan", "pressure = nan: give a positive number in mmHg"),
        ("pressure = 1.0", "pressure = true", "pressure = True: give a positive"),
        ("pressure = 1.0", "spring = 1.0", "surfaces: name the surface under pressure"),
        ("pressure = 1.0", 'spring = "1 kPa"', r"\[surfaces.lumen\] spring = '1 kPa': .*kPa/mm"),
        ("pressure = 1.0", 'hold = "glue"', r"hold = 'glue': choose one of 'clamp', 'slide'"),
        ("pressure = 1.0", "", r"\[surfaces.lumen\] has no effect: give it"),
        ("pressure = 1.0", 'pressure = 1\nhold = "clamp"', "'lumen'. holds a clamp and another"),
        ("pressure = 1.0", 'pressure = 1\ndirection = "all"', "direction: has no effect without"),
        ("pressure = 1.0", "pressure = 1\ndashpot = 1", r"\[loading\] rate is missing: dashpots"),
        ("c = 3.0", "c = 0", r"\[layers.media\] c = 0: give a positive number in kPa"),
        ("c = 3.0", "", r"\[layers.media\] c is missing: give a positive"),
        ("c = 3.0", "c = 3.0\nk1 = 1.0", r"\[layers.media\] k2 is missing: fibres need k1, k2"),
        ("c = 3.0", "c = 3\nk1 = 1\nk2 = 1\nangle = 100", "angle = 100: .* from 0 to 90"),
        (LAYERS, "layers = 3\n", "layers = 3: give a table"),
        (LAYERS, "", "name the layers of the wall"),
        ("mesh", "Mesh", "Mesh = .*no such key.*did you mean 'mesh'"),
        (f'"{EXAMPLE}"', "3", "mesh = 3: give a text"),
        ("[layers.media]", "scale = 0\n[layers.media]", "scale = 0: give a positive number"),
        ("[layers.media]", "[layers.media", "is no TOML file: "),
        (LAYERS, f'{LAYERS}[prestretch]\naxis = "r"\n', r"\[prestretch\] axis = 'r': choose"),
        (LAYERS, f'{LAYERS}[prestretch]\naxis = "z"\n', r"\[prestretch\] stretch is missing"),
        (LAYERS, f'{LAYERS}[fibres]\nends = "a"\n', r"\[fibres\] ends = 'a': give a list of texts"),
        (LAYERS, f"{LAYERS}[fibres]\nlumen = 1\n", r"\[fibres\] lumen = 1: there is no such key"),
        *((LUMEN, f"[cavity.lumen]\n{more}", match) for more, match in CAVITIES),
    ],
)
def test_what_is_refused(read, old, new, match):
    """A bad value is an error with file, table, key, value and remedy."""
    agree(old in LEAST)
    with raises(ValueError, f"wall.toml.*{match}"):
        read(LEAST.replace(old, new, 1))


@pytest.mark.parametrize(
    ("more", "match"),
    [
        (CLAMP.replace("opening_1", "openin_1"), r"\[surfaces.openin_1\]: the wall has no surface"),
        ("[cavity.lume]\nvolume = 1\n", r"\[cavity.lume\]: .* no surface 'lume'.* mean 'lumen'"),
        (CLAMP + "[layers.fat]\nc = 1\n", r"\[layers.fat\]: .* no layer 'fat'; it has med"),
    ],
)
def test_what_does_not_fit_the_wall(read, more, match):
    """A case is refused if its surfaces, cavities or layers are not those of the wall."""
    wall = read_wall(EXAMPLE, COMM)
    read(LEAST + CLAMP).check(wall)
    with raises(ValueError, match):
        read(LEAST + more).check(wall)
    with raises(ValueError, r"\[layers.adventitia\] is missing"):
        read(LEAST.replace("[layers.adventitia]\nc = 0.3\n", "")).check(wall)
