# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Values without a meaning, and arguments of a wrong type, refused by their names in all rooms."""

from __future__ import annotations

import importlib
import inspect
import pickle
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pytest
from cases import wrong_values

import ufl

from dolfinx_feti import loads, materials, supports, workshop
from dolfinx_feti.loading import Steps, TimeSteps
from dolfinx_feti.mechanics import memory
from dolfinx_feti.mechanics.residual_stress import opened, residual_stretch
from dolfinx_feti.mechanics.values import typed
from dolfinx_feti.output import FieldWriter
from dolfinx_feti.wall import Case, Clamp, Dashpot, Filling, Pressure, Spring, Tissue

pytestmark = pytest.mark.serial

I = ufl.Identity(3)  # noqa: E741
E = ufl.as_vector([1, 0, 0])
F = ufl.variable(I)
NAN, INF = float("nan"), float("inf")

POSITIVE, NOT_NEGATIVE = (0.0, -1.0, NAN, INF), (-1.0, NAN, INF)


def case(**values: object) -> Case:
    """Return a case that is right but for these values."""
    conditions = {"lumen": (Pressure(),), "end": (Clamp(),), **values.pop("conditions", {})}
    return Case("tube", {"media": Tissue(3.0)}, conditions, **{"pressure": 100.0, **values})


def vessels(**windkessel: float) -> Filling:
    """Return what fills a cavity in front of vessels."""
    return Filling(windkessel=windkessel)


HGO = {"c": 3.0, "k1": 2.0, "k2": 1.0}
OGDEN = dict.fromkeys(("a", "b", "a_f", "b_f", "a_s", "b_s", "a_fs", "b_fs"), 1.0)
GUCCIONE = dict.fromkeys(("c", "b_f", "b_t", "b_fs"), 1.0)

#: A call, the arguments that are right, and the wrong values of some.
Row = tuple[Callable[..., object], dict[str, object], dict[str, tuple[object, ...]]]

