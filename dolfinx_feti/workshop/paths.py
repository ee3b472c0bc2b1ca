# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Homogeneous deformations of the material tests: uniaxial, biaxial, pure and simple shear.

In the loading frame (e₁, e₂, e₃) a path prescribes some entries of F. The others are *free*: the
stresses P conjugate to them vanish, and :mod:`~dolfinx_feti.workshop.equilibrium` solves for them.

=================== === ==== ==== ===========================
path                F₁₁ F₂₂  F₁₂  free
=================== === ==== ==== ===========================
uniaxial            λ   free free F₂₂, F₃₃, F₁₂, F₁₃ and F₂₃
biaxial             λ   λ₂   0    F₃₃, F₁₃ and F₂₃
equibiaxial         λ   λ    0    likewise
pure shear          λ   1    0    likewise
inflation–extension λ   λ_z  0    likewise
simple shear        1   1    γ    likewise
=================== === ==== ==== ===========================

F₂₁ = F₃₁ = F₃₂ = 0 determines the rotation. In uniaxial tension σ₁₁ is the only stress, and the
specimen shears if fibres are oblique. In the other tests the face normal to e₃ is free, and clamps
prevent shear.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.values import require_positive

__all__ = [
    "STANDARD_PATHS",
    "DeformationPath",
    "biaxial",
    "equibiaxial",
    "inflation",
    "pure_shear",
    "simple_shear",
    "uniaxial",
]

#: Cosine of the angle between e₁ and e₂ up to which they are normal: a rounding margin.
NORMAL_ATOL = 1e-10

#: Default direction e₁.
E1 = (1.0, 0.0, 0.0)

#: Default direction e₂.
E2 = (0.0, 1.0, 0.0)

#: Indices of the entries F₃₃, F₁₃ and F₂₃, which are free in a sheet.
OUT_OF_PLANE = ((2, 2), (0, 2), (1, 2))


@dataclass(frozen=True, slots=True)
class DeformationPath:
    """A path of homogeneous deformations, those of a material test one after the other."""

    name: str  #: Name of the test
    symbol: str  #: Letter of its values, λ or γ
    values: Array  #: Stretch λ or amount of shear γ, (n,)
    F: Array  #: Deformation gradients, (n, 3, 3); the free entries are guesses with det F = 1
    free: Array  #: Directions of the free entries in the space of F, (k, 3, 3), orthonormal
    frame: Array  #: Loading directions e₁, e₂ and e₃ as columns, (3, 3), a rotation
    measured: tuple[tuple[int, int], ...]  #: Indices of the stresses that a test measures


def uniaxial(stretch: npt.ArrayLike, *, along: Sequence[float] = E1) -> DeformationPath:
    """Uniaxial tension or compression.

    Args:
        stretch: λ along e₁, positive, (n,).
        along: Direction e₁, of any length.

    Raises:
        ValueError: A stretch is not positive, or the direction is zero.
    """
    stretch = _stretches("stretch", stretch)
    e1 = _unit("along", along)
    axis = np.eye(3)[np.argmin(np.abs(e1))]
    F = _diagonal(stretch, stretch**-0.5)
    free = ((1, 1), *OUT_OF_PLANE, (0, 1))
    return _path("uniaxial", "λ", stretch, F, free, (e1, axis - (axis @ e1) * e1), ((0, 0),))


def biaxial(
    stretch: npt.ArrayLike,
    stretch_2: npt.ArrayLike,
    *,
    along: Sequence[float] = E1,
    across: Sequence[float] = E2,
    name: str = "biaxial",
) -> DeformationPath:
    """Biaxial tension of a sheet.

    Args:
        stretch: λ along e₁, positive, (n,); the values of the path.
        stretch_2: Stretch along e₂, positive, (n,) or a number.
        along: Direction e₁, of any length.
        across: Direction e₂, normal to e₁.
        name: Name of the test.

    Raises:
        ValueError: A stretch is not positive, the numbers of λ₂ and λ differ, or the directions are
            not normal to each other.
    """
    stretch = _stretches("stretch", stretch)
    second = _stretches("stretch_2", stretch_2)
    if len(second) not in (1, len(stretch)):
        raise ValueError(
            f"stretch has {len(stretch)} values and stretch_2 has {len(second)}: give as many."
        )
    F = _diagonal(stretch, np.broadcast_to(second, stretch.shape))
    return _path(name, "λ", stretch, F, OUT_OF_PLANE, (along, across), ((0, 0), (1, 1)))


def equibiaxial(
    stretch: npt.ArrayLike, *, along: Sequence[float] = E1, across: Sequence[float] = E2
) -> DeformationPath:
    """Equibiaxial tension of a sheet.

    Args:
        stretch: λ along e₁ and e₂, positive, (n,).
        along: Direction e₁, of any length.
        across: Direction e₂, normal to e₁.

    Raises:
        ValueError: A stretch is not positive, or directions are not normal.
    """
    return biaxial(stretch, stretch, along=along, across=across, name="equibiaxial")


