# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Description of the motions that nothing resists, for the message of an error.

.. math:: r(x) = a + ω × (x - c)

fits a rigid motion of a body to the coordinates x of its dofs, (n,); row echelon form in (ω, a) has
translations along axes, and rotations. Without directions in space, the motions are constants.
"""

from __future__ import annotations

import numpy as np

from dolfinx_feti.feti.regularity.motions import Motions
from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.torn.matrix import Torn

__all__ = ["describe"]


#: A coefficient below this share of the largest one is zero, as a fit has some ten digits.
NEGLIGIBLE = 1e-6

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
    """Name the motions of one body."""
    torn, count, mine = rigid.torn, rigid.bodies.count, rigid.bodies.label == b
    if x is not None:
        mine &= np.isfinite(x[:, 0])  # the others are at no point
    names = _names(torn, mine, rigid.fields[:, : rigid.dimensions[b]], x)
    said = f"the Dirichlet conditions leave {names} free"
    if count == 1:
        return said
    where = "" if x is None else f" around {_point(_extent(torn, x[mine])[0])}"
    return f"in a part that is not connected to the rest ({b + 1} of {count}{where}) {said}"


def _names(torn: Torn, mine: Mask, fields: Array, x: Array | None) -> str:
    """Name rigid motions; ``mine`` marks the torn dofs of the body."""
    bs, m = torn.A.getBlockSize(), fields.shape[1]
    if bs == 1:
        return "a constant"
    if x is None:
        return f"{m} rigid motion(s) (set_near_kernel with coordinates lets the solver name them)"
    component = np.arange(torn.n)[mine] % bs
    if bs != x.shape[1]:
        rows = _echelon(_fit(torn, np.eye(bs)[component], fields[mine]))
        return _together([_direction("a constant", "in component", a, "0123456789") for a in rows])
    centre, length = _extent(torn, x[mine])
    arm = np.pad((x[mine] - centre) / length, ((0, 0), (0, 3 - bs)))
    axes = np.eye(3) if bs == 3 else np.eye(3)[2:]
    turned = np.stack([np.cross(axis, arm) for axis in axes], axis=-1)  # (dofs, 3, axes)
    shapes = np.hstack([turned[np.arange(len(arm)), component], np.eye(bs)[component]])
    if m == shapes.shape[1]:
        return "all rigid motions"
    rows = _echelon(_fit(torn, shapes, fields[mine]))
    return _together([_motion(row, centre, length) for row in rows])


def _fit(torn: Torn, shapes: Array, fields: Array) -> Array:
    """Return the coefficients of fields in shapes, by least squares over all processes, (m, k)."""
    gram, right = (torn.comm.allreduce(shapes.T @ part) for part in (shapes, fields))
    return np.linalg.lstsq(gram, right, rcond=1e-12)[0].T


def _echelon(rows: Array) -> Array:
    """Return the reduced row echelon form, without rows of zeros."""
    rows = rows / np.abs(rows).max()
    done = 0
    for j in range(rows.shape[1]):
        if done == len(rows):
            break
        pivot = done + int(np.abs(rows[done:, j]).argmax())
        if abs(rows[pivot, j]) < NEGLIGIBLE:
            continue
        rows[[done, pivot]] = rows[[pivot, done]]
        rows[done] /= rows[done, j]
        others = np.arange(len(rows)) != done
        rows[others] -= np.outer(rows[others, j], rows[done])
        done += 1
    rows[np.abs(rows) < NEGLIGIBLE] = 0.0
    return np.asarray(rows[:done])


def _motion(row: Array, centre: Array, length: float) -> str:
    """Name the motion a + ω × (x − c)/L, given as (ω, a)."""
    dim = len(centre)
    ω, a = row[:-dim], row[-dim:]
    if not ω.any():
        return _direction("a translation", "in", a, "xyz")
    if dim == 2:
        point = centre + length * np.array([-a[1], a[0]]) / ω[0]
        return f"a rotation about {_point(point, length)}"
    size = ω @ ω
    along = a @ ω / size
    point = centre + length * np.cross(ω, a - along * ω) / size
    kind = "a rotation" if abs(along) < NEGLIGIBLE else "a screw motion"
    return f"{kind} about the axis {_point(ω / np.sqrt(size))} through {_point(point, length)}"


def _direction(what: str, link: str, a: Array, axes: str) -> str:
    """Name a direction, by its axis if it is one."""
    if np.count_nonzero(a) == 1:
        return f"{what} {link} {axes[int(np.flatnonzero(a)[0])]}"
    return f"{what} along {_point(a / np.linalg.norm(a))}"


def _together(names: list[str]) -> str:
    """Join names, those of several translations along axes into one."""
    first = "a translation in "
    axes = [name.removeprefix(first) for name in names if name.startswith(first)]
    if len(axes) > 1:
        names = [name for name in names if not name.startswith(first)]
        names.append(f"translations in {', '.join(axes[:-1])} and {axes[-1]}")
    return ", ".join(names[:-1]) + " and " + names[-1] if len(names) > 1 else names[0]


def _extent(torn: Torn, x: Array) -> tuple[Array, float]:
    """Return the middle of points over all processes, and half the diagonal of their box."""
    ends = x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)
    lows, highs = zip(*torn.comm.allgather(ends), strict=True)
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)
    return 0.5 * (low + high), float(0.5 * np.linalg.norm(high - low)) or 1.0


def _largest(torn: Torn, x: Array | None, w: Array) -> str:
    """Say where a field is largest."""
    if x is None:
        return ""
    bs = torn.A.getBlockSize()
    size = np.where(np.isfinite(x[::bs, 0]), np.linalg.norm(w.reshape(-1, bs), axis=1), 0.0)
    i = int(size.argmax()) if len(size) else 0
    own = (float(size[i]), x[bs * i].tolist()) if len(size) else (-1.0, [])
    return f", largest at {_point(np.array(max(torn.comm.allgather(own))[1]))}"


def _point(x: Array, size: float = 0.0) -> str:
    """Write coordinates, without what is rounding on a body of some size."""
    scale = max(float(np.abs(x).max()), size, 1e-300)
    return "(" + ", ".join(f"{round(v / scale, 6) * scale + 0.0:.4g}" for v in x) + ")"
