# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Owners that destroy PETSc objects explicitly, on all processes at the same place.

PETSc destroys objects collectively, but Python's garbage collector runs at another time on each
process. The code that creates an object therefore destroys it, or passes it to an owner.
"""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any, TypeVar

T = TypeVar("T", bound=Any)


class Lifetime(ExitStack):
    """Owner of objects, destroyed in reverse order at the end of ``with`` or by ``close``.

    A function that creates several objects may fail after the first. A ``Lifetime`` destroys them
    after an error. If all went well, the function passes them on by ``pop_all`` or
    :meth:`release`::

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
        """Forget the objects without destroying them; another owner destroys them."""
        self.pop_all()