TABLE: list[Row] = [
    (Tissue, HGO, {
        "c": POSITIVE, "k1": NOT_NEGATIVE, "k2": POSITIVE, "angle": (-1.0, 91.0, NAN),
        "opening_angle": (360.0, -360.0, NAN), "axial_stretch": POSITIVE}),
    (case, {}, {
        "pressure": POSITIVE, "scale": POSITIVE, "image": NOT_NEGATIVE, "stretch": (*POSITIVE, 1.2),
        "axis": ("r", 1), "rate": (*POSITIVE, 10.0)}),
    (Filling, {}, {"volume": (*POSITIVE, None)}),
    (Filling, {"volume": 1.0}, {"axis": ("r", 1)}),
    (vessels, {"resistance": 1.0, "compliance": 1.0}, {
        "resistance": POSITIVE, "compliance": POSITIVE, "impedance": NOT_NEGATIVE,
        "leakage": (1.0,)}),
    (Pressure, {}, {"share": (0.0, NAN, INF)}),
    (Spring, {"stiffness": 1.0}, {"stiffness": POSITIVE, "direction": ("along", None)}),
    (Dashpot, {"viscosity": 1.0}, {"viscosity": POSITIVE, "direction": ("along", None)}),
    (loads.mmhg, {}, {"value": (NAN, INF)}),
    (loads.follower_pressure, {"u": E, "v": E, "ds": ufl.ds}, {"p": (NAN, INF)}),
    (Steps, {"first": 1.0, "least": 0.1}, {
        "first": POSITIVE, "least": (*POSITIVE, 2.0), "growth": (0.9, NAN, INF),
        "rtol": (0.0, 1.0, NAN), "linear_rtol": (0.0, 2.0, NAN)}),
    (TimeSteps, {"first": 1.0, "least": 0.5}, {
        "first": POSITIVE, "least": (*POSITIVE, 2.0), "growth": (0.9, NAN, INF),
        "longest": (0.7, NAN, INF), "tolerance": POSITIVE}),
    (materials.ArteryParameters, {}, dict.fromkeys(HGO, POSITIVE)),
    (materials.neo_hookean, {"C": I}, {"c": POSITIVE}),
    (materials.mooney_rivlin, {"C": I, "c10": 1.0, "c01": 1.0}, {"c10": POSITIVE, "c01": POSITIVE}),
    (materials.volumetric, {"J": ufl.det(I)}, {"kappa": POSITIVE}),
    (materials.perturbed_lagrangian, {"J": ufl.det(I), "p": ufl.det(I)}, {"kappa": POSITIVE}),
    (materials.holzapfel_gasser_ogden, {"C": I, "a1": E, "a2": E, **HGO},
     dict.fromkeys(HGO, POSITIVE)),
    (materials.gasser_ogden_holzapfel, {"C": I, "a1": E, "a2": E, "dispersion": 0.1, **HGO},
     {"dispersion": (-0.1, 0.4, NAN), "k2": POSITIVE}),
    (materials.guccione, {"C": I, "fibre": E, **GUCCIONE}, dict.fromkeys(GUCCIONE, POSITIVE)),
    (materials.holzapfel_ogden, {"C": I, "fibre": E, "sheet": E, **OGDEN},
     dict.fromkeys(OGDEN, POSITIVE)),
    (materials.active_tension, {"C": I, "fibre": E}, {"tension": NOT_NEGATIVE}),
    (materials.saint_venant_kirchhoff, {"C": I, "lmbda": 1.0, "mu": 1.0},
     {"lmbda": POSITIVE, "mu": POSITIVE}),
    (memory.MaxwellBranch, {"Q": I, "share": 1.0, "time": 1.0},
     {"share": POSITIVE, "time": POSITIVE}),
    (memory.viscoelastic, {"psi": ufl.tr(F), "F": F, "S_n": I, "branches": []}, {"dt": POSITIVE}),
    (memory.damaged, {"psi": ufl.tr(I), "m": ufl.tr(I), "d_max": 0.5, "W": 1.0},
     {"d_max": (0.0, 1.0, 5, NAN), "W": POSITIVE}),
    (residual_stretch, {"curvature": 1.0, "depth": ufl.tr(I), "angle": 10.0},
     {"curvature": (NAN, INF), "angle": (360.0, NAN, -INF), "stretch": POSITIVE}),
    (opened, {"directions": [E, E, E], "λ": ufl.tr(I)}, {"stretch": POSITIVE}),
    (supports.spring_energy, {"u": E, "ds": ufl.ds, "stiffness": 1.0},
     {"stiffness": NOT_NEGATIVE, "direction": ("along",)}),
    (supports.dashpot_energy,
     {"u": E, "last": E, "ds": ufl.ds, "viscosity": 1.0, "time_step": 1.0, "direction": "all"},
     {"viscosity": NOT_NEGATIVE, "time_step": (0.0, -1.0, NAN), "direction": ("along",)}),
    (workshop.uniaxial, {"stretch": [1.0]},
     {"stretch": (0.0, [1.0, -0.5], NAN, [], [[1.0]]), "along": ((0, 0, 0), (NAN, 0, 0), (1, 0))}),
    (workshop.biaxial, {"stretch": [1.0], "stretch_2": 1.0},
     {"stretch_2": (0.0, INF, [1.0, 2.0]), "across": ((1, 0, 0), (1, 1, 0))}),
    (workshop.simple_shear, {"shear": [0.1]}, {"shear": (NAN, []), "across": ((0, 0, 0),)}),
    (workshop.inflation, {"stretch": [1.0]}, {"axial": POSITIVE}),
    (workshop.DataSet, {"path": workshop.uniaxial([1.0]), "stress": [0.0], "measure": "piola"},
     {"weight": (*POSITIVE, "1"), "measure": ("engineering", None), "stress": ([NAN], [0.0, 1.0])}),
]  # fmt: skip


@wrong_values(TABLE)
def test_refused_with_its_name(call, right, name, wrong):
    with pytest.raises((ValueError, TypeError), match=rf"\b{name}\b"):
        call(**{**right, name: wrong})


