# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A case: a wall with materials, conditions, cavities and a pressure, without contradictions."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from dolfinx_feti.runtime.values import require_not_negative, require_positive, require_within
from dolfinx_feti.wall.conditions.condition import Condition
from dolfinx_feti.wall.conditions.pressure import Pressure
from dolfinx_feti.wall.conditions.supports import Dashpot
from dolfinx_feti.wall.wall import AXES, Wall

__all__ = ["Case", "Filling", "LayerMaterial", "require_volume_or_windkessel", "suggestion"]


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
        require_volume_or_windkessel(
            has_volume=self.volume is not None, has_windkessel=bool(self.windkessel)
        )
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
        _check_axis("axis", self.axis)


@dataclass(frozen=True, slots=True)
class Case:
    """A wall under pressure, or with cavities that are filled."""

    mesh: str  #: Name of the mesh, as in the file
    layers: dict[str, LayerMaterial]  #: Materials of the layers
    #: Conditions by surface; the largest share of a pressure is 1
    conditions: dict[str, tuple[Condition, ...]]
    pressure: float  #: Target [mmHg]; 0 if only cavities have a pressure
    scale: float = 1.0  #: Millimetres in the mesh's unit of length
    image_pressure: float = 0.0  #: Pressure in the wall when it was imaged [mmHg]; 0 at rest
    rate: float | None = None  #: Rate of the pressure [mmHg/s]; None without dashpots
    prestretch_axis: str | None = None  #: ``"x"``, ``"y"`` or ``"z"``; None without a prestretch
    prestretch: float = 1.0  #: Axial prestretch [-]
    #: Keyword arguments of ``fibre_frame``: inner, outer, ends, inlet
    fibres: dict[str, Any] = field(default_factory=dict)
    cavities: dict[str, Filling] = field(default_factory=dict)  #: Fillings by surface

    def __post_init__(self) -> None:
        """Check the values, and that each has an effect."""
        require_positive(scale=self.scale, prestretch=self.prestretch)
        require_not_negative(image_pressure=self.image_pressure)
        _check_axis("prestretch_axis", self.prestretch_axis)
        if self.prestretch_axis is None and self.prestretch != 1.0:
            raise ValueError(f"prestretch={self.prestretch}: has no effect without an axis")
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

    def _surfaces_with(self, kind: type[Condition]) -> set[str]:
        """Return the names of the surfaces that have a condition of a kind, such as Pressure."""
        return {
            name
            for name, conditions in self.conditions.items()
            if any(isinstance(condition, kind) for condition in conditions)
        }

    @property
    def has_residual_stress(self) -> bool:
        """Whether a layer opens, or becomes shorter, when it is cut out."""
        return any(
            layer.opening_angle != 0.0 or layer.axial_stretch != 1.0
            for layer in self.layers.values()
        )

    def check(self, wall: Wall) -> None:
        """Check that the wall has all layers and surfaces of the case, and no other layers.

        Raises:
            ValueError: The wall has no layer or surface of a name, or the case omits a layer.
        """
        _check_names("layers", "layer", self.layers, wall.layers)
        _check_names("surfaces", "surface", self.conditions, wall.surfaces)
        _check_names("cavity", "surface", self.cavities, wall.surfaces)
        for name in wall.layers:
            if name not in self.layers:
                raise ValueError(f"[layers.{name}] is missing: give the layer's material")


def require_volume_or_windkessel(*, has_volume: bool, has_windkessel: bool) -> None:
    """Raise a ValueError unless exactly one of volume and Windkessel is given."""
    if has_volume and has_windkessel:
        raise ValueError("give a volume or a windkessel, not both")
    if not has_volume and not has_windkessel:
        raise ValueError("give a volume or a windkessel")


def _check_axis(name: str, axis: str | None) -> None:
    """Raise a ValueError, which names the argument, if an axis is none of ``AXES`` and not None."""
    if axis not in (None, *AXES):
        raise ValueError(f"{name}={axis!r}: choose 'x', 'y', 'z' or None")


def _check_names(table: str, part: str, names: Iterable[str], of_wall: Iterable[str]) -> None:
    """Raise a ValueError for the first name of a table that the wall does not have.

    Args:
        table: Table of the file, for the message.
        part: ``layer`` or ``surface``, for the message.
        names: Names in the table.
        of_wall: Names of the wall.
    """
    for name in names:
        if name not in of_wall:
            raise ValueError(
                f"[{table}.{name}]: the wall has no {part} {name!r}; it has "
                f"{', '.join(of_wall) or 'none'}{suggestion(name, of_wall)}"
            )


def suggestion(word: str, choices: Iterable[str]) -> str:
    """Return a question for the most similar choice, or an empty text if none is similar."""
    similar = difflib.get_close_matches(word, list(choices), n=1)
    return f" (did you mean {similar[0]!r}?)" if similar else ""
