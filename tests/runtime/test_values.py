# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Wrong values and types of public arguments are refused by the name of the argument."""

from __future__ import annotations

import importlib
import pickle
import sys
from collections.abc import Callable
from functools import partial
from numbers import Real
from pathlib import Path

import numpy as np
import pytest
from cases import each, wrong_values

import ufl

from dolfinx_feti import loads, materials, supports, workshop
from dolfinx_feti.loading import Steps, TimeSteps, follow_load
from dolfinx_feti.mechanics import memory
from dolfinx_feti.mechanics.residual_stress import opening_deformation, residual_stretch
from dolfinx_feti.output import FieldWriter
from dolfinx_feti.runtime.values import require_number, require_sequence, require_type
from dolfinx_feti.wall import Case, Clamp, Dashpot, Filling, LayerMaterial, Pressure, Spring
from dolfinx_feti.wall.opening_angles import OpeningAngles

pytestmark = pytest.mark.serial

I = ufl.Identity(3)  # noqa: E741
E = ufl.as_vector([1, 0, 0])
F = ufl.variable(I)
NAN = float("nan")
INF = float("inf")

POSITIVE = (0.0, -1.0, NAN, INF)
NOT_NEGATIVE = (-1.0, NAN, INF)


def case(**values: object) -> Case:
    """Return a case that is right but for these values."""
    conditions = {"lumen": (Pressure(),), "end": (Clamp(),), **values.pop("conditions", {})}
    return Case("tube", {"media": LayerMaterial(3.0)}, conditions, **{"pressure": 100.0, **values})


def vessels(**windkessel: float) -> Filling:
    """Return what fills a cavity in front of vessels."""
    return Filling(windkessel=windkessel)


HGO = {"c": 3.0, "k1": 2.0, "k2": 1.0}
OGDEN = dict.fromkeys(("a", "b", "a_f", "b_f", "a_s", "b_s", "a_fs", "b_fs"), 1.0)
GUCCIONE = dict.fromkeys(("c", "b_f", "b_t", "b_fs"), 1.0)

#: A call, the arguments that are right, and the wrong values of some.
Row = tuple[Callable[..., object], dict[str, object], dict[str, tuple[object, ...]]]

