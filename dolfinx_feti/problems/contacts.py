# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The contacts of a problem: their penalties, and the updates of their multipliers."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack

import numpy as np

import dolfinx

from dolfinx_feti.contact.contact import Contact
from dolfinx_feti.errors import ToolCrossedError
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.problems.equations.system import System
from dolfinx_feti.problems.multipliers import MultiplierUpdates
from dolfinx_feti.runtime.norms import norm

#: Updates end once they change less than this share of the contact's forces on nodes. Each solve
#: leaves about a tenth of the change before it, as the penalty is ten times the stiffness of the
#: body (``contact.state.PENALTY``): two solves leave 1e-2. A tolerance of 0.002 costs most solves
#: one more update.
FORCE_RTOL = 0.02

#: The penalty grows after an update that changes the forces by more than this share of the change
#: by the update before. The share is a tenth while the body is as stiff as when the penalty was
#: chosen.
SLOW_UPDATE = 0.5

#: Factor by which the penalty grows even if the body has not become stiffer. It is a choice, not
#: measured.
PENALTY_GROWTH = 4.0


def checked_contacts(
    contacts: Sequence[Contact], u: dolfinx.fem.Function, tolerance: float
) -> tuple[Contact, ...]:
    """Return the contacts of a problem for the unknown u, checked.

    Raises:
        ValueError: ``contacts`` is not a list of contacts of u, or the tolerance is not positive.
    """
    if not isinstance(contacts, Sequence):
        raise ValueError(f"contacts is {contacts!r} alone: put it in a list, contacts=[contact].")
    for i, contact in enumerate(contacts):
        if not isinstance(contact, Contact):
            raise ValueError(f"contacts[{i}] is {contact!r}: give a Contact.")
        if contact.u is not u:
            raise ValueError(
                f"contacts[{i}] belongs to another displacement: create it with the unknown u of "
                "the problem."
            )
        if any(contact is other for other in contacts[:i]):
            raise ValueError(f"contacts[{i}] is given twice: leave one out.")
    if not (np.isfinite(tolerance) and tolerance > 0.0):
        raise ValueError(
            f"contact_tolerance is {tolerance}: give a positive share of the size of a cell."
        )
    return tuple(contacts)


class Contacts:
    """The contacts of a problem; truthy if there are any.

    Attributes:
        contacts: The contacts.
        multipliers: λ of each contact, a Function that a solve changes as it changes u.
        penalties: ε of each contact, a Function that a solve may change.
    """

    def __init__(self, contacts: Sequence[Contact]) -> None:
        """Collect contacts that have been checked."""
        self.contacts = tuple(contacts)
        self.multipliers: list[dolfinx.fem.Function] = [contact.multiplier for contact in contacts]
        self.penalties: list[dolfinx.fem.Function] = [contact.penalty for contact in contacts]

    def __bool__(self) -> bool:
        """Return True if there is a contact."""
        return bool(self.contacts)

    def prepare(self, compiler: Compiler) -> None:
        """Compile the forms that measure the contacts. Collective."""
        for contact in self.contacts:
            contact.prepare(compiler)

    def choose_missing_penalties(self, system: System) -> None:
        """Choose the penalties that are not set yet, by the present stiffness. Collective."""
        missing = [contact for contact in self.contacts if not contact.state.has_penalty()]
        if missing:
            self._set_penalties(system, missing)

    def stiffen(self, system: System) -> None:
        """Multiply all penalties by ``PENALTY_GROWTH``, or by more if the body has become stiffer.

        Collective.
        """
        for contact in self.contacts:
            contact.state.grow_penalty(PENALTY_GROWTH)
        self._set_penalties(system, self.contacts)

    def _set_penalties(self, system: System, contacts: Sequence[Contact]) -> None:
        """Choose penalties by the stiffness of the body without any contact. Collective."""
        with ExitStack() as stack:
            for contact in self.contacts:
                stack.enter_context(contact.state.without_tool())
            diagonal = system.assembled_stiffness()
        if np.isfinite(norm(system.comm, diagonal)):  # else Newton reports a residual of NaN
            for contact in contacts:
                contact.state.set_penalty(diagonal)

    def fit_multipliers(self) -> None:
        """Replace the multipliers by their fit by traces of u, at the start of a solve. Collective.

        λ has more values than the surface has nodes: a part of it does no work on any displacement,
        and would grow from solve to solve as the contact spreads.
        """
        for contact in self.contacts:
            contact.state.fit_multiplier()

    def violation(self) -> float:
        """Return the largest violation over the size of a cell. Collective; needs a contact."""
        return max(contact.state.violation() for contact in self.contacts)

    def force_change(self) -> float:
        """Return the largest share of a contact's forces that an update changes.

        Collective; needs a contact.
        """
        return max(contact.state.force_change() for contact in self.contacts)

    def update(self) -> None:
        """Update the multipliers, λ ← ⟨λ − ε g⟩₊. Collective."""
        for contact in self.contacts:
            contact.state.update_multiplier()

    def store_positions(self) -> None:
        """Store the present positions of body and tools. Collective."""
        for contact in self.contacts:
            contact.crossing.store_state()

    def require_no_crossing(self, tolerance: float) -> None:
        """Check that no point has crossed a tool since positions were stored. Collective.

        Args:
            tolerance: Depth below which a point has not crossed, over the size of a cell.

        Raises:
            ToolCrossedError: A point has.
        """
        for contact in self.contacts:
            if contact.crossing.has_crossed(tolerance):
                raise ToolCrossedError(
                    f"The surface of '{contact.name}' has jumped through its tool to the other "
                    "side: load in smaller steps, so that it touches the tool on the way."
                )

    def update_pressures(self) -> None:
        """Compute the pressures of the present state for the user. Collective."""
        for contact in self.contacts:
            contact.update_pressure()


class ContactUpdates(MultiplierUpdates):
    """The updates of the multipliers of all contacts, in one solve.

    Attributes:
        violations: The largest violation, over the size of a cell, after each solve.
    """

    def __init__(self, system: System, contacts: Contacts, tolerance: float) -> None:
        """Create the updates of a solve that begins with the present λ.

        Args:
            system: The equations.
            contacts: The contacts.
            tolerance: Largest violation, over the size of a cell.
        """
        self.violations: list[float] = []
        self._force_changes: list[float] = []  # of each update, relative
        self._system = system
        self._contacts = contacts
        self._tolerance = tolerance

    def end_solve(self) -> bool:
        """Return True if the present state satisfies the contact conditions. Collective."""
        self.violations.append(self._contacts.violation())
        self._force_changes.append(self._contacts.force_change())
        return self.violations[-1] <= self._tolerance and self._force_changes[-1] <= FORCE_RTOL

    def update(self) -> None:
        """Update λ, with a larger penalty after a slow update. Collective.

        An update is slow if it changes the forces by almost as much as the one before. If only the
        violation is still large, it belongs to pressures that hardly act on the displacements: a
        larger penalty would not help.
        """
        self._contacts.update()
        if len(self._force_changes) < 2 or self._force_changes[-1] <= FORCE_RTOL:
            return
        before, now = self._force_changes[-2:]
        if now > SLOW_UPDATE * before:
            self._contacts.stiffen(self._system)

    def failure(self) -> str:
        """Return the message of a contact that is not satisfied, with the remedy."""
        return (
            f"penetrations or gaps in contact are still {self.violations[-1]:.1e} of the size of a "
            f"cell: take a larger contact_tolerance than {self._tolerance:g}, or load in smaller "
            "steps"
        )