def pure_shear(
    stretch: npt.ArrayLike, *, along: Sequence[float] = E1, across: Sequence[float] = E2
) -> DeformationPath:
    """Tension of a wide sheet of constant width (planar tension).

    Args:
        stretch: λ along e₁, positive, (n,); the stretch along e₂ is 1.
        along: Direction e₁, of any length.
        across: Direction e₂, normal to e₁.

    Raises:
        ValueError: A stretch is not positive, or directions are not normal.
    """
    return biaxial(stretch, 1.0, along=along, across=across, name="pure shear")


def inflation(
    stretch: npt.ArrayLike,
    *,
    axial: float = 1.1,
    along: Sequence[float] = E1,
    across: Sequence[float] = E2,
) -> DeformationPath:
    """Inflation of a thin tube with circumference e₁ at a fixed axial stretch along e₂.

    Args:
        stretch: λ along e₁, positive, (n,).
        axial: λ_z along e₂, positive.
        along: Circumferential direction e₁, of any length.
        across: Axial direction e₂, normal to e₁.

    Raises:
        ValueError: A stretch is not positive, or directions are not normal.
    """
    require_positive(axial=axial)
    return biaxial(stretch, axial, along=along, across=across, name="inflation–extension")


def simple_shear(
    shear: npt.ArrayLike, *, along: Sequence[float] = E1, across: Sequence[float] = E2
) -> DeformationPath:
    """Simple shear F = I + γ e₁ ⊗ e₂, with F₃₃ free.

    Args:
        shear: γ, (n,).
        along: Direction e₁ of the shear, of any length.
        across: Normal e₂ of the sliding planes, normal to e₁.

    Raises:
        ValueError: A value is not finite, or the directions are not normal to each other.
    """
    shear = _numbers("shear", shear)
    F = np.tile(np.eye(3), (len(shear), 1, 1))
    F[:, 0, 1] = shear
    return _path("simple shear", "γ", shear, F, OUT_OF_PLANE, (along, across), ((0, 1),))


#: The paths of :func:`~dolfinx_feti.workshop.report.check`, by the symbol of their values.
STANDARD_PATHS: Mapping[str, tuple[Callable[[npt.ArrayLike], DeformationPath], ...]] = {
    "λ": (uniaxial, equibiaxial, pure_shear, inflation),
    "γ": (simple_shear,),
}


def _path(
    name: str,
    symbol: str,
    values: Array,
    F: Array,
    free: Sequence[tuple[int, int]],
    directions: tuple[npt.ArrayLike, npt.ArrayLike],
    measured: tuple[tuple[int, int], ...],
) -> DeformationPath:
    """Return a path.

    Args:
        name: Name of the test.
        symbol: Letter of the values.
        values: Stretches or amounts of shear, (n,).
        F: Deformation gradients in the loading frame, (n, 3, 3).
        free: Indices of the free entries in the loading frame.
        directions: e₁ and e₂, of any length.
        measured: Indices of the stresses that a test measures.

    Raises:
        ValueError: The directions are zero, or not normal to each other.
    """
    e1 = _unit("along", directions[0])
    e2 = _unit("across", directions[1])
    if abs(e1 @ e2) > NORMAL_ATOL:
        raise ValueError(
            f"along = {directions[0]} and across = {directions[1]} are not normal to each other: "
            "give directions at right angles."
        )
    R = np.column_stack((e1, e2, np.cross(e1, e2)))
    units = np.zeros((len(free), 3, 3))
    units[np.arange(len(free)), *np.transpose(free)] = 1.0
    return DeformationPath(name, symbol, values, R @ F @ R.T, R @ units @ R.T, R, measured)


def _unit(name: str, direction: npt.ArrayLike) -> Array:
    """Return a unit vector, (3,).

    Raises:
        ValueError: The direction is zero, or is not three finite components.
    """
    vector = np.array(direction, dtype=np.float64)
    length = np.linalg.norm(vector)
    if vector.shape != (3,) or not 0.0 < length < np.inf:
        raise ValueError(f"{name} = {direction!r}: give three numbers, not all of them zero.")
    return vector / length


def _diagonal(first: Array, second: Array) -> Array:
    """Return diag(λ₁, λ₂, 1/(λ₁ λ₂)), (n, 3, 3)."""
    return np.stack((first, second, 1 / (first * second)), axis=1)[:, None] * np.eye(3)


def _stretches(name: str, values: npt.ArrayLike) -> Array:
    """Return stretches, (n,).

    Raises:
        ValueError: One is not positive or not finite.
    """
    numbers = _numbers(name, values)
    if numbers.min() <= 0:
        raise ValueError(
            f"{name} has the value {numbers.min()}: a stretch is positive, and 1 at rest."
        )
    return numbers


def _numbers(name: str, values: npt.ArrayLike) -> Array:
    """Return numbers, (n,).

    Raises:
        ValueError: There is no number, or one is not finite.
    """
    numbers = np.atleast_1d(np.array(values, dtype=np.float64))
    if numbers.ndim != 1 or not len(numbers) or not np.isfinite(numbers).all():
        raise ValueError(f"{name} = {values!r}: give finite numbers, one per state.")
    return numbers
