# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""About how long `demo_artery.py` takes, from what it has taken elsewhere.

With n displacement dofs, N Newton steps and P processes it is N n τ/P. The README's run of the
vessel, on two cores, gives τ: 199 035 dofs, 33 Newton steps in 9 load steps, 164 s on two
processes. Another material, mesh or machine can take a third of that, or three times as long.
"""

from __future__ import annotations

__all__ = ["estimated_seconds"]

#: Newton steps in a load step.
NEWTON = 33 / 9

#: Seconds for a dof in a Newton step, on one process: τ.
SECONDS = 164.0 * 2 / (33 * 199035)


def estimated_seconds(dofs: int, load_steps: float, processes: int) -> float:
    """Return about how long the load steps take.

    Args:
        dofs: Displacement dofs.
        load_steps: How many are to come, without failures.
        processes: With a core each.
    """
    return load_steps * NEWTON * dofs * SECONDS / processes
