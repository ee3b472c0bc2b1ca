# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A case in one TOML file: mesh, layers, surfaces, fibres, prestretch, image and loading.

`docs/cases.md` explains the keys, and `demos/wall.toml` is an example. A number is in the first
unit of its key; a text such as ``"13 kPa"`` may have another one.
"""

from __future__ import annotations

import math
import sys
import tomllib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfinx_feti.mechanics.loads import mmhg
from dolfinx_feti.runtime.collective import on_first
from dolfinx_feti.wall.case import Case, Filling, Tissue, meant, require
from dolfinx_feti.wall.conditions import (
    Clamp,
    Condition,
    Dashpot,
    Pressure,
    Slide,
    Spring,
    by_surface,
)

__all__ = ["read_case"]

MMHG = 1.0 / mmhg(1.0)  # in a kPa


def read_case(path: Path | str, comm: MPI.Comm) -> Case:
    """Read a case on the first process. Collective.

    Args:
        path: The file.
        comm: Communicator.

    Raises:
        OSError: The file cannot be read.
        ValueError: It is no TOML, or a key or a value in it is wrong: the message names file,
            table, key, value and remedy.
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
        require(least <= number <= most, "out of bounds")
        return number

    return f"give {bounds}{unit_asked}", take


def _choice(*choices: str) -> Ask:
    """Ask for one of several texts."""
    return f"choose one of {', '.join(map(repr, choices))}", lambda v: choices[choices.index(v)]


def _texts(value: Any) -> list[str]:
    require(isinstance(value, list) and all(isinstance(v, str) for v in value), "no list of texts")
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
WINDKESSEL = {
    "resistance": _number({"kPa s/mm³": 1.0, "mmHg s/ml": 1e-3 / MMHG}),
    "compliance": _number({"mm³/kPa": 1.0, "ml/mmHg": 1e3 * MMHG}),
    "impedance": _number({"kPa s/mm³": 1.0, "mmHg s/ml": 1e-3 / MMHG}),
}
CAVITY = {
    "volume": _number({"mm³": 1.0, "ml": 1e3}),
    "axis": _choice(*"xyz"),
    "windkessel": WINDKESSEL,
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
    "prestretch": {"axis": _choice(*"xyz"), "stretch": _number({"": 1.0})},
    "loading": {"rate": _number({"mmHg/s": 1.0, "kPa/s": MMHG})},
}


def _values(table: dict[str, Any], keys: dict[str, Any], name: str = "") -> dict[str, Any]:
    """Return the values of a table in the first unit of each; name the key that is wrong."""
    values = {}
    for key, value in table.items():
        where = f"[{name}] {key} = {value!r}" if name else f"{key} = {value!r}"
        ask = keys.get(key, keys.get("*"))
        others = f"there are {', '.join(keys)}{meant(key, keys)}"
        require(ask, f"{where}: there is no such key; {others}")
        if isinstance(ask, dict):
            require(isinstance(value, dict), f"{where}: this is to be a table, [{key}]")
            values[key] = _values(value, ask, f"{name}.{key}".strip("."))
            continue
        try:
            values[key] = ask[1](value)
        except (KeyError, OverflowError, TypeError, ValueError) as error:
            raise ValueError(f"{where}: {ask[0]}") from error
    return values


def _need(words: dict[str, Any], name: str, keys: Iterable[str], why: str) -> None:
    for key in keys:
        require(key in words, f"[{name}] {key} is missing: {why}")


def _create_case(words: dict[str, Any]) -> Case:
    """Return the case that the values of a file make."""
    layers, surfaces = words.get("layers", {}), words.get("surfaces", {})
    require("mesh" in words, "mesh is missing: name a file, vessel or tube")
    require(layers, "name the layers of the wall and their materials, as [layers.media]")
    for name, layer in layers.items():
        _need(layer, f"layers.{name}", ["c"], "give a positive number in kPa")
        if any(key in layer for key in FIBRES):
            _need(layer, f"layers.{name}", FIBRES, "fibres need k1, k2 and angle")
    pressures = {name: s["pressure"] for name, s in surfaces.items() if "pressure" in s}
    conditions: dict[str, tuple[Condition, ...]] = {}
    for name, s in surfaces.items():
        direction = s.get("direction", "normal")
        share = [Pressure(s["pressure"] / max(pressures.values()))] if name in pressures else []
        spring = [Spring(s["spring"], direction)] if "spring" in s else []
        dashpot = [Dashpot(s["dashpot"], direction)] if "dashpot" in s else []
        hold = [Clamp() if s["hold"] == "clamp" else Slide()] if "hold" in s else []
        conditions[name] = (*share, *spring, *dashpot, *hold)
        message = f"[surfaces.{name}] has no effect: give it a pressure, spring, dashpot or hold"
        require(conditions[name], message)
        message = f"[surfaces.{name}] direction: has no effect without a spring or a dashpot"
        require(spring or dashpot or "direction" not in s, message)
    by_surface(conditions)  # nothing acts on a clamped surface
    cavities = words.get("cavity", {})
    for name, given in cavities.items():
        if "windkessel" in given:
            place, why = f"cavity.{name}.windkessel", "give a positive number"
            _need(given["windkessel"], place, ["resistance", "compliance"], why)
        one = "give a volume or a windkessel, one of them"
        require(("volume" in given) != ("windkessel" in given), f"[cavity.{name}]: {one}")
    has = "surfaces: name the surface under pressure, as [surfaces.lumen], or a cavity"
    require(pressures or cavities, has)
    if "prestretch" in words:
        _need(words["prestretch"], "prestretch", ["axis", "stretch"], "both are needed")
    return Case(
        mesh=words["mesh"],
        layers={name: Tissue(**layer) for name, layer in layers.items()},
        conditions=conditions,
        pressure=max(pressures.values(), default=0.0),
        scale=words.get("scale", 1.0),
        image=words.get("image", {}).get("pressure", 0.0),
        rate=words.get("loading", {}).get("rate"),
        fibres=words.get("fibres", {}),
        cavities={name: Filling(**given) for name, given in cavities.items()},
        **words.get("prestretch", {}),
    )
