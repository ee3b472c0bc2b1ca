# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Values at the nodes of a displacement, exchanged between the processes that share a node."""

from __future__ import annotations

import numpy as np

import dolfinx

from dolfinx_feti.runtime.arrays import Array

__all__ = ["sum_contributions", "with_ghosts"]


def with_ghosts(V: dolfinx.fem.FunctionSpace, values: Array) -> Array:
    """Return values of the owned nodes with those of the ghosts. Collective.

    Args:
        V: The space of the displacement.
        values: One value for each owned node, (owned nodes,).

    Returns:
        (local nodes,): the owned ones, then the ghosts.
    """
    x = dolfinx.la.vector(V.dofmap.index_map, 1)
    x.array[: len(values)] = values
    x.scatter_forward()
    return np.asarray(x.array)


def sum_contributions(V: dolfinx.fem.FunctionSpace, values: Array) -> Array:
    """Return the sums of what all processes contribute to the owned nodes. Collective.

    Args:
        V: The space of the displacement.
        values: Contributions of this process, (local nodes,).

    Returns:
        (owned nodes,).
    """
    x = dolfinx.la.vector(V.dofmap.index_map, 1)
    x.array[:] = values
    x.scatter_reverse(dolfinx.la.InsertMode.add)
    return x.array[: V.dofmap.index_map.size_local].copy()
