# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A case in one TOML file: mesh, layers, surfaces, fibres, prestretch, image and loading.

`docs/cases.md` explains the keys, and `demos/wall.toml` is an example. A number is in the first
unit of its key; a text such as ``"13 kPa"`` may have another one (``casekeys``).
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfinx_feti.runtime.collective import on_root
from dolfinx_feti.wall.case import (
    Case,
    Filling,
    LayerMaterial,
    require_volume_or_windkessel,
    suggestion,
)
from dolfinx_feti.wall.casekeys import (
    DEGREES,
    MAX_OPENING_ANGLE,
    MMHG_PER_KPA,
    NUMBER,
    PRESSURE,
    RATE,
    STIFFNESS,
    ChoiceKey,
    Keys,
    NumberKey,
    TextKey,
    TextListKey,
)
from dolfinx_feti.wall.conditions.registry import case_keys, checked_conditions, conditions_in_case
from dolfinx_feti.wall.wall import AXES

__all__ = ["read_case"]

#: Keys of a layer. The fibres need all of k1, k2 and angle; see :data:`FIBRES`.
LAYER: Keys = {
    "c": STIFFNESS,
    "k1": STIFFNESS,
    "k2": NUMBER,
    "angle": NumberKey(DEGREES, 0.0, 90.0),
    "opening_angle": NumberKey(DEGREES, -MAX_OPENING_ANGLE, MAX_OPENING_ANGLE),
    "axial_stretch": NUMBER,
}

#: Keys of a layer with fibres: all or none of them are given.
FIBRES = ("k1", "k2", "angle")

#: Resistance and impedance of a Windkessel. A mmHg s/ml is 1/7.5 kPa s for 1000 mm³.
RESISTANCE = NumberKey({"kPa s/mm³": 1.0, "mmHg s/ml": 1e-3 / MMHG_PER_KPA})

#: Compliance of a Windkessel. A ml/mmHg is 1000 mm³ for 1/7.5 kPa.
COMPLIANCE = NumberKey({"mm³/kPa": 1.0, "ml/mmHg": 1e3 * MMHG_PER_KPA})

#: Keys of a cavity.
CAVITY: Keys = {
    "volume": NumberKey({"mm³": 1.0, "ml": 1e3}),
    "axis": ChoiceKey(tuple(AXES)),
    "windkessel": {"resistance": RESISTANCE, "compliance": COMPLIANCE, "impedance": RESISTANCE},
}

#: All keys of a file; ``*`` is the name of any layer or surface.
KEYS: Keys = {
    "mesh": TextKey(),
    "scale": NUMBER,
    "layers": {"*": LAYER},
    "surfaces": {"*": case_keys()},
    "cavity": {"*": CAVITY},
    "image": {"pressure": PRESSURE},
    "fibres": {"inner": TextKey(), "outer": TextKey(), "ends": TextListKey(), "inlet": TextKey()},
    "prestretch": {"axis": ChoiceKey(tuple(AXES)), "stretch": NUMBER},
    "loading": {"rate": RATE},
}


def read_case(path: Path | str, comm: MPI.Comm) -> Case:
    """Read a case on the first process, for all (docs/cases.md). Collective.

    Args:
        path: The TOML file.
        comm: Communicator of the wall.

    Raises:
        OSError: The file cannot be read.
        ValueError: The file is not TOML, or a key or a value in it is wrong.
    """
    return on_root(lambda: _read_case(Path(path)), comm)


