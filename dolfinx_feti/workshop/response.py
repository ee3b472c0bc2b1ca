# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Response curves: the stresses of a material along a path, and those that were measured there.

With the pressure p of an incompressible material, or p = κ (J − 1), P = ∂Ψ/∂F + p cof F is the
first Piola stress (force per reference area) and σ = J⁻¹ P Fᵀ the Cauchy stress (force per deformed
area).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from dolfinx_feti.runtime.tables import state, table
from dolfinx_feti.workshop.compiled import Material, evaluate
from dolfinx_feti.workshop.equilibrium import cofactor, equilibrate
from dolfinx_feti.workshop.paths import MaterialTest

__all__ = [
    "DataSet",
    "Measure",
    "Response",
    "data_set",
    "r_squared",
    "respond",
    "rms_error",
    "stresses",
]

Array = npt.NDArray[np.float64]
Measure: TypeAlias = Literal["cauchy", "piola"]


@dataclass(frozen=True, slots=True)
class Response:
    """Stresses along a path; ``str`` prints a table.

    All tensors are in the loading frame. States for which no equilibrium was found hold NaN.

    Attributes:
        path: The path.
        F: Deformation gradients, (n, 3, 3).
        p: Pressures, positive in tension [kPa], (n,); zero for a complete energy.
        psi: Energies per unit reference volume, with κ/2 (J − 1)² [kPa], (n,).
        P: First Piola stresses [kPa], (n, 3, 3).
        sigma: Cauchy stresses [kPa], (n, 3, 3).
        converged: Whether the state was found, (n,).
    """

    path: MaterialTest
    F: Array
    p: Array
    psi: Array
    P: Array
    sigma: Array
    converged: npt.NDArray[np.bool_]

    @property
    def J(self) -> Array:
        """Volume ratios det F, (n,)."""
        return _volume_ratio(self.F)

    def __str__(self) -> str:
        """Return a table of stretches and stresses."""
        head = [self.path.symbol]
        columns = [self.path.values]
        for i, k in self.path.measured:
            head += [f"P{i + 1}{k + 1} [kPa]", f"σ{i + 1}{k + 1} [kPa]"]
            columns += [self.P[:, i, k], self.sigma[:, i, k]]
        head += ["F22", "F33", "J"]
        columns += [self.F[:, 1, 1], self.F[:, 2, 2], self.J]
        lines = [
            self.path.name,
            table(head, [list(map(float, row)) for row in zip(*columns, strict=True)]),
        ]
        lost = np.flatnonzero(~self.converged)
        if len(lost):
            where = state(self.path.symbol, self.path.values[lost[0]])
            lines.append(f"no equilibrium in {len(lost)} states, the first at {where}")
        return "\n".join(lines)


def respond(material: Material, path: MaterialTest) -> Response:
    """Compute the stresses of a material along a path.

    Args:
        material: The compiled energy.
        path: Homogeneous deformations, see :mod:`~dolfinx_feti.workshop.paths`.

    Raises:
        ValueError: The material is incompressible, and the path has no free entries.
    """
    equilibria = equilibrate(material, path.F, path.free)
    R, n = path.frame, len(path.F)
    psi, P, F = np.full(n, np.nan), np.full((n, 3, 3), np.nan), R.T @ equilibria.F @ R
    if equilibria.converged.any():
        states = evaluate(material, equilibria.F[equilibria.converged])
        p = equilibria.p[equilibria.converged, None, None] if material.incompressible else 0.0
        psi[equilibria.converged] = states.psi
        P[equilibria.converged] = R.T @ (states.P + p * cofactor(states.F)) @ R
    sigma = P @ F.transpose(0, 2, 1) / _volume_ratio(F)[:, None, None]
    return Response(path, F, equilibria.p, psi, P, sigma, equilibria.converged)


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

    path: MaterialTest
    stress: Array
    measure: Measure
    weight: float
    name: str


def data_set(
    path: MaterialTest,
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


def _volume_ratio(F: Array) -> Array:
    """J, NaN where F is."""
    with np.errstate(invalid="ignore"):
        return np.linalg.det(F)
