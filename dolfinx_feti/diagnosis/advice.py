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
    """Derive advice from what was measured.

    Args:
        figures: Figures of the solver.
        iterations: Those of one linear solve.
        prefix: Options prefix of the problem.
    """
    report, advice = figures.report, []

    def say(text: str, quantity: str, value: float, threshold: float) -> None:
        advice.append(Advice(text, quantity, value, threshold))

    mean, several = figures.dofs_subdomain.mean, figures.subdomains_process.most > 1
    if mean < FEW_DOFS and several:
        say("Take fewer subdomains.", "mean dofs of a subdomain", mean, FEW_DOFS)
    elif iterations > MANY_ITERATIONS and mean < MANY_DOFS and several:
        say("Take fewer subdomains.", "iterations", iterations, MANY_ITERATIONS)
    elif mean > MANY_DOFS and iterations <= MANY_ITERATIONS:
        say("Take more subdomains.", "mean dofs of a subdomain", mean, MANY_DOFS)
    ratio = figures.dofs_subdomain.most / mean
    if ratio > UNEVEN:
        say("Cut the mesh more evenly.", "largest subdomain over mean", ratio, UNEVEN)
    if report.options.scaling == "multiplicity" and figures.jump > JUMP:
        say(
            f"Weigh the copies by stiffness, -{prefix}feti_scaling stiffness.",
            "jump of the stiffness between subdomains",
            figures.jump,
            JUMP,
        )
    low, high = report.eigenvalues
    condition = high / low if low > 0.0 else 0.0
    if report.options.coarse_modes == 0 and condition > CONDITION:
        say(
            f"Let soft modes join the coarse space, -{prefix}feti_coarse_modes 12.",
            "condition number",
            condition,
            CONDITION,
        )
    if figures.pressures_per_dof > PRESSURES and figures.pressure_stiffness > STIFFER:
        say(
            "Take P2 displacements or a smaller κ: with more pressures than dofs, a nearly "
            "incompressible body locks.",
            "stiffness with the pressure over that without",
            figures.pressure_stiffness,
            STIFFER,
        )
    if report.floor > ROUNDING:
        say(
            "Lower a penalty such as κ, and let an augmented Lagrangian make up for it: rounding "
            "ends the linear solve above its tolerance.",
            "residual that is rounding",
            report.floor,
            ROUNDING,
        )
    if report.inertia.assembled:
        say(
            "Load in smaller steps: the tangent is indefinite, and CG cannot solve with it.",
            "negative eigenvalues, at least",
            report.inertia.assembled,
            0,
        )
    return tuple(advice)
