# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A case in one TOML file: mesh, layers, surfaces, fibres, prestretch, image and loading.

`docs/cases.md` explains the keys, and `demos/wall.toml` is an example. A number is in the first
unit of its key; a text such as ``"13 kPa"`` may have another one (``casekeys``).
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfinx_feti.mechanics.values import require_not_negative, require_positive, require_within
from dolfinx_feti.runtime.collective import on_root
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
from dolfinx_feti.wall.conditions.condition import Condition
from dolfinx_feti.wall.conditions.pressure import Pressure
from dolfinx_feti.wall.conditions.registry import by_surface, case_keys, conditions_in_case
from dolfinx_feti.wall.conditions.supports import Dashpot
from dolfinx_feti.wall.wall import AXES, Wall

__all__ = ["Case", "Filling", "LayerMaterial", "read_case"]


@dataclass(frozen=True, slots=True)
class LayerMaterial:
    """Material of a layer, and its residual stress."""

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
        require_within(-360.0, 360.0, {"opening_angle": self.opening_angle}, includes_ends=False)


@dataclass(frozen=True, slots=True)
class Filling:
    """The fluid in a cavity: a prescribed volume, or a Windkessel into which the fluid flows.

    The pressure of the cavity is an unknown.
    """

    volume: float | None = None  #: Enclosed volume [mm³]
    #: Resistance [kPa s/mm³], compliance [mm³/kPa], and optionally impedance [kPa s/mm³]
    windkessel: dict[str, float] = field(default_factory=dict)
    axis: str | None = None  #: Axis of a tube with open ends; None for a closed surface

    def __post_init__(self) -> None:
        """Check the values."""
        _require_one(has_volume=self.volume is not None, has_windkessel=bool(self.windkessel))
        if self.volume is not None:
            require_positive(volume=self.volume)
        if self.windkessel:
            parameters = dict(self.windkessel)
            require_not_negative(impedance=parameters.pop("impedance", 0.0))
            if set(parameters) != {"resistance", "compliance"}:
                raise ValueError(
                    f"windkessel={self.windkessel}: give a resistance, a compliance, and perhaps "
                    "an impedance"
                )
            require_positive(**parameters)
        _check_axis(self.axis)


@dataclass(frozen=True, slots=True)
class Case:
    """A wall under pressure, or with cavities that are filled."""

    mesh: str  #: Name of the mesh, as in the file
    layers: dict[str, LayerMaterial]  #: Materials of the layers
    #: Conditions by surface; the largest share of a pressure is 1
    conditions: dict[str, tuple[Condition, ...]]
    pressure: float  #: Target [mmHg]; 0 if all pressures are those of cavities
    scale: float = 1.0  #: Millimetres in the mesh's unit of length
    image: float = 0.0  #: Pressure in the wall when its mesh was imaged [mmHg]; 0 at rest
    rate: float | None = None  #: Rate of the pressure [mmHg/s]; None without dashpots
    axis: str | None = None  #: Axis of the prestretch; None for none
    stretch: float = 1.0  #: The prestretch [-]
    #: Keyword arguments of ``fibre_frame``: inner, outer, ends, inlet
    fibres: dict[str, Any] = field(default_factory=dict)
    cavities: dict[str, Filling] = field(default_factory=dict)  #: Fillings by surface

    def __post_init__(self) -> None:
        """Check the values, and that each has an effect."""
        require_positive(scale=self.scale, stretch=self.stretch)
        require_not_negative(image=self.image)
        _check_axis(self.axis)
        if self.axis is None and self.stretch != 1.0:
            raise ValueError(f"stretch={self.stretch}: has no effect without an axis")
        self._check_pressure()
        self._check_rate()

    def _check_pressure(self) -> None:
        """Check the pressure, and that no cavity has the surface of a pressure."""
        if self.pressure or not self.cavities:
            require_positive(pressure=self.pressure)
        surfaces_under_pressure = self._surfaces_with(Pressure)
        if self.pressure and not surfaces_under_pressure:
            raise ValueError(
                f"pressure={self.pressure}: has no effect without a surface under pressure"
            )
        for name in self.cavities:
            if name in surfaces_under_pressure:
                raise ValueError(
                    f"[surfaces.{name}] pressure: leave it out, [cavity.{name}] determines it"
                )

    def _check_rate(self) -> None:
        """Check that there is a rate of the pressure if and only if dashpots need it."""
        if self.rate is not None:
            require_positive(rate=self.rate)
        needs_rate = self.pressure > 0.0 and bool(self._surfaces_with(Dashpot))
        if needs_rate and self.rate is None:
            raise ValueError(
                "[loading] rate is missing: dashpots need the rate of the pressure [mmHg/s]"
            )
        if self.rate is not None and not needs_rate:
            raise ValueError(
                f"[loading] rate = {self.rate}: has no effect without a dashpot and a pressure"
            )

    def _surfaces_with(self, kind: type) -> set[str]:
        """Return the names of the surfaces that have a condition of a kind."""
        return {
            name
            for name, conditions in self.conditions.items()
            if any(isinstance(condition, kind) for condition in conditions)
        }

    @property
    def has_residual_stress(self) -> bool:
        """Whether a layer opens, or becomes shorter, when it is cut out."""
        return any(t.opening_angle or t.axial_stretch != 1.0 for t in self.layers.values())

    def check(self, wall: Wall) -> None:
        """Check the names of layers and surfaces against those of the wall.

        Raises:
            ValueError: The wall has no layer or surface of a name, or the case omits a layer.
        """
        _check_names("layers", "layer", self.layers, wall.layers)
        _check_names("surfaces", "surface", self.conditions, wall.surfaces)
        _check_names("cavity", "surface", self.cavities, wall.surfaces)
        for name in wall.layers:
            if name not in self.layers:
                raise ValueError(f"[layers.{name}] is missing: give the layer's material")


