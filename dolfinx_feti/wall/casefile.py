# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A case in one TOML file: mesh, layers, surfaces, fibres, prestretch, image and loading.

`docs/cases.md` explains the keys, and `demos/wall.toml` is an example. A number is in the first
unit of its key; a text such as ``"13 kPa"`` may have another one.
"""

from __future__ import annotations

import difflib
import math
import sys
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfinx_feti.mechanics.loads import mmhg
from dolfinx_feti.mechanics.values import require_not_negative, require_positive, require_within
from dolfinx_feti.runtime.collective import on_first
from dolfinx_feti.wall.conditions import (
    Clamp,
    Condition,
    Dashpot,
    Pressure,
    Slide,
    Spring,
    by_surface,
)
from dolfinx_feti.wall.wall import AXES, Wall

__all__ = ["Case", "Filling", "Tissue", "read_case"]

MMHG = 1.0 / mmhg(1.0)  # in a kPa


@dataclass(frozen=True, slots=True)
class Tissue:
    """The material of a layer."""

    c: float  #: Stiffness of the matrix material [kPa]
    k1: float = 0.0  #: Stiffness of the fibres [kPa]; 0 for none
    k2: float = 1.0  #: Exponent of the fibres [-]
    angle: float = 0.0  #: Angle of the fibres from the circumferential direction [degrees]
    opening_angle: float = 0.0  #: Angle by which the layer opens when it is cut [degrees]
    axial_stretch: float = 1.0  #: Prestretch along the vessel [-]

    def __post_init__(self) -> None:
        """Check the values."""
        require_positive(c=self.c, k2=self.k2, axial_stretch=self.axial_stretch)
        require_not_negative(k1=self.k1)
        require_within(0.0, 90.0, {"angle": self.angle})
        require_within(-360.0, 360.0, {"opening_angle": self.opening_angle}, ends=False)


@dataclass(frozen=True, slots=True)
class Filling:
    """What governs the volume of a cavity, whose pressure is an unknown: one of the first two."""

    volume: float | None = None  #: Volume to be enclosed [mm³]
    #: Resistance [kPa s/mm³], compliance [mm³/kPa], and perhaps impedance
    windkessel: dict[str, float] = field(default_factory=dict)
    axis: str | None = None  #: Axis of a tube with open ends; None for a closed surface

    def __post_init__(self) -> None:
        """Check the values."""
        if (self.volume is None) == (not self.windkessel):
            raise ValueError("give a volume or a windkessel, one of them")
        if self.volume is not None:
            require_positive(volume=self.volume)
        if vessels := dict(self.windkessel):
            require_not_negative(impedance=vessels.pop("impedance", 0.0))
            both = "a resistance, a compliance, and perhaps an impedance"
            has = f"windkessel={self.windkessel}: give {both}"
            _require(set(vessels) == {"resistance", "compliance"}, has)
            require_positive(**vessels)
        _require(self.axis in (None, *AXES), f"axis={self.axis!r}: choose 'x', 'y', 'z' or None")


@dataclass(frozen=True, slots=True)
class Case:
    """A wall under pressure, or with cavities that are filled."""

    mesh: str  #: Name of the mesh, as in the file
    layers: dict[str, Tissue]  #: Materials of the layers
    conditions: dict[str, tuple[Condition, ...]]  #: On the surfaces; the largest share is 1
    pressure: float  #: Target [mmHg]; 0 if all pressures are those of cavities
    scale: float = 1.0  #: Millimetres in the mesh's unit of length
    image: float = 0.0  #: Pressure under which the wall has the mesh's shape [mmHg]; 0 at rest
    rate: float | None = None  #: Rate of the pressure [mmHg/s]; None without dashpots
    axis: str | None = None  #: Axis of the prestretch; None for none
    stretch: float = 1.0  #: The prestretch [-]
    fibres: dict[str, Any] = field(default_factory=dict)  #: Arguments of ``fibre_frame``
    cavities: dict[str, Filling] = field(default_factory=dict)  #: Fillings by surface

    def __post_init__(self) -> None:
        """Check the values."""
        require_positive(scale=self.scale, stretch=self.stretch)
        require_not_negative(image=self.image)
        if self.pressure or not self.cavities:
            require_positive(pressure=self.pressure)
        if self.rate is not None:
            require_positive(rate=self.rate)
        given = [(name, type(c)) for name, found in self.conditions.items() for c in found]
        loaded = {name for name, kind in given if kind is Pressure}
        dashpots = self.pressure > 0.0 and any(kind is Dashpot for _, kind in given)
        none = "has no effect without"
        for holds, message in (
            (loaded or not self.pressure,
             f"pressure={self.pressure}: {none} a surface under pressure"),
            (self.axis in (None, *AXES), f"axis={self.axis!r}: choose 'x', 'y', 'z' or None"),
            (self.axis or self.stretch == 1.0, f"stretch={self.stretch}: {none} an axis"),
            (self.rate or not dashpots,
             "[loading] rate is missing: dashpots need the rate of the pressure [mmHg/s]"),
            (dashpots or self.rate is None,
             f"[loading] rate = {self.rate}: {none} a dashpot and a pressure"),
        ):  # fmt: skip
            _require(holds, message)
        for name in self.cavities:
            has = f"[surfaces.{name}] pressure: leave it out, [cavity.{name}] determines it"
            _require(name not in loaded, has)

    @property
    def has_residual_stress(self) -> bool:
        """Whether a layer opens, or becomes shorter, when it is cut out."""
        return any(t.opening_angle or t.axial_stretch != 1.0 for t in self.layers.values())

    def check(self, wall: Wall) -> None:
        """Compare names with those of the wall.

        Raises:
            ValueError: A name is wrong, or a layer is missing.
        """
        for table, kind, given, known in (
            ("layers", "layer", self.layers, wall.layers),
            ("surfaces", "surface", self.conditions, wall.surfaces),
            ("cavity", "surface", self.cavities, wall.surfaces),
        ):
            for name in given:
                has = f"it has {', '.join(known) or 'none'}{_meant(name, known)}"
                _require(name in known, f"[{table}.{name}]: the wall has no {kind} {name!r}; {has}")
        for name in wall.layers:
            _require(name in self.layers, f"[layers.{name}] is missing: give the layer's material")


def _require(holds: object, message: str) -> None:
    if not holds:
        raise ValueError(message)


def _meant(word: str, known: Iterable[str]) -> str:
    """Ask whether a similar word was meant."""
    close = difflib.get_close_matches(word, list(known), n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def read_case(path: Path | str, comm: MPI.Comm) -> Case:
    """Read a case on the first process (docs/cases.md). Collective.

    Raises:
        OSError: The file cannot be read.
        ValueError: It is no TOML, or a key or a value in it is wrong.
    """
    return on_first(lambda: _read_case(Path(path)), comm)


def _read_case(path: Path) -> Case:
    """Read a case on one process."""
    try:
        words = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise FileNotFoundError(f"There is no file {path}: name a TOML file") from error
    except (ValueError, RecursionError) as error:  # neither TOML nor text
        raise ValueError(f"{path} is no TOML file: {error}") from error
    try:
        return _create_case(_values(words, KEYS))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


# What a key asks for, and the function that takes its value or raises an error.
Ask = tuple[str, Callable[[Any], Any]]


def _number(
    units: dict[str, float], least: float = sys.float_info.min, most: float = sys.float_info.max
) -> Ask:
    """Ask for a number in the first unit, or for a text with one of the units."""
    first = next(iter(units))
    bounds = "a positive number" if least > 0.0 else f"a number from {least:g} to {most:g}"
    unit_asked = f" in {first}, or a text with its unit, {', '.join(units)}" * bool(first)

    def take(value: Any) -> float:
        text = value if isinstance(value, str) else f"{value} {first}"
        figure, _, unit = text.strip().partition(" ")
        number = float(figure) * units[unit.strip()]
        _require(least <= number <= most, "out of bounds")
        return number

    return f"give {bounds}{unit_asked}", take


def _choice(*choices: str) -> Ask:
    """Ask for one of several texts."""
    return f"choose one of {', '.join(map(repr, choices))}", lambda v: choices[choices.index(v)]


def _texts(value: Any) -> list[str]:
    _require(isinstance(value, list) and all(isinstance(v, str) for v in value), "no list of texts")
    return value


TEXT = 'give a text, in quotation marks, as in mesh = "wall.msh"', lambda v: _texts([v])[0]
STIFFNESS = _number({"kPa": 1.0, "Pa": 1e-3, "MPa": 1e3})
SPRING = {"kPa/mm": 1.0, "kPa/cm": 0.1, "kPa/m": 1e-3, "Pa/mm": 1e-3, "Pa/m": 1e-6}
DEGREES = {"degrees": 1.0, "rad": 180.0 / math.pi}
LAYER = {
    "c": STIFFNESS,
    "k1": STIFFNESS,
    "k2": _number({"": 1.0}),
    "angle": _number(DEGREES, 0.0, 90.0),
    "opening_angle": _number(DEGREES, -359.0, 359.0),
    "axial_stretch": _number({"": 1.0}),
}
FIBRES = ("k1", "k2", "angle")
PRESSURE = _number({"mmHg": 1.0, "kPa": MMHG, "Pa": 1e-3 * MMHG})
SURFACE = {
    "pressure": PRESSURE,
    "spring": _number(SPRING),
    "dashpot": _number({unit.replace("/", " s/"): factor for unit, factor in SPRING.items()}),
    "direction": _choice("normal", "all"),
    "hold": _choice("clamp", "slide"),
}
#: A millilitre is 1000 mm³.
RESISTANCE = _number({"kPa s/mm³": 1.0, "mmHg s/ml": 1e-3 / MMHG})
COMPLIANCE = _number({"mm³/kPa": 1.0, "ml/mmHg": 1e3 * MMHG})
CAVITY = {
    "volume": _number({"mm³": 1.0, "ml": 1e3}),
    "axis": _choice(*AXES),
    "windkessel": {"resistance": RESISTANCE, "compliance": COMPLIANCE, "impedance": RESISTANCE},
}
ENDS = 'give a list of texts, as ["opening_1", "opening_2"]', _texts
KEYS = {
    "mesh": TEXT,
    "scale": _number({"": 1.0}),
    "layers": {"*": LAYER},
    "surfaces": {"*": SURFACE},
    "cavity": {"*": CAVITY},
    "image": {"pressure": PRESSURE},
    "fibres": {"inner": TEXT, "outer": TEXT, "ends": ENDS, "inlet": TEXT},
    "prestretch": {"axis": _choice(*AXES), "stretch": _number({"": 1.0})},
    "loading": {"rate": _number({"mmHg/s": 1.0, "kPa/s": MMHG})},
}


def _values(table: dict[str, Any], keys: dict[str, Any], name: str = "") -> dict[str, Any]:
    """Return the values of a table in the first unit of each; name the key that is wrong."""
    values = {}
    for key, value in table.items():
        where = f"[{name}] {key} = {value!r}" if name else f"{key} = {value!r}"
        ask = keys.get(key, keys.get("*"))
        others = f"there are {', '.join(keys)}{_meant(key, keys)}"
        _require(ask, f"{where}: there is no such key; {others}")
        if isinstance(ask, dict):
            _require(isinstance(value, dict), f"{where}: this is to be a table, [{key}]")
            values[key] = _values(value, ask, f"{name}.{key}".strip("."))
            continue
        try:
            values[key] = ask[1](value)
        except (KeyError, OverflowError, TypeError, ValueError) as error:
            raise ValueError(f"{where}: {ask[0]}") from error
    return values


def _need(words: dict[str, Any], name: str, keys: Iterable[str], why: str) -> None:
    for key in keys:
        _require(key in words, f"[{name}] {key} is missing: {why}")


def _create_case(words: dict[str, Any]) -> Case:
    """Return the case that the values of a file make."""
    layers, surfaces, cavities = (words.get(key, {}) for key in ("layers", "surfaces", "cavity"))
    _require("mesh" in words, "mesh is missing: name a file, vessel or tube")
    _require(layers, "name the layers of the wall and their materials, as [layers.media]")
    for name, layer in layers.items():
        _need(layer, f"layers.{name}", ["c"], "give a positive number in kPa")
        if any(key in layer for key in FIBRES):
            _need(layer, f"layers.{name}", FIBRES, "fibres need k1, k2 and angle")
    pressures = {name: s["pressure"] for name, s in surfaces.items() if "pressure" in s}
    most = max(pressures.values(), default=0.0)
    conditions: dict[str, tuple[Condition, ...]] = {}
    for name, s in surfaces.items():
        direction = s.get("direction", "normal")
        share = [Pressure(s["pressure"] / most)] if name in pressures else []
        spring = [Spring(s["spring"], direction)] if "spring" in s else []
        dashpot = [Dashpot(s["dashpot"], direction)] if "dashpot" in s else []
        hold = [Clamp() if s["hold"] == "clamp" else Slide()] if "hold" in s else []
        conditions[name] = (*share, *spring, *dashpot, *hold)
        message = f"[surfaces.{name}] has no effect: give it a pressure, spring, dashpot or hold"
        _require(conditions[name], message)
        message = f"[surfaces.{name}] direction: has no effect without a spring or a dashpot"
        _require(spring or dashpot or "direction" not in s, message)
    by_surface(conditions)  # nothing acts on a clamped surface
    fillings: dict[str, Filling] = {}
    for name, given in cavities.items():
        one = f"[cavity.{name}]: give a volume or a windkessel, one of them"
        _require(("volume" in given) != ("windkessel" in given), one)
        try:
            fillings[name] = Filling(**given)
        except ValueError as error:
            raise ValueError(f"[cavity.{name}]: {error}") from error
    has = "surfaces: name the surface under pressure, as [surfaces.lumen], or a cavity"
    _require(pressures or cavities, has)
    if "prestretch" in words:
        _need(words["prestretch"], "prestretch", ["axis", "stretch"], "both are needed")
    return Case(
        mesh=words["mesh"],
        layers={name: Tissue(**layer) for name, layer in layers.items()},
        conditions=conditions,
        pressure=most,
        scale=words.get("scale", 1.0),
        image=words.get("image", {}).get("pressure", 0.0),
        rate=words.get("loading", {}).get("rate"),
        fibres=words.get("fibres", {}),
        cavities=fillings,
        **words.get("prestretch", {}),
    )
