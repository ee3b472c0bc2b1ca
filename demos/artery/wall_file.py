# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A case of `demo_artery.py` in one TOML file: mesh, layers, and conditions on surfaces.

`docs/walls.md` explains the keys, and `demos/wall.toml` is an example. A number is in the unit that
stands first in :data:`UNITS`; a text such as "13 kPa" may have another one of the row.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from mpi4py import MPI

from artery.case import Case, Tissue, meant
from dolfinx_feti import loads
from dolfinx_feti.collective import on_first
from dolfinx_feti.wall import Clamp, Dashpot, Pressure, Slide, Spring
from dolfinx_feti.wall.conditions import Condition
from meshes.walls import CREATE

__all__ = ["UNITS", "read_case"]

MMHG = 1.0 / loads.mmhg(1.0)  # of a kPa

#: Units of each quantity, and how many of the first one each of them is.
UNITS = {
    "pressure": {"mmHg": 1.0, "kPa": MMHG, "Pa": 1e-3 * MMHG},
    "stiffness": {"kPa": 1.0, "Pa": 1e-3, "MPa": 1e3},
    "spring": {"kPa/mm": 1.0, "kPa/cm": 0.1, "kPa/m": 1e-3, "Pa/mm": 1e-3, "Pa/m": 1e-6},
    "dashpot": {"kPa s/mm": 1.0, "kPa s/cm": 0.1, "kPa s/m": 1e-3, "Pa s/mm": 1e-3, "Pa s/m": 1e-6},
    "rate": {"mmHg/s": 1.0, "kPa/s": MMHG},
    "angle": {"degrees": 1.0, "rad": 180.0 / math.pi},
    "number": {"": 1.0},
}

HOLD = {"clamp": Clamp(), "slide": Slide()}


def read_case(path: Path, comm: MPI.Comm) -> Case:
    """Read a case.

    Args:
        path: The file.
        comm: Communicator; the first process reads.

    Raises:
        OSError: The file cannot be read.
        ValueError: It is no TOML, or a key or a value in it is wrong.

    Note:
        Collective; raises on all processes.
    """
    return on_first(lambda: _read(path), comm)


def _read(path: Path) -> Case:
    """Read a case on one process."""
    try:
        words = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise FileNotFoundError(f"There is no file {path}: give --wall a TOML file") from error
    except ValueError as error:  # neither TOML nor text
        raise ValueError(f"{path} is no TOML file: {error}") from error
    top = _Table(f"{path}: ", "", words)
    top.allow("mesh", "scale", "layers", "surfaces", "fibres", "prestretch", "loading")
    mesh = top.text("mesh")
    pressures: dict[str, float] = {}
    conditions: dict[str, tuple[Condition, ...]] = {}
    for name in top.names("surfaces"):
        table = top.table("surfaces").table(name)
        found = _conditions(table)
        if "pressure" in table.words:
            pressures[name] = table.number("pressure", "pressure")
        if not found and name not in pressures:
            table.fail("", "holds nothing: give it a pressure, spring, dashpot or hold")
        conditions[name] = found
    if not pressures:
        top.fail("surfaces", "name the surface under pressure, such as [surfaces.lumen]")
    most = max(pressures.values())
    for name, pressure in pressures.items():
        conditions[name] = (Pressure(pressure / most), *conditions[name])
    loading, dashpots = top.table("loading"), any(map(_has_dashpot, conditions.values()))
    loading.allow("rate")
    if dashpots and "rate" not in loading.words:
        loading.fail("rate", "is missing: dashpots need the rate of the pressure [mmHg/s]")
    prestretch, fibres = top.table("prestretch"), top.table("fibres")
    prestretch.allow("axis", "stretch")
    fibres.allow("inner", "outer", "ends", "inlet")
    layers = {name: _tissue(top.table("layers").table(name)) for name in top.names("layers")}
    if not layers:
        top.fail("layers", "name the layers of the wall and their materials, as [layers.media]")
    return Case(
        mesh=mesh if mesh in CREATE else path.parent / mesh,
        scale=top.number("scale", default=1.0),
        layers=layers,
        conditions=conditions,
        pressure=most,
        rate=loading.number("rate", "rate") if dashpots else None,
        axis=prestretch.choice("axis", "xyz") if prestretch.words else None,
        stretch=_stretch(prestretch) if prestretch.words else 1.0,
        fibres={
            **{key: fibres.text(key) for key in ("inner", "outer", "inlet") if key in fibres.words},
            **({"ends": fibres.texts("ends")} if "ends" in fibres.words else {}),
        },
        source=f"{path}: ",
    )