def _require_one(*, has_volume: bool, has_windkessel: bool) -> None:
    """Raise a ValueError unless exactly one of volume and Windkessel is given."""
    if has_volume and has_windkessel:
        raise ValueError("give a volume or a windkessel, not both")
    if not has_volume and not has_windkessel:
        raise ValueError("give a volume or a windkessel")


def _check_axis(axis: str | None) -> None:
    """Raise a ValueError if an axis is none of ``AXES`` and not None."""
    if axis not in (None, *AXES):
        raise ValueError(f"axis={axis!r}: choose 'x', 'y', 'z' or None")


def _check_names(table: str, kind: str, names: Iterable[str], of_wall: Iterable[str]) -> None:
    """Raise a ValueError for the first name of a table that the wall does not have.

    Args:
        table: Table of the file, for the message.
        kind: ``layer`` or ``surface``, for the message.
        names: Names in the table.
        of_wall: Names of the wall.
    """
    for name in names:
        if name not in of_wall:
            raise ValueError(
                f"[{table}.{name}]: the wall has no {kind} {name!r}; it has "
                f"{', '.join(of_wall) or 'none'}{_suggestion(name, of_wall)}"
            )


def _suggestion(word: str, choices: Iterable[str]) -> str:
    """Return a question for the most similar choice, or an empty text if none is similar."""
    similar = difflib.get_close_matches(word, list(choices), n=1)
    return f" (did you mean {similar[0]!r}?)" if similar else ""


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
                f"{where}: there is no such key; there are {', '.join(keys)}"
                f"{_suggestion(key, keys)}"
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
    conditions = {
        name: conditions_in_case(name, surface, highest_pressure)
        for name, surface in surfaces.items()
    }
    by_surface(conditions)  # raises an error for other conditions on a clamped surface
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
        image=values.get("image", {}).get("pressure", 0.0),
        rate=values.get("loading", {}).get("rate"),
        fibres=values.get("fibres", {}),
        cavities=cavities,
        axis=prestretch.get("axis"),
        stretch=prestretch.get("stretch", 1.0),
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
            _require_one(has_volume="volume" in table, has_windkessel="windkessel" in table)
            fillings[name] = Filling(**table)
        except ValueError as error:
            raise ValueError(f"[cavity.{name}]: {error}") from error
    return fillings
