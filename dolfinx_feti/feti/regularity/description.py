# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The message of an error: which bodies are free, and to how many translations and rotations.

Translations are what the mean of each component leaves nothing of,

.. math:: (F - \bar F)^⊤ (F - \bar F)\, y = 0.
"""

from __future__ import annotations

import numpy as np

from dolfinx_feti.feti.regularity.motions import Motions
from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.runtime.collective import total_of
from dolfinx_feti.torn.matrix import Torn

__all__ = ["describe"]


#: Share of a motion beside its mean, squared, below which it is a translation.
CONSTANT = 1e-10

#: Most bodies that are described.
DESCRIBED = 3


def describe(rigid: Motions, others: Array) -> str:
    """Return the message of the error: rigid motions, and others, (n, any number). Collective."""
    total, torn = rigid.total + others.shape[1], rigid.torn
    text = f"The assembled problem is singular, with a kernel of dimension {total}: "
    x = torn.coordinates()
    moving = np.flatnonzero(rigid.dimensions)
    parts = [_body(rigid, x, int(b)) for b in moving[:DESCRIBED]]
    if len(moving) > DESCRIBED:
        parts.append(f"{len(moving) - DESCRIBED} more parts are free")
    if others.shape[1]:
        what = "a motion that is" if others.shape[1] == 1 else f"{others.shape[1]} motions that are"
        parts.append(f"nothing resists {what} not rigid{_largest(torn, x, others[:, 0])}")
    remedy = "Add Dirichlet conditions, connect what is loose, or give A this null space"
    return text + "; ".join(parts) + f". {remedy} (A.setNullSpace)."


def _body(rigid: Motions, x: Array | None, b: int) -> str:
    """Say where a body is, and how it may move."""
    torn, count, mine = rigid.torn, rigid.bodies.count, rigid.bodies.label == b
    if x is not None:
        mine &= np.isfinite(x[:, 0])  # the others are at no point
    names = _names(torn, mine, rigid.fields[mine, : rigid.dimensions[b]])
    said = f"the Dirichlet conditions leave {names} free"
    if count == 1:
        return said
    where = "" if x is None else f" around {_middle(torn, x[mine])}"
    return f"in a part that is not connected to the rest ({b + 1} of {count}{where}) {said}"


def _names(torn: Torn, mine: Mask, F: Array) -> str:
    """Count the rigid motions F of a body, (n, m), by their kinds; ``mine`` marks its dofs."""
    bs, comm = torn.A.getBlockSize(), torn.comm
    if bs == 1:
        return "a constant"
    of_component = np.eye(bs)[np.flatnonzero(mine) % bs]
    gram, sums = total_of(F.T @ F, comm), total_of(of_component.T @ F, comm)
    number = np.maximum(total_of(of_component.sum(axis=0), comm), 1.0)
    beside = gram - sums.T @ (sums / number[:, None])  # (F − F̄)ᵀ (F − F̄)
    shares = np.linalg.eigvals(np.linalg.pinv(gram, hermitian=True) @ beside).real
    turning = int(np.count_nonzero(shares > CONSTANT))
    kinds = (len(shares) - turning, "translation"), (turning, "rotation")
    return " and ".join(f"{n} {kind}{'s' * (n > 1)}" for n, kind in kinds if n)


def _middle(torn: Torn, x: Array) -> str:
    """Return the middle of points over all processes."""
    ends = x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)
    lows, highs = zip(*torn.comm.allgather(ends), strict=True)
    return _point(0.5 * (np.min(lows, axis=0) + np.max(highs, axis=0)))


def _largest(torn: Torn, x: Array | None, w: Array) -> str:
    """Say where a field is largest."""
    if x is None:
        return ""
    bs = torn.A.getBlockSize()
    size = np.where(np.isfinite(x[::bs, 0]), np.linalg.norm(w.reshape(-1, bs), axis=1), 0.0)
    i = int(size.argmax()) if len(size) else 0
    own = (float(size[i]), x[bs * i].tolist()) if len(size) else (-1.0, [])
    return f", largest at {_point(np.array(max(torn.comm.allgather(own))[1]))}"


def _point(x: Array) -> str:
    """Write coordinates, without what is rounding."""
    scale = max(float(np.abs(x).max()), 1e-300)
    return "(" + ", ".join(f"{round(v / scale, 6) * scale + 0.0:.4g}" for v in x) + ")"
