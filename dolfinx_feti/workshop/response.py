# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Response curves: computed and measured stresses along a path.

With the pressure p of an incompressible material, or p = κ (J − 1), P = ∂Ψ/∂F + p cof F is the
first Piola stress (force per reference area) and σ = J⁻¹ P Fᵀ the Cauchy stress (force per deformed
area).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

import numpy as np

from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.runtime.values import require_positive, require_type
from dolfinx_feti.workshop.compiled import Material, evaluate
from dolfinx_feti.workshop.equilibrium import cofactor, equilibrate
from dolfinx_feti.workshop.paths import DeformationPath

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["DataSet", "Measure", "Response", "plot_responses", "respond", "stresses"]

Measure: TypeAlias = Literal["cauchy", "piola"]

#: Symbol of each measure in legends.
SYMBOLS: dict[Measure, str] = {"cauchy": "σ", "piola": "P"}


@dataclass(frozen=True, slots=True)
class Response:
    """Stresses along a path, in the loading frame.

    States without equilibrium have NaN.
    """

    path: DeformationPath  #: The path
    F: Array  #: Deformation gradients, (n, 3, 3)
    p: Array  #: Pressures, positive in tension [kPa], (n,); zero for a complete energy
    psi: Array  #: Energies per unit reference volume, with κ/2 (J − 1)² [kPa], (n,)
    P: Array  #: First Piola stresses [kPa], (n, 3, 3)

    @property
    def converged(self) -> Mask:
        """Whether the state was found, (n,)."""
        return np.isfinite(self.p)

    @property
    def J(self) -> Array:
        """Volume ratios det F, (n,)."""
        with np.errstate(invalid="ignore"):
            return np.asarray(np.linalg.det(self.F))

    @property
    def sigma(self) -> Array:
        """Cauchy stresses σ = J⁻¹ P Fᵀ [kPa], (n, 3, 3)."""
        return np.asarray(self.P @ self.F.transpose(0, 2, 1) / self.J[:, None, None])


def respond(material: Material, path: DeformationPath) -> Response:
    """Compute the stresses along a path.

    Raises:
        ValueError: The material is incompressible, and the path has no free entries.
    """
    require_type(Material, material=material)
    require_type(DeformationPath, path=path)
    F, p = equilibrate(material, path.F, path.free)
    R = path.frame
    states = evaluate(material, F)
    pressure = p[:, None, None] if material.incompressible else 0.0
    P = R.T @ (states.P + pressure * cofactor(F)) @ R
    return Response(path, R.T @ F @ R, p, states.psi, P)


@dataclass(frozen=True, slots=True)
class DataSet:
    """Stresses measured along a path.

    Raises:
        ValueError: The stresses are not finite or do not match the path, the measure is unknown, or
            the weight is not positive.
    """

    path: DeformationPath  #: The path, with one state per measurement
    #: Measured [kPa], (n, k), or (n,) if k = 1: σ₁₁ of a uniaxial path, σ₁₁ and σ₂₂ of a biaxial
    #: one, σ₁₂ of shear
    stress: Array
    measure: Measure  #: ``cauchy`` (force per deformed area) or ``piola`` (per reference area)
    weight: float = 1.0  #: Weight of the residuals, one over the noise up to a factor
    name: str = ""  #: Name in tables and pictures, by default that of the path

    def __post_init__(self) -> None:
        """Check the values."""
        values = np.array(self.stress, dtype=np.float64)
        shape = (len(self.path.values), len(self.path.measured))
        has_one_column = shape[1] == 1 and values.shape == shape[:1]
        if values.shape != shape and not has_one_column:
            raise ValueError(
                f"stress has the shape {values.shape}: the {self.path.name} path with {shape[0]} "
                f"states needs {shape}."
            )
        if not np.isfinite(values).all():
            raise ValueError("stress holds values that are not finite: leave those states out.")
        _check_measure(self.measure)
        require_positive(weight=self.weight)
        object.__setattr__(self, "stress", values.reshape(shape))
        object.__setattr__(self, "name", self.name or self.path.name)


def stresses(response: Response, measure: Measure) -> Array:
    """Return the measured components of a response [kPa], (n, k)."""
    _check_measure(measure)
    tensor = response.sigma if measure == "cauchy" else response.P
    return np.column_stack([tensor[:, i, j] for i, j in response.path.measured])


def _check_measure(measure: Measure) -> None:
    """Raise a ValueError if a measure is unknown."""
    if measure not in get_args(Measure):
        raise ValueError(f"measure = {measure!r}: choose 'cauchy' or 'piola'.")


def plot_responses(
    responses: Sequence[Response],
    data: Sequence[DataSet] = (),
    *,
    names: Sequence[str] | None = None,
    measure: Measure = "cauchy",
) -> Figure:
    """Draw stresses over stretches or shears: responses as lines, data sets as points.

    Args:
        responses: Responses, one at least, such as ``Fit.responses``.
        data: Measured stresses, such as ``Fit.data``.
        names: Names of the responses in the legend, by default those of the paths.
        measure: ``cauchy`` or ``piola``, for the responses; each data set has its own measure.

    Raises:
        ValueError: There is no response, the number of names is wrong, or the measure is unknown.
    """
    if not responses:
        raise ValueError("responses is empty: give at least one response.")
    names = [r.path.name for r in responses] if names is None else names
    if len(names) != len(responses):
        raise ValueError(f"names = {names}: give one for each of the {len(responses)} responses.")
    named = zip(names, responses, strict=True)
    curves = [(name, r.path, stresses(r, measure), SYMBOLS[measure]) for name, r in named]
    from matplotlib.figure import Figure  # without the windows of pyplot

    figure = Figure(figsize=(4.8, 3.8), layout="constrained")
    ax = figure.subplots()
    points = [(d.name, d.path, d.stress, SYMBOLS[d.measure]) for d in data]
    for parts, style in ((curves, "-"), (points, "o")):
        for name, path, values, symbol in parts:
            for (i, j), column in zip(path.measured, values.T, strict=True):
                label = f"{name}, {symbol}$_{{{i + 1}{j + 1}}}$"
                ax.plot(path.values, column, style, markersize=4, label=label)
    ax.set_xlabel(" or ".join(sorted({r.path.symbol for r in responses}, reverse=True)))
    ax.set_ylabel({"cauchy": "Cauchy", "piola": "first Piola"}[measure] + " stress [kPa]")
    ax.legend()
    return figure
