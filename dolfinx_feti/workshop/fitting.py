# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Parameters of an energy from material tests, by least squares (docs/fitting.md).

The parameters θ minimise Σ w² (s(θ) − ŝ)² over measured stresses ŝ. With the Jacobian R of the n
residuals and their squares q the covariance is s² (Rᵀ R)⁻¹, s² = q/(n − m), and intervals are those
of Student's t with n − m degrees of freedom (Seber, Wild, Nonlinear Regression, 1989, ch. 5).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.optimize
import scipy.stats

from ufl.core.expr import Expr

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.mechanics.values import require_within
from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.runtime.tables import Cell, state, table
from dolfinx_feti.workshop.compiled import Material, compile_material
from dolfinx_feti.workshop.response import DataSet, Response, respond, stresses

__all__ = ["Fit", "fit", "uncertainty"]

#: Distance from a bound, relative to the parameter, at which it is on the bound.
TOUCH = 1e-6

#: Singular value of the Jacobian with unit columns below which parameters cannot be told apart.
BLIND = 1e-7


@dataclass(frozen=True, slots=True)
class Fit:
    """A fit; ``str`` prints its tables."""

    material: Material  #: The material with the fitted parameters
    #: Confidence intervals; NaN on a bound, infinite if the data do not determine a parameter
    intervals: dict[str, tuple[float, float]]
    covariance: Array  #: Covariance of the parameters, (m, m); NaN for one on a bound
    confidence: float  #: Level of the intervals
    data: tuple[DataSet, ...]  #: The data sets
    responses: tuple[Response, ...]  #: The fitted stresses, a response per data set

    @property
    def values(self) -> dict[str, float]:
        """Values of the parameters by their names."""
        return dict(self.material.parameters)

    @property
    def correlation(self) -> Array:
        """Correlation of the parameters, (m, m)."""
        deviation = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore"):  # inf/inf of what the data do not determine
            return self.covariance / np.outer(deviation, deviation)

    def __str__(self) -> str:
        """Return a table of the parameters and one of the data sets."""
        parameters, sets = list[list[Cell]](), list[list[Cell]]()
        for name, (low, high) in self.intervals.items():
            bound = math.isnan(low)
            remark = "on its bound" if bound else "not determined by the data" * math.isinf(low)
            ends: list[Cell] = [None] * 2 if bound else [low, high]
            parameters.append([name, self.values[name], *ends, remark])
        for d, response in zip(self.data, self.responses, strict=True):
            error = stresses(response, d.measure) - d.stress
            variance = np.sum((d.stress - d.stress.mean(axis=0)) ** 2)
            explained = 1 - np.sum(error**2) / variance if variance > 0 else math.nan
            sets.append([d.name, len(error), float(np.sqrt(np.mean(error**2))), float(explained)])
        level = f"{100 * self.confidence:g} % confidence"
        return (
            table(["parameter", "value", level, "", ""], parameters)
            + "\n\n"
            + table(["data set", "states", "rms error [kPa]", "R²"], sets)
        )


def fit(
    psi: Callable[..., Expr],
    data: Sequence[DataSet],
    start: Mapping[str, float],
    *,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    kappa: float = math.inf,
    confidence: float = 0.95,
    jit_options: Mapping[str, Any] | None = None,
) -> Fit:
    """Fit parameters of an energy to data, all sets at once.

    Args:
        psi: Energy, as in ``compile_material``, that takes the parameters by their names.
        data: Data sets.
        start: Names of the parameters, and values to begin with.
        bounds: Least and largest value of some or all parameters.
        kappa: As in ``compile_material``, and ``jit_options``, too.
        confidence: Level of the confidence intervals.
        jit_options: Options of dolfinx's compiler; by default ``-O1``.

    Raises:
        ValueError: There are no more data than parameters, or the start or a bound is no
            admissible number.
        TypeError: ``psi`` does not take the parameters.
        ConvergenceError: There is no equilibrium at the start, or the least-squares method failed.
    """
    names, data = list(start), tuple(data)
    n = sum(d.stress.size for d in data)
    if not names or n <= len(names):
        raise ValueError(f"{n} measured stresses cannot determine the parameters {names}.")
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence = {confidence}: give a level such as 0.95.")
    limits = _limits(start, bounds or {})
    material = compile_material(psi, kappa=kappa, parameters=start, jit_options=jit_options)
    _check_start(material, data)

    def trial(values: Array) -> Material:
        return material.with_parameters(**dict(zip(names, map(float, values), strict=True)))

    def residuals(values: Array) -> Array:
        candidate = trial(values)
        errors = (stresses(respond(candidate, d.path), d.measure) - d.stress for d in data)
        parts = [d.weight * error.ravel() for d, error in zip(data, errors, strict=True)]
        return np.concatenate(parts)

    first = np.array(list(start.values()), dtype=np.float64)
    optimum = _minimise(residuals, first, limits)
    x = optimum.x
    reach = TOUCH * np.maximum(np.abs(x), np.abs(first))
    free = (np.abs(x - limits) > reach).all(axis=0)
    C, half = uncertainty(optimum.jac, 2 * optimum.cost, free, confidence)
    ends = zip((x - half).tolist(), (x + half).tolist(), strict=True)
    responses = tuple(respond(trial(x), d.path) for d in data)
    intervals = dict(zip(names, ends, strict=True))
    return Fit(trial(x), intervals, C, confidence, data, responses)


