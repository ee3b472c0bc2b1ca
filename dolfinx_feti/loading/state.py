# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The state of a path: everything that a step changes, to be copied, restored, written and read.

It owns the load or time, the unknowns (u, condensed pressures, which are multipliers at the same
time), histories (internal variables, last displacements of dashpots; velocity and accelerations
with inertia), and the Constants of the forms, a Windkessel's history among them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import dolfinx

from dolfinx_feti.fem.content import Content
from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.runtime.arrays import Array

__all__ = ["PathState", "Snapshot"]


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A copy of a state: its load or time, and the values, with ghosts."""

    at: float
    arrays: list[Array]
    numbers: list[Array]


class PathState:
    """Everything that a step changes.

    Attributes:
        at: The load or time.
        functions: First the unknowns, which a solve changes and extrapolation predicts.
        numbers: Constants of the forms, then further ones.
    """

    def __init__(
        self,
        at: float,
        content: Content,
        unknowns: Iterable[dolfinx.fem.Function],
        histories: Iterable[dolfinx.fem.Function],
        numbers: Sequence[dolfinx.fem.Constant] = (),
    ) -> None:
        """Take unknowns before those of the forms, histories, and what every step may change."""
        self.at, self._content = float(at), content
        known = list(dict.fromkeys([*unknowns, *content.unknowns]))
        self._count = len(known)
        self.functions = list(dict.fromkeys([*known, *histories]))
        self.numbers = list(dict.fromkeys([*content.constants, *numbers]))
        self._initial = [np.array(number.value) for number in self.numbers]
        self._moving = {self.numbers.index(number) for number in numbers}

    def copy(self) -> Snapshot:
        """Return a copy."""
        arrays = [f.x.array.copy() for f in self.functions]
        return Snapshot(self.at, arrays, [np.array(number.value) for number in self.numbers])

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a copy; on this process alone."""
        self.at = snapshot.at
        self.set(snapshot.arrays)
        for number, value in zip(self.numbers, snapshot.numbers, strict=True):
            number.value = value

    def set(self, arrays: Sequence[Array]) -> None:
        """Set the functions, or the unknowns alone."""
        for f, array in zip(self.functions, arrays, strict=False):
            f.x.array[:] = array

    def unknowns(self, snapshot: Snapshot) -> list[Array]:
        """Return the values of the unknowns in a copy."""
        return snapshot.arrays[: self._count]

    def write(
        self, checkpoint: Checkpoint, past: Sequence[Snapshot], record: Mapping[str, object]
    ) -> None:
        """Write the state, and the unknowns of earlier ones. Collective."""
        numbers = [np.array(number.value) for number in self.numbers]
        pairs = enumerate(zip(self._initial, numbers, strict=True))
        self._moving |= {i for i, (a, b) in pairs if not np.array_equal(a, b)}
        moving, loads = sorted(self._moving), [*(s.at for s in past), self.at]
        checkpoint.write(
            self.functions,
            {"loads": loads, "numbers": numbers, "moving": moving, **record},
            [self.unknowns(s) for s in past],
            content=self._content,
            moving=moving,
        )

    def read(self, checkpoint: Checkpoint) -> list[Snapshot]:
        """Read what was written; return the earlier states, with the unknowns alone. Collective.

        Numbers that no step had changed stay as they are.
        """
        record = checkpoint.record or {}
        *loads, at = record["loads"]
        moving, numbers = record["moving"], record["numbers"]
        past = checkpoint.read(self.functions, content=self._content)
        self.at, self._moving = at, self._moving | set(moving)
        for i in moving:
            self.numbers[i].value = np.asarray(numbers[i])
        return [Snapshot(at, arrays, []) for at, arrays in zip(loads, past, strict=True)]
