# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Whether the Dirichlet conditions of a problem are known to support the body."""

from __future__ import annotations

from dolfinx_feti.problems.equations.dirichlet import DirichletConditions
from dolfinx_feti.problems.equations.system import System


class KnownSupport:
    """The conditions with which a tangent was regular, in all solves of a problem.

    With these conditions a singular tangent of a later state lacks no support: the load is near a
    limit point, or the trial state is bad.
    """

    def __init__(self) -> None:
        """Create a record in which no conditions are known to support the body."""
        self._conditions: DirichletConditions | None = None

    def note(self, system: System) -> None:
        """Record that a tangent with the present conditions of a system was regular."""
        self._conditions = system.conditions

    def is_known(self, system: System) -> bool:
        """Return True if a tangent with the present conditions of a system was regular before."""
        return self._conditions is system.conditions
