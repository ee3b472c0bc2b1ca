# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Multipliers that make a material incompressible in the end: how fast they get there.

The update λ ← p(λ) of the augmented Lagrangian, with the pressure p(λ) of the equilibrium under
λ, converges linearly, the faster the larger κ is beside the stiffness of the material. Anderson's
acceleration takes the combination of the last updates whose p − λ is least,

.. math:: λ_{k+1} = \sum_j γ_j\, p_j, \qquad
          \min \Bigl\| \sum_j γ_j (p_j - λ_j) \Bigr\|, \quad \sum_j γ_j = 1

(Walker and Ni 2011).
"""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

__all__ = ["accelerated"]

Array = npt.NDArray[np.float64]

#: How many updates are combined, and how small an eigenvalue of their products counts as zero.
DEPTH, DEPENDENT = 6, 1e-12


def accelerated(past: Sequence[tuple[Array, Array]], comm: MPI.Comm) -> Array:
    """Return the next multipliers, this process's part.

    Args:
        past: Multipliers λ and the pressure p that came of them, one pair for each update.
        comm: Communicator of all parts.

    Note:
        Collective.
    """
    pairs = past[-DEPTH:]
    f = np.array([p - λ for λ, p in pairs])
    changes, last = f[:-1] - f[-1], f[-1]
    product = comm.allreduce(changes @ np.column_stack([changes.T, last]))
    γ = np.linalg.lstsq(product[:, :-1], -product[:, -1], rcond=DEPENDENT)[0]
    p = np.array([p for _, p in pairs])
    return np.asarray(p[-1] + γ @ (p[:-1] - p[-1]))
