# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Keys of a case in TOML: the kind of value, its units and its bounds.

A number is in the first unit of its key; a text of a number and a unit, such as ``"13 kPa"``, is
converted to the first unit.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

from dolfinx_feti.mechanics.loads import mmhg

__all__ = [
    "DEGREES",
    "MAX_OPENING_ANGLE",
    "MMHG_PER_KPA",
    "NUMBER",
    "PRESSURE",
    "RATE",
    "STIFFNESS",
    "ChoiceKey",
    "Key",
    "Keys",
    "NumberKey",
    "TextKey",
    "TextListKey",
]

#: Millimetres of mercury in one kPa: 7.5006.
MMHG_PER_KPA = 1.0 / mmhg(1.0)

#: Largest opening angle in a case [degrees]. A full turn opens no ring, and is refused by the
#: equations of residual stress; whole degrees are enough for a file.
MAX_OPENING_ANGLE = 359.0

#: The smallest normal number above zero: the bound of a positive number.
SMALLEST_POSITIVE = sys.float_info.min


class Key(Protocol):
    """The kind of value that a key of the file has."""

    @property
    def remedy(self) -> str:
        """What to give instead of a wrong value, for a message."""
        ...

    def read(self, value: Any) -> Any:
        """Return the value in the first unit.

        Raises:
            KeyError: The unit is unknown.
            TypeError: The value is of another type.
            ValueError: The value is out of bounds, or is no number.
        """
        ...


#: The keys of a table by name; a mapping inside describes a table inside.
Keys: TypeAlias = Mapping[str, "Key | Keys"]


@dataclass(frozen=True, slots=True)
class NumberKey:
    """A number in the first unit, or a text of a number and a unit such as ``"13 kPa"``."""

    units: dict[str, float]  #: Units, and what one of each is in the first unit
    lowest: float = SMALLEST_POSITIVE  #: In the first unit
    highest: float = sys.float_info.max  #: In the first unit

    @property
    def remedy(self) -> str:
        """What to give instead of a wrong value."""
        if self.lowest > 0.0:
            bounds = "a positive number"
        else:
            bounds = f"a number from {self.lowest:g} to {self.highest:g}"
        first = next(iter(self.units))
        if not first:
            return f"give {bounds}"
        return f"give {bounds} in {first}, or a text such as '2 {first}' in {', '.join(self.units)}"

    def read(self, value: Any) -> float:
        """Return the number in the first unit."""
        first = next(iter(self.units))
        text = value if isinstance(value, str) else f"{value} {first}"
        digits, _, unit = text.strip().partition(" ")
        number = float(digits) * self.units[unit.strip()]
        if not self.lowest <= number <= self.highest:
            raise ValueError("out of bounds")
        return number


@dataclass(frozen=True, slots=True)
class ChoiceKey:
    """One of several texts."""

    choices: tuple[str, ...]

    @property
    def remedy(self) -> str:
        """What to give instead of a wrong value."""
        return f"choose one of {', '.join(map(repr, self.choices))}"

    def read(self, value: Any) -> str:
        """Return the text."""
        if value not in self.choices:
            raise ValueError("no such choice")
        return str(value)


@dataclass(frozen=True, slots=True)
class TextKey:
    """Any text."""

    remedy: str = 'give a text, in quotation marks, as in mesh = "wall.msh"'

    def read(self, value: Any) -> str:
        """Return the text."""
        if not isinstance(value, str):
            raise TypeError("no text")
        return value


@dataclass(frozen=True, slots=True)
class TextListKey:
    """A list of texts."""

    remedy: str = 'give a list of texts, as ["opening_1", "opening_2"]'

    def read(self, value: Any) -> list[str]:
        """Return the list."""
        if not isinstance(value, list) or not all(isinstance(text, str) for text in value):
            raise TypeError("no list of texts")
        return value


#: A positive number without a unit.
NUMBER = NumberKey({"": 1.0})

#: Stiffness of a material.
STIFFNESS = NumberKey({"kPa": 1.0, "Pa": 1e-3, "MPa": 1e3})

#: Pressure, in mmHg as clinicians measure it.
PRESSURE = NumberKey({"mmHg": 1.0, "kPa": MMHG_PER_KPA, "Pa": 1e-3 * MMHG_PER_KPA})

#: Rate of a pressure.
RATE = NumberKey({"mmHg/s": 1.0, "kPa/s": MMHG_PER_KPA})

#: Units of angles.
DEGREES = {"degrees": 1.0, "rad": 180.0 / math.pi}