WRONG_VALUES: list[Row] = [
    (
        LayerMaterial,
        HGO,
        {
            "c": POSITIVE,
            "k1": NOT_NEGATIVE,
            "k2": POSITIVE,
            "angle": (-1.0, 91.0, NAN),
            "opening_angle": (360.0, -360.0, NAN),
            "axial_stretch": POSITIVE,
        },
    ),
    (
        case,
        {},
        {
            "pressure": POSITIVE,
            "scale": POSITIVE,
            "image_pressure": NOT_NEGATIVE,
            "prestretch": (*POSITIVE, 1.2),
            "prestretch_axis": ("r", 1),
            "rate": (*POSITIVE, 10.0),
        },
    ),
    (Filling, {}, {"volume": (*POSITIVE, None)}),
    (Filling, {"volume": 1.0}, {"axis": ("r", 1)}),
    (
        vessels,
        {"resistance": 1.0, "compliance": 1.0},
        {
            "resistance": POSITIVE,
            "compliance": POSITIVE,
            "impedance": NOT_NEGATIVE,
            "leakage": (1.0,),
        },
    ),
    (Pressure, {}, {"share": (0.0, NAN, INF)}),
    (Spring, {"stiffness": 1.0}, {"stiffness": POSITIVE, "direction": ("along", None)}),
    (Dashpot, {"viscosity": 1.0}, {"viscosity": POSITIVE, "direction": ("along", None)}),
    (loads.mmhg, {}, {"value": (NAN, INF)}),
    (loads.follower_pressure, {"u": E, "v": E, "ds": ufl.ds}, {"p": (NAN, INF)}),
    (
        Steps,
        {"first": 1.0, "least": 0.1},
        {
            "first": POSITIVE,
            "least": (*POSITIVE, 2.0),
            "growth": (0.9, NAN, INF),
            "rtol": (0.0, 1.0, NAN),
            "linear_rtol": (0.0, 2.0, NAN),
        },
    ),
    (
        TimeSteps,
        {"first": 1.0, "least": 0.5},
        {
            "first": POSITIVE,
            "least": (*POSITIVE, 2.0),
            "growth": (0.9, NAN, INF),
            "longest": (0.7, NAN, INF),
            "tolerance": POSITIVE,
        },
    ),
    (materials.ArteryParameters, {}, dict.fromkeys(HGO, POSITIVE)),
    (materials.neo_hookean, {"C": I}, {"c": POSITIVE}),
    (materials.mooney_rivlin, {"C": I, "c10": 1.0, "c01": 1.0}, {"c10": POSITIVE, "c01": POSITIVE}),
    (materials.volumetric, {"J": ufl.det(I)}, {"kappa": POSITIVE}),
    (materials.perturbed_lagrangian, {"J": ufl.det(I), "p": ufl.det(I)}, {"kappa": POSITIVE}),
    (
        materials.holzapfel_gasser_ogden,
        {"C": I, "a1": E, "a2": E, **HGO},
        dict.fromkeys(HGO, POSITIVE),
    ),
    (
        materials.gasser_ogden_holzapfel,
        {"C": I, "a1": E, "a2": E, "dispersion": 0.1, **HGO},
        {"dispersion": (-0.1, 0.4, NAN), "k2": POSITIVE},
    ),
    (materials.guccione, {"C": I, "fibre": E, **GUCCIONE}, dict.fromkeys(GUCCIONE, POSITIVE)),
    (
        materials.holzapfel_ogden,
        {"C": I, "fibre": E, "sheet": E, **OGDEN},
        dict.fromkeys(OGDEN, POSITIVE),
    ),
    (materials.active_tension, {"C": I, "fibre": E}, {"tension": NOT_NEGATIVE}),
    (
        materials.saint_venant_kirchhoff,
        {"C": I, "lmbda": 1.0, "mu": 1.0},
        {"lmbda": POSITIVE, "mu": POSITIVE},
    ),
    (
        memory.MaxwellBranch,
        {"Q": I, "share": 1.0, "time": 1.0},
        {"share": POSITIVE, "time": POSITIVE},
    ),
    (memory.viscoelastic, {"psi": ufl.tr(F), "F": F, "S_n": I, "branches": []}, {"dt": POSITIVE}),
    (
        memory.damaged,
        {"psi": ufl.tr(I), "m": ufl.tr(I), "d_max": 0.5, "W": 1.0},
        {"d_max": (0.0, 1.0, 5, NAN), "W": POSITIVE},
    ),
    (
        residual_stretch,
        {"curvature": 1.0, "depth": ufl.tr(I), "angle": 10.0},
        {"curvature": (NAN, INF), "angle": (360.0, NAN, -INF), "stretch": POSITIVE},
    ),
    (opening_deformation, {"directions": [E, E, E], "λ": ufl.tr(I)}, {"stretch": POSITIVE}),
    (
        supports.spring_energy,
        {"u": E, "ds": ufl.ds, "stiffness": 1.0},
        {"stiffness": NOT_NEGATIVE, "direction": ("along",)},
    ),
    (
        supports.dashpot_energy,
        {"u": E, "last": E, "ds": ufl.ds, "viscosity": 1.0, "time_step": 1.0, "direction": "all"},
        {"viscosity": NOT_NEGATIVE, "time_step": (0.0, -1.0, NAN), "direction": ("along",)},
    ),
    (
        workshop.uniaxial,
        {"stretch": [1.0]},
        {
            "stretch": (0.0, [1.0, -0.5], NAN, [], [[1.0]]),
            "along": ((0, 0, 0), (NAN, 0, 0), (1, 0)),
        },
    ),
    (
        workshop.biaxial,
        {"stretch": [1.0], "stretch_2": 1.0},
        {"stretch_2": (0.0, INF, [1.0, 2.0]), "across": ((1, 0, 0), (1, 1, 0))},
    ),
    (workshop.simple_shear, {"shear": [0.1]}, {"shear": (NAN, []), "across": ((0, 0, 0),)}),
    (workshop.inflation, {"stretch": [1.0]}, {"axial": POSITIVE}),
    (
        workshop.DataSet,
        {"path": workshop.uniaxial([1.0]), "stress": [0.0], "measure": "piola"},
        {
            "weight": (*POSITIVE, "1"),
            "measure": ("engineering", None),
            "stress": ([NAN], [0.0, 1.0]),
        },
    ),
]


@wrong_values(WRONG_VALUES)
def test_wrong_values_are_refused_by_name(call, right, name, wrong):
    """One argument at a time is wrong; all others are right."""
    with pytest.raises((ValueError, TypeError), match=rf"\b{name}\b"):
        call(**{**right, name: wrong})


DASHPOT = {"outer": (Dashpot(0.1),)}

