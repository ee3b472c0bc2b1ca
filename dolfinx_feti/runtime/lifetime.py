# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Owners of PETSc's objects, which all processes end together, the last one first."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any, TypeVar

T = TypeVar("T", bound=Any)


class Lifetime(ExitStack):
    """Ends what it owns: as a context, or by ``close``; ``pop_all`` moves all to another one."""

    def own(self, thing: T) -> T:
        """Take over an object with a ``destroy``, and return it."""
        self.callback(thing.destroy)
        return thing
