# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Parameters of an energy from material tests, by least squares.

The parameters θ minimise Σ w² (s(θ) − ŝ)² over all measured stresses ŝ of all data sets, with the
stresses s(θ) of equilibria: lateral stretches and pressures are solved for at every trial θ. The
method is scipy's trust-region method with bounds.

With the Jacobian R of the n weighted residuals in the m parameters and their sum of squares q at
the minimum, the covariance of the parameters is s² (Rᵀ R)⁻¹, s² = q/(n − m), and the confidence
intervals are those of Student's t with n − m degrees of freedom (Seber, Wild, Nonlinear Regression,
1989, ch. 5). They hold to first order, for noise that is independent and equal in all residuals
after weighting.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.optimize
import scipy.stats

from ufl.core.expr import Expr

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.runtime.tables import Cell, state, table
from dolfinx_feti.workshop.compiled import Material, compile_material
from dolfinx_feti.workshop.paths import refine
from dolfinx_feti.workshop.response import (
    DataSet,
    Response,
    r_squared,
    respond,
    rms_error,
    stresses,
)

__all__ = ["Estimate", "Fit", "covariance", "estimate", "fit"]

Array = npt.NDArray[np.float64]

#: Distance from a bound, relative to the parameter, at which it is on the bound.
TOUCH = 1e-6

#: Singular value of the Jacobian with unit columns below which parameters cannot be told apart.
BLIND = 1e-7


@dataclass(frozen=True, slots=True)
class Estimate:
    """A fitted parameter.

    Attributes:
        name: Its name.
        value: Its value.
        low: Lower end of the confidence interval; None if the value is on a bound, which leaves
            no interval, and infinite if the data do not determine the parameter.
        high: Upper end, likewise.
    """

    name: str
    value: float
    low: float | None
    high: float | None


@dataclass(frozen=True, slots=True)
class Fit:
    """A fit; ``str`` prints its tables.

    Attributes:
        material: The material with the fitted parameters.
        parameters: Values and confidence intervals.
        covariance: Covariance of the parameters, (m, m); NaN for one on a bound.
        confidence: Level of the intervals.
        data: The data sets.
        responses: The fitted stresses at the measured states, a response per data set.
        evaluations: Number of times that all data sets were computed, but for derivatives.
    """

    material: Material
    parameters: tuple[Estimate, ...]
    covariance: Array
    confidence: float
    data: tuple[DataSet, ...]
    responses: tuple[Response, ...]
    evaluations: int

    @property
    def values(self) -> dict[str, float]:
        """Values of the parameters by their names."""
        return {p.name: p.value for p in self.parameters}

    @property
    def correlation(self) -> Array:
        """Correlation of the parameters, (m, m)."""
        deviation = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore"):  # inf/inf of what the data do not determine
            return self.covariance / np.outer(deviation, deviation)

    def __str__(self) -> str:
        """Return a table of the parameters and one of the data sets."""
        level = f"{100 * self.confidence:g} % confidence"
        parameters: list[list[Cell]] = [
            [p.name, p.value, p.low, p.high, _remark(p)] for p in self.parameters
        ]
        sets: list[list[Cell]] = [
            [d.name, len(d.stress), rms_error(r, d), r_squared(r, d)]
            for d, r in zip(self.data, self.responses, strict=True)
        ]
        return "\n\n".join(
            [
                table(["parameter", "value", level, "", ""], parameters),
                table(["data set", "states", "rms error [kPa]", "R²"], sets),
            ]
        )

    def curves(self, n: int = 60) -> tuple[Response, ...]:
        """Compute the fitted stresses at n states along the path of each data set."""
        return tuple(respond(self.material, refine(d.path, n)) for d in self.data)


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
        psi: Energy, as in :func:`~dolfinx_feti.workshop.compiled.compile_material`, that takes the
            parameters by their names.
        data: Data sets.
        start: Names of the parameters, and values to begin with.
        bounds: Least and largest value of some or all parameters.
        kappa: Penalty of the change of volume [kPa], infinite for an incompressible material.
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

    first = np.array(list(start.values()), dtype=np.float64)
    optimum = _minimise(lambda values: _residuals(trial(values), data), first, limits)
    best = trial(optimum.x)
    reach = TOUCH * np.maximum(np.abs(optimum.x), np.abs(first))
    free = (np.abs(optimum.x - limits) > reach).all(axis=0)
    estimates, C = estimate(best.parameters, optimum.jac, 2 * optimum.cost, free, confidence)
    responses = tuple(respond(best, d.path) for d in data)
    return Fit(best, estimates, C, confidence, data, responses, int(optimum.nfev))


