# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Load steps from equilibrium to equilibrium, time steps, and states that outlive a run.

In the order of the data: checkpoint, state, steps, progress, fixed_point, stepper,
motion, load_steps, unloaded, prestressed, time_steps.
"""

from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.loading.load_steps import follow_load
from dolfinx_feti.loading.motion import Motion
from dolfinx_feti.loading.prestressed import prestress
from dolfinx_feti.loading.steps import LoadStep, Steps
from dolfinx_feti.loading.time_steps import TimeStep, TimeSteps, follow_time
from dolfinx_feti.loading.unloaded import unload
from dolfinx_feti.mechanics.values import type_exports

__all__ = [
    "Checkpoint",
    "LoadStep",
    "Motion",
    "Steps",
    "TimeStep",
    "TimeSteps",
    "follow_load",
    "follow_time",
    "prestress",
    "unload",
]

type_exports(globals())