def _conditions(table: _Table) -> tuple[Condition, ...]:
    """Read the conditions of a surface but its pressure."""
    table.allow("pressure", "spring", "dashpot", "direction", "hold")
    direction = table.choice("direction", ("normal", "all"), default="normal")
    found: list[Condition] = []
    if "spring" in table.words:
        found.append(Spring(table.number("spring", "spring"), direction))
    if "dashpot" in table.words:
        found.append(Dashpot(table.number("dashpot", "dashpot"), direction))
    if "direction" in table.words and not found:
        table.fail("direction", "has no effect without a spring or a dashpot: leave it out")
    if "hold" in table.words:
        hold = table.choice("hold", HOLD)
        if hold == "clamp" and len(table.words) > 1:
            table.fail("hold", "nothing else has an effect on a surface that is clamped")
        found.append(HOLD[hold])
    return tuple(found)


def _tissue(table: _Table) -> Tissue:
    """Read the material of a layer."""
    table.allow("c", "k1", "k2", "angle")
    fibres = ("k1", "k2", "angle")
    given = [key for key in fibres if key in table.words]
    for key in fibres:
        if given and key not in given:
            table.fail(key, f"is missing: fibres need {', '.join(fibres)}; without any, no fibres")
    c = table.number("c", "stiffness")
    if not given:
        return Tissue(c)
    return Tissue(
        c,
        table.number("k1", "stiffness"),
        table.number("k2"),
        table.number("angle", "angle", least=0.0, most=90.0),
    )


def _stretch(table: _Table) -> float:
    """Read a prestretch."""
    stretch = table.number("stretch")
    if abs(stretch - 1.0) < 1e-3:
        table.fail("stretch", "this is no prestretch: leave the table out")
    return stretch


def _has_dashpot(conditions: Iterable[Condition]) -> bool:
    return any(isinstance(condition, Dashpot) for condition in conditions)


@dataclass(frozen=True, slots=True)
class _Table:
    """A table of the file, with errors that name file, table, key and value."""

    source: str
    name: str
    words: Mapping[str, Any]

    def fail(self, key: str, what: str) -> NoReturn:
        """Raise a ValueError about a key."""
        where = f"[{self.name}] " if self.name else ""
        value = f"{key} = {self.words[key]!r}: " if key in self.words else f"{key} " * bool(key)
        raise ValueError(f"{self.source}{where}{value}{what}")

    def allow(self, *keys: str) -> None:
        """Refuse other keys."""
        for key in self.words:
            if key not in keys:
                self.fail(
                    key, f"there is no such key; there are {', '.join(keys)}" + meant(key, keys)
                )

    def names(self, key: str) -> list[str]:
        """Return the names of the tables in a table."""
        return list(self.table(key).words)

    def table(self, key: str) -> _Table:
        """Return a table in this one, an empty one if it is not there."""
        words = self.words.get(key, {})
        if not isinstance(words, dict):
            self.fail(key, "this is to be a table: put its keys below a line in brackets")
        return _Table(self.source, f"{self.name}.{key}".lstrip("."), words)

    def text(self, key: str) -> str:
        """Return a text."""
        if not isinstance(self.words.get(key), str):
            self.fail(key, 'give a text, in quotation marks, as in mesh = "wall.msh"')
        return self.words[key]

    def texts(self, key: str) -> list[str]:
        """Return a list of texts."""
        value = self.words[key]
        if not (isinstance(value, list) and all(isinstance(word, str) for word in value)):
            self.fail(key, 'give a list of texts, as ["opening_1", "opening_2"]')
        return list(value)

    def choice(self, key: str, choices: Iterable[str], default: str | None = None) -> Any:
        """Return one of several texts."""
        value = self.words.get(key, default)
        if value not in tuple(choices):
            self.fail(key, f"choose one of {', '.join(map(repr, choices))}")
        return value

    def number(
        self,
        key: str,
        quantity: str = "number",
        *,
        default: float | None = None,
        least: float | None = None,
        most: float = math.inf,
    ) -> float:
        """Return a number in the first unit of its quantity: positive, or within bounds."""
        value, units = self.words.get(key, default), UNITS[quantity]
        factor = 1.0
        if isinstance(value, str):
            figure, _, unit = value.strip().partition(" ")
            value, factor = _float(figure), units.get(unit.strip(), math.nan)
        usual = isinstance(value, (int, float)) and not isinstance(value, bool)
        found = value * factor if usual else math.nan
        if (
            (0.0 < found if least is None else least <= found)
            and found <= most
            and found < math.inf
        ):
            return float(found)
        first, *others = units
        bounds = "a positive number" if least is None else f"a number from {least:g} to {most:g}"
        unit = f" in {first}" * bool(first)
        texts = f", or a text with its unit, {', '.join(units)}" * bool(others)
        self.fail(key, f"{'is missing: ' * (key not in self.words)}give {bounds}{unit}{texts}")


def _float(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