#: Arguments that need others, or exclude them, and the message.
UNFIT = {
    "pressure without a surface": (
        lambda: case(conditions={"lumen": (Spring(1.0),)}),
        r"pressure=100\.0: has no effect without a surface",
    ),
    "dashpot without a rate": (lambda: case(conditions=DASHPOT), "rate is missing: dashpots need"),
    "empty filling": (Filling, "give a volume or a windkessel"),
    "two fillings": (
        lambda: Filling(volume=1.0, windkessel={"resistance": 1.0, "compliance": 1.0}),
        "give a volume or a windkessel",
    ),
    "windkessel without compliance": (
        lambda: vessels(resistance=1.0),
        r"windkessel=.*: give a resistance, a compliance",
    ),
}


@each(("create", "message"), UNFIT)
def test_arguments_that_need_or_exclude_others_are_refused(create, message):
    """Each value is right by itself."""
    with pytest.raises(ValueError, match=message):
        create()


def test_arguments_that_fit_each_other_are_accepted():
    """A rate belongs to dashpots, and a stretch to an axis."""
    assert case(conditions=DASHPOT, rate=10.0).rate == 10.0
    assert case(prestretch_axis="x", prestretch=1.2).prestretch == 1.2
    assert np.isfinite(LayerMaterial(3.0).k2)


@pytest.mark.parametrize("wrong", ["3 kPa", True, None])
def test_stiffness_of_a_layer_must_be_a_number(wrong):
    """A text with a unit belongs to a file, and True is no number here."""
    with pytest.raises(TypeError, match=f"c (is|=) {wrong!r}: "):
        LayerMaterial(wrong)


# -- types

ROOMS = [
    importlib.import_module(f"dolfinx_feti.{name}")
    for name in ("loading", "output", "wall", "workshop", "comparison")
]


@pytest.mark.parametrize(
    ("check", "value"),
    [
        (require_number, 1),
        (require_number, np.float32(1.0)),
        (require_number, np.int64(3)),
        (partial(require_type, (Path, str)), "wall.xdmf"),
        (partial(require_sequence, Real), np.ones(3)),
        (partial(require_sequence, Real), (1, 2.0)),
        (partial(require_sequence, str), []),
    ],
)
def test_right_types_are_accepted(check, value):
    """Numbers of NumPy count as numbers, and arrays as sequences."""
    check(x=value)


@pytest.mark.parametrize(
    ("check", "value", "message"),
    [
        (require_number, "1", "x is '1': give float"),
        (require_number, None, "x is None: give float"),
        (require_number, True, "x is True: give float"),
        (require_number, ufl.as_ufl(1.0), "x is FloatValue"),
        (partial(require_type, str), 3, "x is 3: give str"),
        (partial(require_type, (Path, str)), None, r"x is None: give pathlib\..*Path \| str"),
        (partial(require_sequence, Real), 0.3, r"x is 0.3: give Sequence\[float\]"),
        (partial(require_sequence, Real), "abc", "x is 'abc'"),
        (partial(require_sequence, Real), [1.0, "b"], r"x\[1\] is 'b': give Sequence\[float\]"),
        (partial(require_sequence, Real), {1.0}, r"x is \{1.0\}"),
        (partial(require_sequence, Real), np.array(1.0), r"x is array\(1"),
        (partial(require_sequence, Real), ufl.as_vector((1.0, 2.0)), "x is ListTensor"),
    ],
)
def test_wrong_types_are_refused_with_the_right_one(check, value, message):
    """The message has the value and the type that is expected."""
    with pytest.raises(TypeError, match=message):
        check(x=value)


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("first", lambda: Steps(first="a", least=1.0)),
        ("quick", lambda: Steps(first=1.0, least=1.0, quick="6")),
        ("tolerance", lambda: TimeSteps(first=1.0, least=1.0, tolerance="small")),
        ("functions", lambda: FieldWriter("wall", None)),
        ("axis", lambda: loads.enclosed_volume(ufl.Identity(3)[0, :], ufl.ds, "z")),
        ("problem", lambda: follow_load(None, abs, [1.0], Steps(1.0, 1.0))),
        ("wall", lambda: OpeningAngles(None, {})),
        ("material", lambda: workshop.respond(abs, workshop.uniaxial([1.0]))),
    ],
)
def test_public_functions_refuse_wrong_types_by_name(name, call):
    """The error comes from the function that was called, not from deep inside."""
    with pytest.raises(TypeError, match=f"^{name} is "):
        call()


@pytest.mark.parametrize("room", ROOMS, ids=lambda room: room.__name__)
def test_exports_of_rooms_are_those_of_their_modules(room):
    """A room exports the functions and classes of its files, which can be pickled."""
    for name in room.__all__:
        member = getattr(room, name)
        if callable(member):
            assert getattr(sys.modules[member.__module__], name) is member, name
            assert pickle.loads(pickle.dumps(member)) is member, name