def uncertainty(R: Array, squares: float, free: Mask, confidence: float) -> tuple[Array, Array]:
    """Return s² (Rᵀ R)⁻¹, (m, m), and half the widths of the confidence intervals, (m,).

    Parameters that are not ``free`` have NaN; what the residuals do not determine is infinite.
    """
    freedom = len(R) - int(free.sum())
    lengths = np.linalg.norm(R[:, free], axis=0)
    lengths[lengths == 0] = 1.0
    _, s, Vt = np.linalg.svd(R[:, free] / lengths, full_matrices=False)
    seen = s > BLIND * s.max(initial=0.0)
    V = Vt[seen].T / s[seen]
    C = squares / freedom * (V @ V.T) / np.outer(lengths, lengths)  # s² (Rᵀ R)⁻¹
    blind = (np.abs(Vt[~seen]) > 1e-3).any(axis=0)
    C[blind], C[:, blind] = np.inf, np.inf
    covariance = np.full((len(free), len(free)), np.nan)
    covariance[np.ix_(free, free)] = C
    t = float(scipy.stats.t.ppf((1 + confidence) / 2, freedom))
    return covariance, t * np.sqrt(np.diag(covariance))


def _minimise(
    residuals: Callable[[Array], Array], start: Array, limits: Array
) -> scipy.optimize.OptimizeResult:
    """Least squares within the limits, (2, m)."""
    try:
        bounds, exact = (limits[0], limits[1]), {"ftol": 1e-12, "xtol": 1e-10, "gtol": 1e-12}
        optimum = scipy.optimize.least_squares(
            residuals, start, jac="3-point", bounds=bounds, x_scale="jac", **exact
        )
    except (ValueError, np.linalg.LinAlgError) as error:  # NaN in the differences
        raise ConvergenceError(
            "The fit came to parameters without equilibrium at some measured state: give bounds, "
            "or another start."
        ) from error
    if not optimum.success:
        raise ConvergenceError(
            f"The fit did not converge within {optimum.nfev} evaluations; the last values are "
            f"{optimum.x.tolist()}: start from there, give bounds, or fewer parameters."
        )
    return optimum


def _check_start(material: Material, data: Sequence[DataSet]) -> None:
    """Require equilibria at the start."""
    for d in data:
        response = respond(material, d.path)
        lost = np.flatnonzero(~np.isfinite(stresses(response, d.measure)).all(axis=1))
        if len(lost):
            where = state(d.path.symbol, d.path.values[lost[0]])
            raise ConvergenceError(
                f"With start = {dict(material.parameters)} there is no equilibrium at {len(lost)} "
                f"states of {d.name}, the first at {where}: start from softer fibres, for instance."
            )


def _limits(start: Mapping[str, float], bounds: Mapping[str, tuple[float, float]]) -> Array:
    """Return least and largest values, (2, m)."""
    require_within(-math.inf, math.inf, start, remedy="a finite value")
    unknown = set(bounds) - set(start)
    if unknown:
        raise ValueError(f"bounds has {sorted(unknown)}, which start has not.")
    limits = np.array([bounds.get(name, (-np.inf, np.inf)) for name in start], dtype=np.float64).T
    for name, value, low, high in zip(start, start.values(), *limits, strict=True):
        if not (low < high and low <= value <= high):
            raise ValueError(f"start has {name} = {value}, bounds ({low}, {high}): start inside.")
    return limits
