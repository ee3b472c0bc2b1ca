# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The record of an accepted time step."""

from __future__ import annotations

from dataclasses import dataclass

from dolfinx_feti.loading.load_step import LoadStep

__all__ = ["TimeStep"]


@dataclass(frozen=True, slots=True)
class TimeStep(LoadStep):
    """An accepted time step. Its attribute ``load`` is the time at its end [s].

    Attributes:
        kinetic: Kinetic energy at its end [mN mm].
        stored: Energy of the material at its end, if it was given; else NaN [mN mm].
        work: Work of the external forces in it, if they were given; else NaN [mN mm].
        dissipated: Work on dashpots, and on all else in the forms that resists the rate [mN mm].
        error: Estimated error of the displacement [mm].
    """

    kinetic: float
    stored: float
    work: float
    dissipated: float
    error: float
