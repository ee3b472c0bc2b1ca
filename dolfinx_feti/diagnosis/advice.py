# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Advice: each piece from one quantity that has passed a threshold (docs/diagnosing.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dolfinx_feti.feti.report import Report

__all__ = ["Advice", "advise"]

#: Iterations from which their time makes fewer, larger subdomains worth their factors.
MANY_ITERATIONS = 100

#: Mean dofs of a subdomain: below, the coarse problem costs too much; above, the factors.
FEW_DOFS, MANY_DOFS = 500, 5000

#: Greatest jump of the stiffness between subdomains that equal weights bear. Where subdomains meet
#: with different numbers of cells, it is up to 550 in a body of one material (the vessel).
JUMP = 3000.0

#: Condition number above which a coarse space without soft modes is too small.
CONDITION = 100.0

#: Dofs of the subdomain that has the most, over the mean.
UNEVEN = 2.0

#: With more pressures than dofs, and the pressure this much stiffer than the rest, elements lock.
PRESSURES, STIFFER = 1.0, 50.0

#: Share of the load from which on a residual that is rounding costs digits that one might want.
ROUNDING = 1e-6


@dataclass(frozen=True, slots=True)
class Advice:
    """One piece of advice.

    Attributes:
        text: What to do, in one sentence.
        quantity: What was measured.
        value: Its value.
        threshold: The value that it has passed.
    """

    text: str
    quantity: str
    value: float
    threshold: float

    def __str__(self) -> str:
        """Return the sentence and its reason."""
        return f"{self.text} ({self.quantity}: {self.value:.4g}, threshold {self.threshold:g})"


def advise(
    figures: Mapping[str, Any], report: Report, *, iterations: int, prefix: str
) -> list[Advice]:
    """Derive advice from figures and the iterations of one linear solve."""
    _, mean, most = figures["dofs of a subdomain"]
    several, many = figures["subdomains / process"][2] > 1, iterations > MANY_ITERATIONS
    low, high = report.eigenvalues
    condition, jump = high / low if low > 0.0 else 0.0, figures["jump of stiffness"]
    stiffer = figures.get("stiffer by pressures", 1.0)
    crowded = figures.get("pressures per dof", 0.0) > PRESSURES
    negative, size = report.inertia.assembled or 0, "mean dofs of a subdomain"
    rules: list[tuple[object, str, str, float, float]] = [
        (several and mean < FEW_DOFS, "Take fewer subdomains.", size, mean, FEW_DOFS),
        (several and FEW_DOFS <= mean < MANY_DOFS and many,
         "Take fewer subdomains.", "iterations", iterations, MANY_ITERATIONS),
        (mean > MANY_DOFS and not many, "Take more subdomains.", size, mean, MANY_DOFS),
        (most / mean > UNEVEN,
         "Cut the mesh more evenly.", "largest subdomain over mean", most / mean, UNEVEN),
        (report.options.scaling == "multiplicity" and jump > JUMP,
         f"Weigh the copies by stiffness, -{prefix}feti_scaling stiffness.",
         "jump of the stiffness between subdomains", jump, JUMP),
        (report.options.coarse_modes == 0 and condition > CONDITION,
         f"Let soft modes join the coarse space, -{prefix}feti_coarse_modes 12.",
         "condition number", condition, CONDITION),
        (crowded and stiffer > STIFFER,
         "Take P2 displacements or a smaller κ: with more pressures than dofs, a nearly "
         "incompressible body locks.",
         "stiffness with the pressure over that without", stiffer, STIFFER),
        (report.floor > ROUNDING,
         "Lower a penalty such as κ, and let an augmented Lagrangian make up for it: rounding "
         "ends the linear solve above its tolerance.",
         "residual that is rounding", report.floor, ROUNDING),
        (negative,
         "Load in smaller steps: the tangent is indefinite, and CG cannot solve with it.",
         "negative eigenvalues, at least", negative, 0),
    ]  # fmt: skip
    return [Advice(text, what, x, most) for holds, text, what, x, most in rules if holds]