def test_what_has_no_effect_in_a_case():
    """A rate belongs to dashpots, a stretch to an axis, a pressure to a surface."""
    with pytest.raises(ValueError, match=r"pressure=100\.0: has no effect without a surface"):
        case(conditions={"lumen": (Spring(1.0),)})
    dashpot = {"outer": (Dashpot(0.1),)}
    with pytest.raises(ValueError, match="rate is missing: dashpots need"):
        case(conditions=dashpot)
    assert case(conditions=dashpot, rate=10.0).rate == 10.0
    assert case(axis="x", stretch=1.2).stretch == 1.2
    for both in ({}, {"volume": 1.0, "windkessel": {"resistance": 1.0, "compliance": 1.0}}):
        with pytest.raises(ValueError, match="give a volume or a windkessel, one of them"):
            Filling(**both)
    with pytest.raises(ValueError, match=r"windkessel=.*: give a resistance, a compliance"):
        vessels(resistance=1.0)
    for wrong in ("3 kPa", True, None):
        with pytest.raises(TypeError, match=f"c (is|=) {wrong!r}: "):
            Tissue(wrong)
    assert np.isfinite(Tissue(3.0).k2)


# -- types

ROOMS = [
    importlib.import_module(f"dolfinx_feti.{name}")
    for name in ("loading", "output", "wall", "workshop", "comparison")
]


@typed
def work(
    a: float = 1.0,
    n: int = 1,
    name: str | None = None,
    path: Path | str = "",
    numbers: npt.ArrayLike = 1.0,
    parts: Sequence[float] = (),
    pair: tuple[float, float] = (0.0, 1.0),
    words: Mapping[str, float] | None = None,
    act: Callable[[float], object] = abs,
    choice: Literal["x", "y"] = "x",
    anything: Any = None,
    **others: float,
) -> int:
    return n


@pytest.mark.parametrize(
    "given",
    [
        {"a": 1, "n": np.int64(3), "name": "b", "path": Path()},
        {"a": np.float32(1.0), "numbers": [[1, 2], [3, 4]], "parts": np.ones(3), "pair": [0, 1]},
        {"words": {"c": 1.0}, "choice": 3, "anything": object(), "other": 1.0, "parts": (1, 2.0)},
    ],
)
def test_fitting(given):
    assert work(**given) in (1, 3)


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"a": "1"}, "a is '1': give float"),
        ({"a": None}, "a is None"),
        ({"n": 1.5}, "n is 1.5: give int"),
        ({"name": 3}, r"name is 3: give str \| None"),
        ({"path": None}, r"path is None: give .*Path \| str"),
        ({"numbers": "a"}, "numbers is 'a'"),
        ({"numbers": None}, "numbers is None"),
        ({"numbers": [[1], [2, 3]]}, "numbers is "),
        ({"parts": 0.3}, r"parts is 0.3: give Sequence\[float\]"),
        ({"parts": "abc"}, "parts is 'abc'"),
        ({"parts": [1.0, "b"]}, r"parts\[1\] is 'b'"),
        ({"parts": {1.0}}, r"parts is \{1.0\}"),
        ({"parts": np.array(1.0)}, r"parts is array\(1"),
        ({"parts": ufl.as_vector((1.0, 2.0))}, "parts is ListTensor"),
        ({"parts": ufl.as_ufl(1.0)}, "parts is FloatValue"),
        ({"pair": 1.0}, "pair is 1.0"),
        ({"words": ["c"]}, r"words is \['c'\]: give Mapping\[str, float\]"),
        ({"words": {"c": "d"}}, r"words\['c'\] is 'd'"),
        ({"act": 3}, "act is 3"),
    ],
)
def test_refused(given, match):
    with pytest.raises(TypeError, match=match):
        work(**given)


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("first", lambda: Steps(first="a", least=1.0)),
        ("functions", lambda: FieldWriter("wall", None)),
        ("axis", lambda: loads.enclosed_volume(ufl.Identity(3)[0, :], ufl.ds, "z")),
    ],
)
def test_public_functions(name, call):
    with pytest.raises(TypeError, match=f"^{name} is "):
        call()


@pytest.mark.parametrize("room", ROOMS, ids=lambda room: room.__name__)
def test_rooms(room):
    """All that a room exports is checked, and can be pickled."""
    for name in room.__all__:
        thing = getattr(room, name)
        if callable(thing):
            assert pickle.loads(pickle.dumps(thing)) is thing
        work = thing.__init__ if inspect.isclass(thing) else thing
        if callable(work) and work is not object.__init__:
            assert hasattr(work, "__wrapped__"), name
