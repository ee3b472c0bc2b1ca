# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Advice: each piece from one measured quantity that has passed a threshold.

The thresholds of the number of subdomains are from ``docs/results/subdomains.md``, that of the soft
modes from ``docs/theory.md``.
"""

from __future__ import annotations

from dataclasses import dataclass

from dolfinx_feti.diagnosis.figures import Figures

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


def advise(figures: Figures, *, iterations: int, prefix: str) -> tuple[Advice, ...]:
    """Derive advice from figures and the iterations of one linear solve."""
    report, mean, size = figures.report, figures.dofs_subdomain.mean, "mean dofs of a subdomain"
    several, many = figures.subdomains_process.most > 1, iterations > MANY_ITERATIONS
    fewer, more = "Take fewer subdomains.", "Take more subdomains."
    ratio, (low, high) = figures.dofs_subdomain.most / mean, report.eigenvalues
    condition = high / low if low > 0.0 else 0.0
    weigh = f"Weigh the copies by stiffness, -{prefix}feti_scaling stiffness."
    soft = f"Let soft modes join the coarse space, -{prefix}feti_coarse_modes 12."
    locks = (
        "Take P2 displacements or a smaller κ: with more pressures than dofs, a nearly "
        "incompressible body locks."
    )
    rounds = (
        "Lower a penalty such as κ, and let an augmented Lagrangian make up for it: rounding "
        "ends the linear solve above its tolerance."
    )
    raised = figures.pressure_stiffness
    indefinite = "Load in smaller steps: the tangent is indefinite, and CG cannot solve with it."
    crowded, negative = figures.pressures_per_dof > PRESSURES, report.inertia.assembled or 0
    rules: list[tuple[object, str, str, float, float]] = [
        (several and mean < FEW_DOFS, fewer, size, mean, FEW_DOFS),
        (several and FEW_DOFS <= mean < MANY_DOFS and many,
         fewer, "iterations", iterations, MANY_ITERATIONS),
        (mean > MANY_DOFS and not many, more, size, mean, MANY_DOFS),
        (ratio > UNEVEN, "Cut the mesh more evenly.", "largest subdomain over mean", ratio, UNEVEN),
        (report.options.scaling == "multiplicity" and figures.jump > JUMP,
         weigh, "jump of the stiffness between subdomains", figures.jump, JUMP),
        (report.options.coarse_modes == 0 and condition > CONDITION,
         soft, "condition number", condition, CONDITION),
        (crowded and raised > STIFFER,
         locks, "stiffness with the pressure over that without", raised, STIFFER),
        (report.floor > ROUNDING, rounds, "residual that is rounding", report.floor, ROUNDING),
        (negative, indefinite, "negative eigenvalues, at least", negative, 0),
    ]  # fmt: skip
    return tuple(Advice(text, what, x, most) for holds, text, what, x, most in rules if holds)
