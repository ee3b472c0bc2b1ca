# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Arguments of a wrong type are refused by their names, in all public functions of the rooms."""

from __future__ import annotations

import importlib
import inspect
import pickle
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import pytest

import ufl

from dolfinx_feti.loading import Checkpoint, Steps
from dolfinx_feti.mechanics import loads, materials
from dolfinx_feti.mechanics.values import typed
from dolfinx_feti.output import FieldWriter
from dolfinx_feti.wall import Filling, Tissue, read_wall
from dolfinx_feti.workshop import compile_material, evaluate, fit, uniaxial

pytestmark = pytest.mark.serial

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


PSI = partial(materials.neo_hookean, c=3.0)


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("names", lambda: read_wall("wall.msh", MPI.COMM_SELF, names=["media"])),
        ("c", lambda: Tissue(c="3 kPa")),
        ("windkessel", lambda: Filling(windkessel=3.0)),
        ("kappa", lambda: compile_material(PSI, kappa="soft")),
        ("parameters", lambda: compile_material(PSI, parameters=["c"])),
        ("material", lambda: evaluate(PSI, np.eye(3))),
        ("start", lambda: fit(PSI, [], ["c"])),
        ("stretch", lambda: uniaxial("long")),
        ("first", lambda: Steps(first="a", least=1.0)),
        ("parameters", lambda: Checkpoint("run", MPI.COMM_SELF, parameters=["kappa"])),
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
