# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Load steps from equilibrium to equilibrium, time steps, and states that outlive a run.

``follow_load`` (``load_steps``) and ``follow_time`` (``time_steps``) are two kinds of the same
steps: ``stepper`` has the order of events, ``state`` what a step changes, ``step_length`` the rule
for its length, ``problem`` what a path needs of a problem. ``unloaded`` and ``prestressed`` follow
a load with a problem that solves another one repeatedly (``fixed_point``). Checkpoints are three
files: ``archive`` (arrays), ``identity`` (is it this problem?) and ``checkpoint``. *A place* is a
load or a time. *The paper* is Augustin, Holzapfel and Steinbach (2014), see docs/equations.md.

In the order of the data: tolerances, archive, identity, checkpoint, places, state, load_step,
time_step, step_length, steps, progress, problem, fixed_point, stepper, motion, dashpots,
load_steps, unloaded, prestressed, time_steps.
"""

from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.loading.load_step import LoadStep
from dolfinx_feti.loading.load_steps import follow_load
from dolfinx_feti.loading.motion import Motion
from dolfinx_feti.loading.prestressed import prestress
from dolfinx_feti.loading.steps import Steps, TimeSteps
from dolfinx_feti.loading.time_step import TimeStep
from dolfinx_feti.loading.time_steps import follow_time
from dolfinx_feti.loading.unloaded import unload

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
