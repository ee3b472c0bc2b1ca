# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What `demo_artery.py` computes: a wall, its materials, and conditions on its surfaces."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dolfinx_feti import materials
from dolfinx_feti.wall import Clamp, Pressure, Wall, free_motions, openings
from dolfinx_feti.wall.conditions import Condition
from dolfinx_feti.wall.fibres import ANGLES

__all__ = ["Case", "Tissue", "default_case", "meant"]


@dataclass(frozen=True, slots=True)
class Tissue:
    """The material of a layer.

    Attributes:
        c: Stiffness of the matrix material [kPa].
        k1: Stiffness of the fibres [kPa]; 0 for none.
        k2: Exponent of the fibres [-].
        angle: Of the fibres from the circumferential direction [degrees].
    """

    c: float
    k1: float = 0.0
    k2: float = 1.0
    angle: float = 0.0


@dataclass(frozen=True, slots=True)
class Case:
    """What the demo computes.

    Attributes:
        mesh: `vessel`, `tube`, or the path of a file.
        scale: Millimetres in the file's unit of length.
        layers: Their materials.
        conditions: Those on the surfaces.
        pressure: Where to arrive [mmHg].
        rate: By how much the pressure grows [mmHg/s]; None without dashpots.
        axis: Axis of the prestretch; None for none.
        stretch: The prestretch [-].
        fibres: Arguments of :func:`~dolfinx_feti.wall.fibres.fibre_frame`.
        source: The file, for messages.
    """

    mesh: str | Path
    layers: dict[str, Tissue]
    conditions: dict[str, tuple[Condition, ...]]
    pressure: float
    scale: float = 1.0
    rate: float | None = None
    axis: str | None = None
    stretch: float = 1.0
    fibres: dict[str, Any] = field(default_factory=dict)
    source: str = ""

    @property
    def description(self) -> str:
        """What makes the problem besides the mesh, for checkpoints: materials and conditions."""
        return repr((self.layers, self.conditions, self.rate, self.axis, self.stretch, self.fibres))

    @property
    def has_fibres(self) -> bool:
        """Whether a layer has fibres."""
        return any(tissue.k1 > 0.0 for tissue in self.layers.values())

    def check(self, wall: Wall) -> None:
        """Hold names and supports against the wall.

        Raises:
            ValueError: A name is wrong, a layer is missing, or nothing holds the wall.

        Note:
            Collective.
        """
        for table, given, there in (
            ("layers", self.layers, wall.layers),
            ("surfaces", self.conditions, wall.surfaces),
        ):
            for name in given:
                if name not in there:
                    raise ValueError(
                        f"{self.source}[{table}.{name}]: the wall has no {table[:-1]} {name!r}; "
                        f"it has {', '.join(there) or 'none'}{meant(name, there)}"
                    )
        for name in wall.layers:
            if name not in self.layers:
                raise ValueError(
                    f"{self.source}[layers.{name}] is missing: the wall has the layer {name!r}; "
                    "give its material"
                )
        free = free_motions(wall, self.conditions)
        if free:
            raise ValueError(
                f"{self.source}[surfaces]: nothing holds {free} of the wall's six rigid body "
                'motions; clamp a surface (hold = "clamp") or give it springs with direction = '
                '"all"'
            )


def default_case(wall: Wall, mesh: str | Path, *, c: float, pressure: float) -> Case:
    """Return the demo's own case: two layers of an artery, clamped openings.

    Args:
        wall: The wall.
        mesh: `vessel`, `tube`, or the path of a file.
        c: Stiffness of the matrix material [kPa].
        pressure: Where to arrive [mmHg].

    Raises:
        ValueError: The wall has other layers, or no lumen.
    """
    known = materials.ArteryParameters(c=c)
    unknown = [name for name in wall.layers if name not in ANGLES]
    if unknown:
        raise ValueError(
            f"The wall has the layer {unknown[0]!r}, whose material is not known: the demo knows "
            f"{' and '.join(ANGLES)}; give the materials in a file, --wall FILE.toml"
        )
    if "lumen" not in wall.surfaces:
        raise ValueError(
            f"The wall has no surface 'lumen' for the pressure; it has {', '.join(wall.surfaces)}: "
            "name the surface under pressure in a file, --wall FILE.toml"
        )
    return Case(
        mesh=mesh,
        layers={n: Tissue(known.c, known.k1, known.k2, ANGLES[n]) for n in wall.layers},
        conditions={"lumen": (Pressure(),)} | {name: (Clamp(),) for name in openings(wall)},
        pressure=pressure,
    )


def meant(word: str, known: Iterable[str]) -> str:
    """Ask whether a similar word was meant."""
    close = difflib.get_close_matches(word, list(known), n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""
