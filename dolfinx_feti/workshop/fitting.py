# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Parameters of an energy from material tests, by least squares (docs/fitting.md).

The m parameters θ minimise q = Σ w² (s(θ) − ŝ)² over n measured stresses ŝ. With the Jacobian R of
the residuals at the minimum, the covariance of θ is q/(n − m) (Rᵀ R)⁻¹. Intervals are those of
Student's t with n − m degrees of freedom (Seber, Wild, Nonlinear Regression, 1989, ch. 5). A
parameter on a bound counts as given.
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
from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.runtime.values import require_within
from dolfinx_feti.text_tables import Cell, format_value, text_table
from dolfinx_feti.workshop.compiled import Material, compile_material
from dolfinx_feti.workshop.response import DataSet, Response, respond, stresses

__all__ = ["Fit", "fit", "uncertainty"]

#: Distance from a bound, relative to the parameter, up to which a parameter is on the bound: the
#: optimisation stays inside, at a distance of about its tolerance.
BOUND_RTOL = 1e-6

#: Singular value of the Jacobian, with unit columns, up to which the data do not determine a
#: combination of parameters. Differences of the residuals have relative errors of 1e-10 and more.
SINGULAR_RTOL = 1e-7

#: Component of an undetermined combination above which a parameter counts as part of it.
MIN_COMPONENT = 1e-3

#: Relative change of the sum of squares at which the fit ends: far below errors of measurement, so
#: intervals do not depend on it.
FIT_FTOL = 1e-12

#: Size of the gradient of the sum of squares at which the fit ends, for the same reason.
FIT_GTOL = 1e-12

#: Relative change of the parameters at which the fit ends, of the order of the errors of R.
FIT_XTOL = 1e-10


@dataclass(frozen=True, slots=True)
class Fit:
    """The result of a fit; ``str`` prints its tables."""

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
        with np.errstate(invalid="ignore"):  # inf/inf for undetermined parameters
            return self.covariance / np.outer(deviation, deviation)

    def __str__(self) -> str:
        """Return a table of the parameters and one of the data sets."""
        parameters = [self._parameter_row(name) for name in self.intervals]
        pairs = zip(self.data, self.responses, strict=True)
        data_sets = [_data_set_row(data_set, response) for data_set, response in pairs]
        level = f"{100 * self.confidence:g} % confidence"
        return (
            text_table(["parameter", "value", level, "", ""], parameters)
            + "\n\n"
            + text_table(["data set", "states", "rms error [kPa]", "R²"], data_sets)
        )

    def _parameter_row(self, name: str) -> list[Cell]:
        """Return the row of a parameter: its name, value, interval, and a remark."""
        low, high = self.intervals[name]
        value = self.values[name]
        if math.isnan(low):
            return [name, value, None, None, "on its bound"]
        if math.isinf(low):
            return [name, value, low, high, "not determined by the data"]
        return [name, value, low, high, ""]


