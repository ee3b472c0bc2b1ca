# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Confidence intervals of parameters from the Jacobian of a least-squares fit.

With the Jacobian R of n weighted residuals in m parameters and their sum of squares q at the
minimum, the covariance of the parameters is s² (Rᵀ R)⁻¹, s² = q/(n − m), and the confidence
intervals are those of Student's t with n − m degrees of freedom (Seber, Wild, Nonlinear Regression,
1989, ch. 5). They hold to first order, for noise that is independent and equal in all residuals
after weighting.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.stats

__all__ = ["Parameter", "estimate", "find_covariance"]

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

#: Singular value of the Jacobian with unit columns below which parameters cannot be told apart.
BLIND = 1e-7


@dataclass(frozen=True, slots=True)
class Parameter:
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


def estimate(
    values: Mapping[str, float], R: Array, squares: float, free: Mask, confidence: float
) -> tuple[tuple[Parameter, ...], Array]:
    """Return the parameters with their confidence intervals, and their covariance (m, m).

    Args:
        values: Values of the m parameters at the minimum.
        R: Jacobian of the residuals there, (n, m), n > m.
        squares: Sum of the squared residuals.
        free: Which parameters are not on a bound, (m,); the others count as known.
        confidence: Level of the intervals, such as 0.95.
    """
    freedom = len(R) - int(free.sum())
    covariance = np.full((len(free), len(free)), np.nan)
    covariance[np.ix_(free, free)] = find_covariance(R[:, free], squares / freedom)
    t = float(scipy.stats.t.ppf((1 + confidence) / 2, freedom))
    half = t * np.sqrt(np.diag(covariance))
    parameters = tuple(
        Parameter(name, value, value - float(h), value + float(h))
        if f
        else Parameter(name, value, None, None)
        for (name, value), h, f in zip(values.items(), half, free, strict=True)
    )
    return parameters, covariance


def find_covariance(R: Array, variance: float) -> Array:
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
    covariance = variance * (V @ V.T) / np.outer(lengths, lengths)
    blind = (np.abs(Vt[~seen]) > 1e-3).any(axis=0)
    covariance[blind], covariance[:, blind] = np.inf, np.inf
    return covariance