def _read_case(path: Path) -> Case:
    """Read a case on one process."""
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise FileNotFoundError(f"There is no file {path}: name a TOML file") from error
    except (ValueError, RecursionError) as error:  # neither TOML nor text
        raise ValueError(f"{path} is no TOML file: {error}") from error
    try:
        return _create_case(_read_values(content, KEYS))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _read_values(table: dict[str, Any], keys: Keys, name: str = "") -> dict[str, Any]:
    """Return the values of a table in the first unit of each.

    Args:
        table: A table of the file, with its tables inside.
        keys: The keys that it may have.
        name: Name of the table, for messages; empty for the file.

    Raises:
        ValueError: A key does not exist, or its value is wrong.
    """
    values = {}
    for key, value in table.items():
        where = f"[{name}] {key} = {value!r}" if name else f"{key} = {value!r}"
        expected = keys.get(key, keys.get("*"))
        if expected is None:
            raise ValueError(
                f"{where}: there is no such key; there are {', '.join(keys)}{suggestion(key, keys)}"
            )
        if isinstance(expected, Mapping):
            if not isinstance(value, dict):
                raise ValueError(f"{where}: give a table, [{key}]")
            values[key] = _read_values(value, expected, f"{name}.{key}".strip("."))
            continue
        try:
            values[key] = expected.read(value)
        except (KeyError, OverflowError, TypeError, ValueError) as error:
            raise ValueError(f"{where}: {expected.remedy}") from error
    return values


def _require_keys(table: dict[str, Any], name: str, keys: Iterable[str], remedy: str) -> None:
    """Raise a ValueError for the first key that a table lacks."""
    for key in keys:
        if key not in table:
            raise ValueError(f"[{name}] {key} is missing: {remedy}")


def _create_case(values: dict[str, Any]) -> Case:
    """Return the case of a file.

    Args:
        values: The values of all keys, in the first unit of each.

    Raises:
        ValueError: A key is missing, has no effect, or contradicts another one.
    """
    if "mesh" not in values:
        raise ValueError(
            "mesh is missing: name a file, or one of the generated walls, 'vessel' or 'tube'"
        )
    layers = _create_layers(values.get("layers", {}))
    surfaces: dict[str, dict[str, Any]] = values.get("surfaces", {})
    pressures = [surface["pressure"] for surface in surfaces.values() if "pressure" in surface]
    highest_pressure = max(pressures, default=0.0)
    listed = {
        name: conditions_in_case(name, surface, highest_pressure)
        for name, surface in surfaces.items()
    }
    conditions = checked_conditions(listed)
    cavities = _create_fillings(values.get("cavity", {}))
    if not pressures and not cavities:
        raise ValueError(
            "surfaces: name the surface under pressure, as [surfaces.lumen], or a cavity"
        )
    prestretch: dict[str, Any] = values.get("prestretch", {})
    if "prestretch" in values:
        _require_keys(prestretch, "prestretch", ["axis", "stretch"], "both are needed")
    return Case(
        mesh=values["mesh"],
        layers=layers,
        conditions=conditions,
        pressure=highest_pressure,
        scale=values.get("scale", 1.0),
        image_pressure=values.get("image", {}).get("pressure", 0.0),
        rate=values.get("loading", {}).get("rate"),
        fibres=values.get("fibres", {}),
        cavities=cavities,
        prestretch_axis=prestretch.get("axis"),
        prestretch=prestretch.get("stretch", 1.0),
    )


def _create_layers(tables: dict[str, dict[str, float]]) -> dict[str, LayerMaterial]:
    """Return the materials of the tables ``[layers.…]``."""
    if not tables:
        raise ValueError("name the layers of the wall and their materials, as [layers.media]")
    layers = {}
    for name, table in tables.items():
        _require_keys(table, f"layers.{name}", ["c"], "give a positive number in kPa")
        if any(key in table for key in FIBRES):
            _require_keys(table, f"layers.{name}", FIBRES, "fibres need k1, k2 and angle")
        layers[name] = LayerMaterial(**table)
    return layers


def _create_fillings(tables: dict[str, dict[str, Any]]) -> dict[str, Filling]:
    """Return the fillings of the tables ``[cavity.…]``."""
    fillings = {}
    for name, table in tables.items():
        try:
            # an empty table [cavity.NAME.windkessel] counts as given here; Filling cannot see it
            require_volume_or_windkessel(
                has_volume="volume" in table, has_windkessel="windkessel" in table
            )
            fillings[name] = Filling(**table)
        except ValueError as error:
            raise ValueError(f"[cavity.{name}]: {error}") from error
    return fillings