def _data_set_row(data_set: DataSet, response: Response) -> list[Cell]:
    """Return the row of a data set: its name, number of states, rms error [kPa], and R²."""
    error = stresses(response, data_set.measure) - data_set.stress
    rms = float(np.sqrt(np.mean(error**2)))
    variance = np.sum((data_set.stress - data_set.stress.mean(axis=0)) ** 2)
    explained = math.nan
    if variance > 0:
        explained = float(1 - np.sum(error**2) / variance)
    return [data_set.name, len(error), rms, explained]


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
        start: Initial values of the parameters by name.
        bounds: Smallest and largest value of any of the parameters.
        kappa: Penalty κ [kPa], as in ``compile_material``.
        confidence: Level of the confidence intervals.
        jit_options: Options of dolfinx's compiler; by default ``-O1``.

    Raises:
        ValueError: There are not more data than parameters, or a start value is not finite or not
            within its bounds.
        TypeError: ``psi`` does not take the parameters.
        ConvergenceError: There is no equilibrium at the start, or the least-squares method failed.
    """
    names = list(start)
    data = tuple(data)
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
        parts = []
        for d in data:
            error = stresses(respond(candidate, d.path), d.measure) - d.stress
            parts.append(d.weight * error.ravel())
        return np.concatenate(parts)

    first = np.array(list(start.values()), dtype=np.float64)
    optimum = _minimise(residuals, first, limits)
    x = optimum.x
    distance = BOUND_RTOL * np.maximum(np.abs(x), np.abs(first))
    is_free = (np.abs(x - limits) > distance).all(axis=0)
    C, half_widths = uncertainty(optimum.jac, 2 * optimum.cost, is_free, confidence)
    intervals = {}
    for name, low, high in zip(
        names, (x - half_widths).tolist(), (x + half_widths).tolist(), strict=True
    ):
        intervals[name] = (low, high)
    fitted = trial(x)
    responses = tuple(respond(fitted, d.path) for d in data)
    return Fit(fitted, intervals, C, confidence, data, responses)


def uncertainty(R: Array, squares: float, free: Mask, confidence: float) -> tuple[Array, Array]:
    """Compute the covariance of the parameters and their confidence intervals.

    Args:
        R: Jacobian of the residuals, (n, m).
        squares: Sum of the squared residuals.
        free: Mask of the parameters that are not on a bound, (m,).
        confidence: Level of the intervals.

    Returns:
        The covariance q/(n − m) (Rᵀ R)⁻¹, (m, m), and half the widths of the intervals, (m,): NaN
        for parameters on a bound, infinite for undetermined ones.
    """
    degrees_of_freedom = len(R) - int(free.sum())
    lengths = np.linalg.norm(R[:, free], axis=0)
    lengths[lengths == 0] = 1.0
    _, s, Vt = np.linalg.svd(R[:, free] / lengths, full_matrices=False)
    is_determined = s > SINGULAR_RTOL * s.max(initial=0.0)
    V = Vt[is_determined].T / s[is_determined]
    C = squares / degrees_of_freedom * (V @ V.T) / np.outer(lengths, lengths)  # q/(n − m) (Rᵀ R)⁻¹
    is_undetermined = (np.abs(Vt[~is_determined]) > MIN_COMPONENT).any(axis=0)
    C[is_undetermined] = np.inf
    C[:, is_undetermined] = np.inf
    covariance = np.full((len(free), len(free)), np.nan)
    covariance[np.ix_(free, free)] = C
    t = float(scipy.stats.t.ppf((1 + confidence) / 2, degrees_of_freedom))
    return covariance, t * np.sqrt(np.diag(covariance))


def _minimise(
    residuals: Callable[[Array], Array], start: Array, limits: Array
) -> scipy.optimize.OptimizeResult:
    """Solve the least-squares problem within bounds.

    Args:
        residuals: Residuals, (n,), as a function of the parameters, (m,).
        start: Initial parameters, (m,).
        limits: Smallest and largest values, (2, m).

    Raises:
        ConvergenceError: A state has no equilibrium, or the method did not converge.
    """
    try:
        bounds = (limits[0], limits[1])
        optimum = scipy.optimize.least_squares(
            residuals,
            start,
            jac="3-point",
            bounds=bounds,
            x_scale="jac",
            ftol=FIT_FTOL,
            xtol=FIT_XTOL,
            gtol=FIT_GTOL,
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
    """Raise a ConvergenceError if a measured state has no equilibrium."""
    for d in data:
        response = respond(material, d.path)
        has_stress = np.isfinite(stresses(response, d.measure)).all(axis=1)
        failed = np.flatnonzero(~has_stress)
        if len(failed):
            where = format_value(d.path.symbol, d.path.values[failed[0]])
            raise ConvergenceError(
                f"With start = {dict(material.parameters)} there is no equilibrium at "
                f"{len(failed)} states of {d.name}, the first at {where}: start from softer "
                "fibres, for instance."
            )


def _limits(start: Mapping[str, float], bounds: Mapping[str, tuple[float, float]]) -> Array:
    """Return the smallest and largest values of the parameters, (2, m).

    Raises:
        ValueError: A start value is not finite or not within its bounds, or a bound has no start.
    """
    require_within(-math.inf, math.inf, start, remedy="a finite value")
    unknown = set(bounds) - set(start)
    if unknown:
        raise ValueError(
            f"bounds has {sorted(unknown)}, which start has not: add start values, or leave the "
            "bounds out."
        )
    limits = np.array([bounds.get(name, (-np.inf, np.inf)) for name in start], dtype=np.float64).T
    for name, value, low, high in zip(start, start.values(), *limits, strict=True):
        if not (low < high and low <= value <= high):
            raise ValueError(
                f"start has {name} = {value}, and bounds has ({low}, {high}): give a start between "
                "two different bounds."
            )
    return limits
