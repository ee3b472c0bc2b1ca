# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The state of a path: everything that a step changes, to be copied, restored, written and read.

It owns the load or time, the unknowns (u, condensed pressures, which are multipliers at the same
time), histories (internal variables, last displacements of dashpots; velocity and accelerations
with inertia), and numbers (Constants of the forms, and whatever else has a ``value``). Further
state of a problem, such as a volume or a Windkessel's pressure, is one more function or number.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

import dolfinx

from dolfinx_feti.fem.content import Content
from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.runtime.arrays import Array

__all__ = ["Number", "PathState", "Snapshot"]


class Number(Protocol):
    """Something with a value, equal on all processes, such as a Constant."""

    value: Any


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A copy of a state: its load or time, and the values, with ghosts."""

    at: float
    unknowns: list[Array]
    histories: list[Array]
    numbers: list[Array]


class PathState:
    """Everything that a step changes.

    Attributes:
        at: The load or time.
        unknowns: What a solve changes, and extrapolation predicts.
        histories: Other Functions that a step changes.
        numbers: Constants of the forms, then others with a value.
    """

    def __init__(
        self,
        at: float,
        content: Content,
        unknowns: Iterable[dolfinx.fem.Function],
        histories: Iterable[dolfinx.fem.Function],
        numbers: Sequence[Number] = (),
    ) -> None:
        """Take the unknowns that the user names, before those of the forms, and further histories.

        ``numbers`` are those that every step may change, Constants of the forms or not.
        """
        self.at, self._content = float(at), content
        self.unknowns = list(dict.fromkeys([*unknowns, *content.unknowns]))
        self.histories = [f for f in dict.fromkeys(histories) if f not in self.unknowns]
        self.numbers: list[Number] = list(dict.fromkeys([*content.constants, *numbers]))
        self._initial = [np.array(number.value) for number in self.numbers]
        changing = set(map(id, numbers))
        self._moving = {i for i, number in enumerate(self.numbers) if id(number) in changing}

    def copy(self) -> Snapshot:
        """Return a copy."""
        return Snapshot(
            self.at,
            [f.x.array.copy() for f in self.unknowns],
            [f.x.array.copy() for f in self.histories],
            [np.array(number.value) for number in self.numbers],
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a copy; on this process alone."""
        self.at = snapshot.at
        self.set_unknowns(snapshot.unknowns)
        for f, array in zip(self.histories, snapshot.histories, strict=True):
            f.x.array[:] = array
        for number, value in zip(self.numbers, snapshot.numbers, strict=True):
            number.value = value

    def set_unknowns(self, values: Sequence[Array]) -> None:
        """Set the unknowns alone."""
        for f, array in zip(self.unknowns, values, strict=True):
            f.x.array[:] = array

    def write(
        self, checkpoint: Checkpoint, past: Sequence[Snapshot], record: Mapping[str, object]
    ) -> None:
        """Write the state, and the unknowns of earlier ones. Collective."""
        numbers = [np.array(number.value) for number in self.numbers]
        pairs = enumerate(zip(self._initial, numbers, strict=True))
        self._moving |= {i for i, (a, b) in pairs if not np.array_equal(a, b)}
        moving, loads = sorted(self._moving), [*(s.at for s in past), self.at]
        checkpoint.write(
            [*self.unknowns, *self.histories],
            {"loads": loads, "numbers": numbers, "moving": moving, **record},
            [s.unknowns for s in past],
            content=self._content,
            moving=moving,
        )

    def read(self, checkpoint: Checkpoint) -> list[Snapshot]:
        """Read what was written; return the earlier states, with the unknowns alone. Collective.

        Numbers that no step had changed stay as they are. A KeyError tells that something else has
        written it.
        """
        record = checkpoint.record or {}
        *loads, at = record["loads"]
        moving, numbers = record["moving"], record["numbers"]
        past = checkpoint.read([*self.unknowns, *self.histories], content=self._content)
        self.at, self._moving = at, self._moving | set(moving)
        for i in moving:
            self.numbers[i].value = np.asarray(numbers[i])
        return [Snapshot(at, v, [], []) for at, v in zip(loads, past, strict=True)]
