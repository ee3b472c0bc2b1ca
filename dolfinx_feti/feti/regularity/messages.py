# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Error messages for singular matrices: the motions that nothing resists, and remedies.

A message counts the translations and rotations of each body, and gives the point where a mechanism
is largest. A motion F y is a translation if each component equals its mean over the body,
:math:`(F - \bar F)^⊤ (F - \bar F)\, y = 0`.
"""

from __future__ import annotations

import numpy as np

from dolfinx_feti.errors import SetUpError, SingularError
from dolfinx_feti.feti.regularity.rigid_motions import RigidMotions
from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.runtime.collective import bounding_box, total_of
from dolfinx_feti.torn.matrix import Torn

#: Largest number of bodies that a message describes; it counts the others. It keeps the message
#: readable, nothing else depends on it.
MAX_DESCRIBED = 3

#: ‖F − F̄‖² of a motion of size one below which it is a translation. Translations have about 1e-16,
#: by rounding. The only rotations below this limit have an axis 1e5 diameters away from the body.
MAX_TRANSLATION_VARIANCE = 1e-10

#: Quotient of the largest and the smallest diagonal entry of A above which a message blames small
#: coefficients. A force below about 1e-14 of the largest diagonal entry counts as rounding, and a
#: soft support with such a force goes unnoticed. At a quotient of 1e10, that is a force below 1e-4
#: of the support's own diagonal entries, as a void around a large island has. At 1e8 it would be a
#: force below 1e-6 of them, which does not occur.
UNEVEN_DIAGONAL = 1e10

#: Decimals of a coordinate relative to the largest one of its point. Smaller parts are rounding
#: errors, which a message should print as zero; it prints four digits of a coordinate.
COORDINATE_DECIMALS = 6

NEARLY_SINGULAR = (
    "The assembled problem is singular up to rounding: it resists every motion, but one of them so "
    "little that the coarse matrix has a zero pivot. Look at the Dirichlet conditions and for "
    "coefficients that nearly vanish."
)

NULL_SPACE_INSIDE = (
    "The null space of A, or a part of it, lies inside of a subdomain that is not glued to others: "
    "tear each body into two subdomains, at least."
)

INACCURATE_SOLVER = "The coarse solver leaves a backward error of {:.1e}: look at the options -{}…"

SINGULAR_INTERIOR = (
    "The matrix of the interior of a subdomain is singular up to rounding ({} motions, of "
    "subdomains on process {}), though the interface resists them: the assembled matrix is "
    "indefinite or nearly singular. In Newton's method take smaller steps; raise coefficients that "
    "are tiny beside others, such as that of a void; otherwise take other subdomains, or the "
    "options feti_interior keep and feti_pc_type lumped."
)

UNEVEN_SCALES = (
    "The assembled problem is singular up to rounding: {} no more force than rounding errors. "
    "Coefficients of very different scales may be the reason (the diagonal of A spans {:.0e}): "
    "raise the smallest, such as that of a void, to 1e-9 of the largest, or connect loose parts."
)

REMEDY = (
    "Add Dirichlet conditions, connect loose parts, or give A this null space (null_space= of a "
    "problem, A.setNullSpace of a matrix)."
)


def singular_error(rigid: RigidMotions, mechanisms: Array) -> SingularError:
    """Return the error that describes motions that nothing resists. Collective.

    Args:
        rigid: Rigid motions of the bodies.
        mechanisms: Motions that are not rigid, on the torn dofs, (n, k).
    """
    torn = rigid.torn
    x = torn.coordinates()
    count = mechanisms.shape[1]
    place = _place_of_largest(torn, x, mechanisms[:, 0]) if count else ""
    quotient = rigid.matrix.diagonal_quotient()
    if not rigid.total and quotient > UNEVEN_DIAGONAL:
        motions = f"{count} motions that are not rigid{place} cause"
        if count == 1:
            motions = f"1 motion that is not rigid{place} causes"
        return SingularError(UNEVEN_SCALES.format(motions, quotient))
    parts = _describe_bodies(rigid, x)
    if count == 1:
        parts.append(f"nothing resists a motion that is not rigid{place}")
    elif count:
        parts.append(f"nothing resists {count} motions that are not rigid{place}")
    total = rigid.total + count
    return SingularError(
        f"The assembled problem is singular, with a kernel of dimension {total}: "
        f"{'; '.join(parts)}. {REMEDY}"
    )


def singular_interior_error(counts: list[int]) -> SingularError:
    """Return the error of singular interiors of subdomains that the interface supports.

    Args:
        counts: Number of null vectors of the interiors on each process.
    """
    processes = ", ".join(str(rank) for rank, count in enumerate(counts) if count)
    return SingularError(SINGULAR_INTERIOR.format(sum(counts), processes))


def inaccurate_solver_error(backward_error: float, prefix: str) -> SetUpError:
    """Return the error of a coarse solver with this backward error and prefix of its options."""
    return SetUpError(INACCURATE_SOLVER.format(backward_error, prefix))


def _describe_bodies(rigid: RigidMotions, x: Array | None) -> list[str]:
    """Return a phrase for each of the first bodies that can move. Collective.

    Args:
        rigid: Rigid motions of the bodies.
        x: Coordinates of the torn dofs, (n, d), nan for dofs without a point; None if not known.
    """
    moving = np.flatnonzero(rigid.dimensions)
    parts = [_describe_body(rigid, x, int(b)) for b in moving[:MAX_DESCRIBED]]
    if len(moving) > MAX_DESCRIBED:
        parts.append(f"{len(moving) - MAX_DESCRIBED} more parts are free")
    return parts


def _describe_body(rigid: RigidMotions, x: Array | None, b: int) -> str:
    """Return a phrase with the place of body b and its motions. Collective.

    Args:
        rigid: Rigid motions of the bodies.
        x: Coordinates of the torn dofs, (n, d), nan for dofs without a point; None if not known.
        b: Number of the body.
    """
    torn = rigid.torn
    count = rigid.bodies.count
    of_body = rigid.bodies.label == b
    if x is not None:
        of_body &= np.isfinite(x[:, 0])
    motions = _count_kinds(torn, of_body, rigid.fields[of_body, : rigid.dimensions[b]])
    freedom = f"the Dirichlet conditions leave {motions} free"
    if count == 1:
        return freedom
    place = "" if x is None else f" around {_middle(torn, x[of_body])}"
    return f"in a part that is not connected to the rest ({b + 1} of {count}{place}) {freedom}"


def _count_kinds(torn: Torn, of_body: Mask, F: Array) -> str:
    """Return the numbers of translations and rotations among rigid motions. Collective.

    Args:
        torn: The torn matrix.
        of_body: Mask of the dofs of the body, (n,).
        F: Motions on these dofs, (dofs of the body, m).
    """
    bs = torn.A.getBlockSize()
    comm = torn.comm
    if bs == 1:
        return "a constant"
    is_component = np.eye(bs)[np.flatnonzero(of_body) % bs]  # (dofs of the body, bs)
    gram = total_of(F.T @ F, comm)
    sums = total_of(is_component.T @ F, comm)
    number = np.maximum(total_of(is_component.sum(axis=0), comm), 1.0)
    variance = gram - sums.T @ (sums / number[:, None])  # (F − F̄)ᵀ (F − F̄)
    shares = np.linalg.eigvals(np.linalg.pinv(gram, hermitian=True) @ variance).real
    rotations = int(np.count_nonzero(shares > MAX_TRANSLATION_VARIANCE))
    translations = len(shares) - rotations
    kinds = ((translations, "translation"), (rotations, "rotation"))
    return " and ".join(_plural(count, kind) for count, kind in kinds if count)


def _plural(count: int, noun: str) -> str:
    """Return a number with its noun."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _middle(torn: Torn, x: Array) -> str:
    """Return the middle of the bounding box of points, (n, d) on each process. Collective."""
    low, high = bounding_box(x, torn.comm)
    return _point(0.5 * (low + high))


def _place_of_largest(torn: Torn, x: Array | None, w: Array) -> str:
    """Return a phrase with the point where a field is largest; empty if not known. Collective.

    Args:
        torn: The torn matrix.
        x: Coordinates of the torn dofs, (n, d), nan for dofs without a point; None if not known.
        w: Field on the torn dofs, (n,).
    """
    if x is None:
        return ""
    bs = torn.A.getBlockSize()
    size = np.where(np.isfinite(x[::bs, 0]), np.linalg.norm(w.reshape(-1, bs), axis=1), 0.0)
    largest: tuple[float, list[float]] = (-1.0, [])
    if len(size):
        i = int(size.argmax())
        largest = (float(size[i]), x[bs * i].tolist())
    _, point = max(torn.comm.allgather(largest))  # the largest size first, then the point
    return f", largest at {_point(np.array(point))}"


def _point(x: Array) -> str:
    """Return the coordinates of a point, (d,), as text."""
    scale = max(float(np.abs(x).max()), 1e-300)
    rounded = [
        round(value / scale, COORDINATE_DECIMALS) * scale + 0.0 for value in x
    ]  # −0.0 + 0.0 = 0.0
    return "(" + ", ".join(f"{value:.4g}" for value in rounded) + ")"
