# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Owners that destroy PETSc objects explicitly, on all processes at the same place.

PETSc destroys the objects of a communicator collectively. Python's garbage collector runs at other
times on each process, so that whoever creates an object destroys it, or passes it to an owner.
"""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any, TypeVar

T = TypeVar("T", bound=Any)


class Lifetime(ExitStack):
    """Owner of objects: destroys them, the last one first, at the end of ``with`` or by ``close``.

    A function that creates several objects, and may fail after the first, passes them on at its
    end, by ``pop_all`` or :meth:`release`; until then an error destroys them::

        with Lifetime() as created:
            self.x = created.own(A.createVecRight())
            ...
            self._owned = created.pop_all()  # a new Lifetime owns them; ``created`` is empty
    """

    def own(self, petsc_object: T) -> T:
        """Own an object with a method ``destroy`` and return it."""
        self.callback(petsc_object.destroy)
        return petsc_object

    def release(self) -> None:
        """Own nothing any more: another owner destroys the objects."""
        self.pop_all()