def estimate(
    values: Mapping[str, float],
    R: Array,
    squares: float,
    free: npt.NDArray[np.bool_],
    confidence: float,
) -> tuple[tuple[Estimate, ...], Array]:
    """Return the parameters with their confidence intervals, and their covariance (m, m).

    Args:
        values: Values of the m parameters at the minimum.
        R: Jacobian of the residuals there, (n, m), n > m.
        squares: Sum of the squared residuals.
        free: Which parameters are not on a bound, (m,); the others count as known.
        confidence: Level of the intervals, such as 0.95.
    """
    freedom = len(R) - int(free.sum())
    full = np.full((len(free), len(free)), np.nan)
    full[np.ix_(free, free)] = covariance(R[:, free], squares / freedom)
    t = float(scipy.stats.t.ppf((1 + confidence) / 2, freedom))
    half = t * np.sqrt(np.diag(full))
    parameters = tuple(
        Estimate(name, value, value - float(h), value + float(h))
        if f
        else Estimate(name, value, None, None)
        for (name, value), h, f in zip(values.items(), half, free, strict=True)
    )
    return parameters, full


def covariance(R: Array, variance: float) -> Array:
    """Return s² (Rᵀ R)⁻¹, infinite for parameters that the residuals do not determine.

    Args:
        R: Jacobian, (n, m).
        variance: s².
    """
    lengths = np.linalg.norm(R, axis=0)
    lengths[lengths == 0] = 1.0
    _, s, Vt = np.linalg.svd(R / lengths, full_matrices=False)
    seen = s > BLIND * s.max(initial=0.0)
    V = Vt[seen].T / s[seen]
    result = variance * (V @ V.T) / np.outer(lengths, lengths)
    blind = (np.abs(Vt[~seen]) > 1e-3).any(axis=0)
    result[blind], result[:, blind] = np.inf, np.inf
    return result


def _minimise(
    residuals: Callable[[Array], Array], start: Array, limits: Array
) -> scipy.optimize.OptimizeResult:
    """Least squares within the limits, (2, m)."""
    try:
        optimum = scipy.optimize.least_squares(
            residuals,
            start,
            jac="3-point",
            bounds=(limits[0], limits[1]),
            x_scale="jac",
            ftol=1e-12,
            xtol=1e-10,
            gtol=1e-12,
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


def _residuals(material: Material, data: Sequence[DataSet]) -> Array:
    """Weighted differences between computed and measured stresses, one after the other."""
    return np.concatenate(
        [
            (d.weight * (stresses(respond(material, d.path), d.measure) - d.stress)).ravel()
            for d in data
        ]
    )


def _check_start(material: Material, data: Sequence[DataSet]) -> None:
    """Require equilibria at the start.

    Raises:
        ConvergenceError: A measured state has none.
    """
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
    """Return least and largest values, (2, m).

    Raises:
        ValueError: A bound has no parameter, or the start is not between its bounds.
    """
    unknown = set(bounds) - set(start)
    if unknown:
        raise ValueError(f"bounds has {sorted(unknown)}, which start has not.")
    limits = np.array([bounds.get(name, (-np.inf, np.inf)) for name in start], dtype=np.float64).T
    for name, value, low, high in zip(start, start.values(), *limits, strict=True):
        if not (low < high and low <= value <= high):
            raise ValueError(f"start has {name} = {value}, bounds ({low}, {high}): start inside.")
    return limits


def _remark(parameter: Estimate) -> str:
    """Return what a reader of the table has to know."""
    if parameter.low is None:
        return "on its bound"
    return "" if math.isfinite(parameter.low) else "not determined by the data"
