# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""When a trial of a load step ends before its Newton steps are used up.

A path tries a predicted state, or a large load step, and can fall back on a shorter one. A solve
that is likely to fail then costs less if it ends at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dolfinx_feti.problems.history import NewtonStep
from dolfinx_feti.problems.iteration.failures import CRAWLING, NewtonFailure
from dolfinx_feti.problems.iteration.iterate import Iterate, Start

#: Number of consecutive steps, each shorter than the step length below, after which a solve counts
#: as crawling. A single such step is common where a contact begins.
CRAWLING_STEPS = 2

#: Step length α below which a step is short. Two steps of a tenth leave four fifths of the way, for
#: which a load step of half the increment is cheaper. It is a choice, not measured.
CRAWLING_LENGTH = 0.1


@dataclass(frozen=True, slots=True)
class EarlyEnd:
    """The rules of one solve: none unless ``is_allowed``."""

    is_allowed: bool  # the caller can try another start or a smaller load step
    refuses_first_tangent: bool  # an indefinite first tangent ends the solve

    @classmethod
    def of(cls, start: Start, first: Iterate) -> EarlyEnd:
        """Return the rules for a solve with this start and first iterate.

        A first iterate is suspect if its residual is larger than that of the last equilibrium under
        the new load, and its tangent is not that of the last equilibrium. An indefinite tangent
        then ends the solve. Without this rule a tube takes 34 Newton steps instead of 28 to 200
        mmHg, if the first load step is half of it.
        """
        is_suspect = start.tangent is None and first.norm > start.reference_norm
        return cls(start.allows_early_end, start.allows_early_end and is_suspect)

    def check(self, history: Sequence[NewtonStep]) -> None:
        """Raise an error if the last steps were short.

        Raises:
            NewtonFailure: The solve crawls.
        """
        lengths = [step.step_length for step in history[-CRAWLING_STEPS:]]
        is_crawling = len(lengths) == CRAWLING_STEPS and max(lengths) < CRAWLING_LENGTH
        if self.is_allowed and is_crawling:
            raise NewtonFailure(CRAWLING, CRAWLING_LENGTH)
