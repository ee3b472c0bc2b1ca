# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Data sets: stresses that were measured along a path."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from dolfinx_feti.workshop.paths import Path
from dolfinx_feti.workshop.response import Response

__all__ = ["DataSet", "Measure", "data_set", "r_squared", "rms_error", "stresses"]

Array = npt.NDArray[np.float64]
Measure: TypeAlias = Literal["cauchy", "piola"]


@dataclass(frozen=True, slots=True)
class DataSet:
    """Stresses measured along a path, made by :func:`data_set`.

    Attributes:
        path: The path, with one state per measurement.
        stress: Measured stresses [kPa], (n, k), a column per measured component of the path.
        measure: ``cauchy`` (force per deformed area) or ``piola`` (per reference area).
        weight: Weight w, the reciprocal of the noise up to a common factor.
        name: Name in tables and pictures.
    """

    path: Path
    stress: Array
    measure: Measure
    weight: float
    name: str


def data_set(
    path: Path,
    stress: npt.ArrayLike,
    *,
    measure: Measure,
    weight: float = 1.0,
    name: str | None = None,
) -> DataSet:
    """Join a path and the stresses measured along it.

    Args:
        path: The path, with one state per measurement.
        stress: Measured stresses [kPa], (n,) for one component, or (n, k): σ₁₁ of a uniaxial path,
            σ₁₁ and σ₂₂ of a biaxial one, σ₁₂ of simple shear.
        measure: ``cauchy`` (force per deformed area) or ``piola`` (per reference area).
        weight: Weight of the residuals, the reciprocal of the noise up to a common factor.
        name: Name in tables and pictures, by default that of the path.

    Raises:
        ValueError: The stresses do not match the path, or are not finite; the measure is unknown,
            or the weight not positive.
    """
    values = np.array(stress, dtype=np.float64)
    shape = (len(path.values), len(path.measured))
    if values.shape != shape and values.shape != shape[: 2 - (shape[1] == 1)]:
        raise ValueError(
            f"stress has the shape {values.shape}: the {path.name} path with {shape[0]} states "
            f"needs {shape}."
        )
    if not np.isfinite(values).all():
        raise ValueError("stress holds values that are not finite: leave those states out.")
    if measure not in ("cauchy", "piola"):
        raise ValueError(f"measure = {measure!r}: choose 'cauchy' or 'piola'.")
    if not 0.0 < weight < math.inf:
        raise ValueError(f"weight = {weight}: give a positive number.")
    return DataSet(path, values.reshape(shape), measure, weight, name or path.name)


def stresses(response: Response, measure: Measure) -> Array:
    """Return the measured components of a response [kPa], (n, k)."""
    tensor = response.sigma if measure == "cauchy" else response.P
    return np.column_stack([tensor[:, i, j] for i, j in response.path.measured])


def rms_error(response: Response, d: DataSet) -> float:
    """Root mean square of the differences between computed and measured stresses [kPa]."""
    return float(np.sqrt(np.mean((stresses(response, d.measure) - d.stress) ** 2)))


def r_squared(response: Response, d: DataSet) -> float:
    """Share of the variance that is explained, 1 − Σ (s − ŝ)²/Σ (ŝ − mean)²; NaN for a constant."""
    spread = np.sum((d.stress - d.stress.mean(axis=0)) ** 2)
    error = np.sum((stresses(response, d.measure) - d.stress) ** 2)
    return float(1 - error / spread) if spread > 0 else math.nan
