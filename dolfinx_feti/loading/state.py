# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The state of a path: all that a step changes, and copies of the last accepted states.

A state is a load or time t and the values of

* the unknowns: u and the condensed pressures, which are multipliers at the same time;
* histories: internal variables, last displacements of dashpots, velocity and accelerations;
* the Constants of the forms, such as loads and the history of a Windkessel.

Failed steps restore the last accepted state. The accepted states predict the unknowns at another
load or time by the polynomial through them,

.. math:: U(t) ≈ \sum_i w_i(t)\, U_i, \qquad w_i(t) = \prod_{j ≠ i} \frac{t - t_j}{t_i - t_j}.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

import dolfinx

from dolfinx_feti.fem.user_forms.form_content import FormContent
from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.runtime.arrays import Array

__all__ = ["PathState", "Snapshot"]


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A copy of a state.

    Attributes:
        at: Its load or time.
        arrays: Values of the functions, with ghosts; the unknowns come first.
        constants: Values of the Constants; None if the state was read from a checkpoint with its
            unknowns alone. Such a state is used in predictions, and cannot be restored.
    """

    at: float
    arrays: list[Array]
    constants: list[Array] | None


class PathState:
    """The present state of a path, in the user's Functions and Constants, and the accepted ones.

    Attributes:
        at: Load or time of the last accepted state.
        functions: All Functions that a step changes; the first ones are the unknowns.
        constants: All Constants that a step may change: those of the forms, then further ones.
        accepted: Copies of the last accepted states, the oldest first.
        n_earlier: Number of accepted states that are stored before the last one.
    """

    def __init__(
        self,
        at: float,
        content: FormContent,
        unknowns: Iterable[dolfinx.fem.Function],
        histories: Iterable[dolfinx.fem.Function],
        constants: Sequence[dolfinx.fem.Constant] = (),
        *,
        n_earlier: int = 0,
    ) -> None:
        """Accept the present state.

        Args:
            at: Its load or time.
            content: Unknowns and constants of the forms.
            unknowns: Further Functions that a solve changes.
            histories: Functions that advance after a solve.
            constants: Further Constants, which every step changes.
            n_earlier: Number of accepted states to store before the last one.
        """
        self.at = float(at)
        self.n_earlier = n_earlier
        self._content = content
        self._unknowns = list(dict.fromkeys([*unknowns, *content.unknowns]))
        self.functions = list(dict.fromkeys([*self._unknowns, *histories]))
        self.constants = list(dict.fromkeys([*content.constants, *constants]))
        self._initial = [np.array(c.value) for c in self.constants]
        #: Indices in ``constants`` of those that every step changes, or that one has changed.
        self._changing = {self.constants.index(c) for c in constants}
        self.accepted = [self._copy()]

    def accept(self, at: float) -> None:
        """Store the present state, at a load or time, as the last accepted one."""
        self.at = at
        first = max(len(self.accepted) - self.n_earlier, 0)
        earlier = [s for s in self.accepted[first:] if s.at != at]  # distinct nodes of a polynomial
        self.accepted = [*earlier, self._copy()]

    def update_accepted(self) -> None:
        """Store the present state in place of the last accepted one, at the same load or time."""
        self.accepted[-1] = self._copy()

    def restore(self) -> None:
        """Restore the last accepted state; not collective."""
        self._restore(self.accepted[-1])

    def step_back(self) -> None:
        """Discard the last accepted state, and restore the one before it; not collective."""
        self.accepted.pop()
        self.restore()

    def can_extrapolate(self) -> bool:
        """Return True if enough states were accepted for a prediction, ``n_earlier`` + 1."""
        return len(self.accepted) > self.n_earlier

    def extrapolate(self, at: float) -> None:
        """Set the unknowns to the polynomial through accepted states, at a load or time."""
        weights = _lagrange_weights([s.at for s in self.accepted], at)
        for i, f in enumerate(self._unknowns):
            values = np.zeros_like(f.x.array)
            for weight, snapshot in zip(weights, self.accepted, strict=True):
                values += weight * snapshot.arrays[i]  # Σ w_i U_i
            f.x.array[:] = values

    def write(
        self, checkpoint: Checkpoint, record: Mapping[str, object], *, with_step_before: bool
    ) -> None:
        """Write the last accepted state, and the unknowns of earlier ones. Collective.

        Constants whose values have changed since the beginning of the path are noted as changing: a
        restart does not compare their values.

        Args:
            checkpoint: Where to write.
            record: Further data of the state; what JSON can hold.
            with_step_before: Whether to write the accepted state before it in full, from which a
                restart can repeat the last step.
        """
        earlier = self.accepted[:-1]
        last = self.accepted[-1]
        self._note_changed_constants(last)
        changing = sorted(self._changing)
        arrays = [s.arrays[: len(self._unknowns)] for s in earlier]
        constants_before: list[Array] | None = None
        if with_step_before:
            arrays[-1] = earlier[-1].arrays
            constants_before = earlier[-1].constants
        of_state = {
            "loads": [s.at for s in self.accepted],  # or times
            "constants": last.constants,
            "constants_before": constants_before,
            "changing": changing,
        }
        checkpoint.write(
            self.functions, {**of_state, **record}, arrays, content=self._content, changing=changing
        )

    def _note_changed_constants(self, state: Snapshot) -> None:
        """Record which Constants differ in a state from the beginning of the path."""
        for i, initial in enumerate(self._initial):
            if state.constants is not None and not np.array_equal(initial, state.constants[i]):
                self._changing.add(i)

    def read(self, checkpoint: Checkpoint) -> None:
        """Read the present state and the accepted ones from a checkpoint. Collective.

        Earlier states have the unknowns alone, but for one that was written in full. Constants that
        no step had changed keep their present values.

        Raises:
            KeyError: The record was not written by :meth:`write`.
            ValueError: The state is one of another problem.
        """
        record = checkpoint.record or {}
        *loads, at = record["loads"]
        changing = record["changing"]
        values = record["constants"]
        constants_before = record["constants_before"]
        arrays = checkpoint.read(self.functions, content=self._content)
        earlier = [
            Snapshot(load, of_state, None) for load, of_state in zip(loads, arrays, strict=True)
        ]
        if constants_before is not None:
            values_before = [np.array(c.value) for c in self.constants]
            for i in changing:
                values_before[i] = np.asarray(constants_before[i])
            earlier[-1] = replace(earlier[-1], constants=values_before)
        self.at = at
        self._changing |= set(changing)
        for i in changing:
            self.constants[i].value = np.asarray(values[i])
        self.accepted = [*earlier, self._copy()]

    def _copy(self) -> Snapshot:
        """Return a copy of the present state."""
        return Snapshot(
            self.at,
            [f.x.array.copy() for f in self.functions],
            [np.array(c.value) for c in self.constants],
        )

    def _restore(self, snapshot: Snapshot) -> None:
        """Set Functions and Constants to the values of a state that was stored in full."""
        if snapshot.constants is None:
            raise RuntimeError("This state was read with its unknowns alone.")
        self.at = snapshot.at
        for f, values in zip(self.functions, snapshot.arrays, strict=True):
            f.x.array[:] = values
        for constant, value in zip(self.constants, snapshot.constants, strict=True):
            constant.value = value


def _lagrange_weights(nodes: Sequence[float], t: float) -> list[float]:
    """Return the weights w_i(t) of values at distinct nodes t_i, one for each node."""
    t_i = np.array(nodes)
    weights = []
    for i, node in enumerate(t_i):
        others = np.delete(t_i, i)
        weights.append(float(np.prod((t - others) / (node - others))))  # Π (t − t_j)/(t_i − t_j)
    return weights
