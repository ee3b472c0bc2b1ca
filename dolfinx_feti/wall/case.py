# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A wall and its load: materials of its layers, conditions on its surfaces, and its cavities."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from dolfinx_feti.mechanics.values import require_not_negative, require_positive, require_within
from dolfinx_feti.wall.conditions import Condition, Dashpot, Pressure
from dolfinx_feti.wall.wall import AXES, Wall

__all__ = ["Case", "Filling", "Tissue", "meant", "require"]


@dataclass(frozen=True, slots=True)
class Tissue:
    """The material of a layer.

    Attributes:
        c: Stiffness of the matrix material [kPa].
        k1: Stiffness of the fibres [kPa]; 0 for none.
        k2: Exponent of the fibres [-].
        angle: Of the fibres from the circumferential direction in the wall as meshed [degrees].
        opening_angle: By which the layer opens when it is cut [degrees].
        axial_stretch: Its prestretch along the vessel [-].
    """

    c: float
    k1: float = 0.0
    k2: float = 1.0
    angle: float = 0.0
    opening_angle: float = 0.0
    axial_stretch: float = 1.0

    def __post_init__(self) -> None:
        """Check the values."""
        require_positive(c=self.c, k2=self.k2, axial_stretch=self.axial_stretch)
        require_not_negative(k1=self.k1)
        require_within(0.0, 90.0, {"angle": self.angle})
        require_within(-360.0, 360.0, {"opening_angle": self.opening_angle}, ends=False)


@dataclass(frozen=True, slots=True)
class Filling:
    """What governs the volume of a cavity, whose pressure is an unknown: one of the first two.

    Attributes:
        volume: To be enclosed [mm³].
        windkessel: Its resistance [kPa s/mm³], compliance [mm³/kPa], and perhaps impedance.
        axis: That of a tube with open ends, ``"x"``, ``"y"`` or ``"z"``; None for a closed surface.
    """

    volume: float | None = None
    windkessel: dict[str, float] = field(default_factory=dict)
    axis: str | None = None

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
            require(set(vessels) == {"resistance", "compliance"}, has)
            require_positive(**vessels)
        require(self.axis in (None, *AXES), f"axis={self.axis!r}: choose 'x', 'y', 'z' or None")


@dataclass(frozen=True, slots=True)
class Case:
    """A wall under pressure, or with cavities that are filled.

    Attributes:
        mesh: Name of the mesh, as in the file.
        layers: Their materials.
        conditions: Those on the surfaces; the largest share of the pressure is 1.
        pressure: Where to arrive [mmHg]; 0 where all pressures are those of cavities.
        scale: Millimetres in the mesh's unit of length.
        image: The pressure under which the wall has the shape of the mesh [mmHg]; 0 at rest.
        rate: By how much the pressure grows [mmHg/s]; None without dashpots.
        axis: Axis of the prestretch; None for none.
        stretch: The prestretch [-].
        fibres: Arguments of :func:`~dolfinx_feti.wall.fibres.fibre_frame`.
        cavities: What fills them, by the name of their surface.
    """

    mesh: str
    layers: dict[str, Tissue]
    conditions: dict[str, tuple[Condition, ...]]
    pressure: float
    scale: float = 1.0
    image: float = 0.0
    rate: float | None = None
    axis: str | None = None
    stretch: float = 1.0
    fibres: dict[str, Any] = field(default_factory=dict)
    cavities: dict[str, Filling] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the values."""
        require_positive(scale=self.scale, stretch=self.stretch)
        if self.pressure or not self.cavities:
            require_positive(pressure=self.pressure)
        loaded = {
            name
            for name, given in self.conditions.items()
            for c in given
            if isinstance(c, Pressure)
        }
        has = f"pressure={self.pressure}: has no effect without a surface under pressure"
        require(loaded or not self.pressure, has)
        require_not_negative(image=self.image)
        if self.rate is not None:
            require_positive(rate=self.rate)
        require(self.axis in (None, *AXES), f"axis={self.axis!r}: choose 'x', 'y', 'z' or None")
        has = f"stretch={self.stretch}: has no effect without an axis"
        require(self.axis or self.stretch == 1.0, has)
        for name in self.cavities:
            has = f"[surfaces.{name}] pressure: leave it out, [cavity.{name}] determines it"
            require(name not in loaded, has)
        dashpots = self.pressure > 0.0 and any(
            isinstance(c, Dashpot) for given in self.conditions.values() for c in given
        )
        missing = "[loading] rate is missing: dashpots need the rate of the pressure [mmHg/s]"
        require(self.rate or not dashpots, missing)
        has = f"[loading] rate = {self.rate}: has no effect without a dashpot and a pressure"
        require(dashpots or self.rate is None, has)

    @property
    def has_residual_stress(self) -> bool:
        """Whether a layer opens, or becomes shorter, when it is cut out."""
        return any(t.opening_angle or t.axial_stretch != 1.0 for t in self.layers.values())

    def check(self, wall: Wall) -> None:
        """Compare names with those of the wall.

        Raises:
            ValueError: A name is wrong, or a layer is missing.
        """
        for kind, given, known in (
            ("layer", self.layers, wall.layers),
            ("surface", self.conditions, wall.surfaces),
            ("surface", self.cavities, wall.surfaces),
        ):
            table = "cavity" if given is self.cavities else f"{kind}s"
            for name in given:
                has = f"it has {', '.join(known) or 'none'}{meant(name, known)}"
                require(name in known, f"[{table}.{name}]: the wall has no {kind} {name!r}; {has}")
        for name in wall.layers:
            require(name in self.layers, f"[layers.{name}] is missing: give the layer's material")


def require(holds: object, message: str) -> None:
    """Raise a ValueError unless a condition holds."""
    if not holds:
        raise ValueError(message)


def meant(word: str, known: Iterable[str]) -> str:
    """Ask whether a similar word was meant."""
    close = difflib.get_close_matches(word, list(known), n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""
