# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Advice on a problem: one sentence for each quantity above or below its threshold.

`docs/diagnosing.md` explains the quantities and the advice.
"""

from __future__ import annotations

from dataclasses import dataclass

from dolfinx_feti.diagnosis.figures import Figures
from dolfinx_feti.feti.report import Report

__all__ = ["Advice", "advise"]

#: Iterations above which fewer, larger subdomains pay off: the iterations that they save take
#: longer than their larger factors.
MANY_ITERATIONS = 100

#: Mean dofs of a subdomain below which the coarse problem costs too much (docs/results/speed.md).
FEW_DOFS = 500

#: Mean dofs of a subdomain above which the factors cost too much (docs/results/speed.md).
MANY_DOFS = 5000

#: Jump of the stiffness between subdomains above which equal weights are too inaccurate. A body of
#: one material, the vessel, has jumps up to 550: the copies of a dof have different numbers of
#: cells.
STIFFNESS_JUMP = 3000.0

#: Condition number above which a coarse space without soft modes is too small. The dual system has
#: 5 to 30 for compact bodies of one material, and 1e3 or more for thin plates and stiff inclusions.
#: The primal system has 3 to 15 there, as its adaptive columns bound the condition number.
CONDITION = 100.0

#: Dofs of the largest subdomain over the mean above which a cut is uneven. With one subdomain on
#: each process, an average process then idles for half the time.
UNEVEN = 2.0

#: Pressures per dof above which a nearly incompressible body locks: there are more constraints than
#: unknowns.
PRESSURES_PER_DOF = 1.0

#: Factor by which the condensed pressure stiffens the diagonal above which a body is nearly
#: incompressible: κ = 50 μ corresponds to ν = 0.49.
STIFFENING = 50.0

#: Relative residual or error, due to rounding, above which the solution has fewer than six digits:
#: a choice.
ROUNDING = 1e-6


@dataclass(frozen=True, slots=True)
class Advice:
    """One piece of advice.

    Attributes:
        text: What to do, in one sentence.
        quantity: What was measured.
        value: Value of the quantity.
        threshold: Threshold that the value exceeds, or falls below.
    """

    text: str
    quantity: str
    value: float
    threshold: float

    def __str__(self) -> str:
        """Return the sentence and its reason."""
        return f"{self.text} ({self.quantity}: {self.value:.4g}, threshold {self.threshold:g})"


def advise(figures: Figures, report: Report, *, iterations: int, prefix: str) -> list[Advice]:
    """Return advice on one linear solve.

    Args:
        figures: The figures of a diagnosis.
        report: The report of the solver.
        iterations: Krylov iterations of the solve.
        prefix: Prefix of the solver's options.
    """
    return [
        *_advise_on_subdomains(figures, iterations),
        *_advise_on_method(figures, report, iterations, prefix),
        *_advise_on_problem(figures, report),
    ]


def _advise_on_subdomains(figures: Figures, iterations: int) -> list[Advice]:
    """Return advice on the number and the size of the subdomains."""
    mean = figures.dofs_per_subdomain.mean
    unevenness = figures.dofs_per_subdomain.largest / mean
    has_several = figures.subdomains_per_process.largest > 1
    has_many_iterations = iterations > MANY_ITERATIONS
    size = "mean dofs of a subdomain"
    advice = []
    if has_several and mean < FEW_DOFS:
        advice.append(Advice("Use fewer subdomains.", size, mean, FEW_DOFS))
    elif has_several and mean < MANY_DOFS and has_many_iterations:
        text = "Use fewer subdomains."
        advice.append(Advice(text, "iterations", iterations, MANY_ITERATIONS))
    # more subdomains would increase the number of iterations further
    if mean > MANY_DOFS and not has_many_iterations:
        advice.append(Advice("Use more subdomains.", size, mean, MANY_DOFS))
    if unevenness > UNEVEN:
        quantity = "largest subdomain over mean"
        advice.append(Advice("Cut the mesh more evenly.", quantity, unevenness, UNEVEN))
    return advice


def _advise_on_method(
    figures: Figures, report: Report, iterations: int, prefix: str
) -> list[Advice]:
    """Return advice on scaling, formulation and coarse space."""
    lowest, highest = report.eigenvalues
    # without a positive λ_min there is no condition number, and no advice on it
    condition = highest / lowest if lowest > 0.0 else 0.0
    is_dual = report.formulation == "dual"
    advice = []
    jump = figures.stiffness_jump
    if report.options.scaling == "multiplicity" and jump > STIFFNESS_JUMP:
        text = f"Weight the copies by their stiffness, -{prefix}feti_scaling stiffness."
        quantity = "jump of the stiffness between subdomains"
        advice.append(Advice(text, quantity, jump, STIFFNESS_JUMP))
    # a subdomain with negative eigenvalues of K_ρ, or unknown ones, needs the dual formulation
    if is_dual and report.inertia.local == 0:
        text = f"Use the primal formulation, {_primal(report, prefix)}."
        if condition > CONDITION:
            quantity = "condition number of the dual system"
            advice.append(Advice(text, quantity, condition, CONDITION))
        elif iterations > MANY_ITERATIONS:
            quantity = "iterations of the dual formulation"
            advice.append(Advice(text, quantity, iterations, MANY_ITERATIONS))
    has_adaptive_columns = not is_dual and report.options.coarse_adaptive > 0
    has_soft_modes = report.options.coarse_modes > 0
    if not has_soft_modes and not has_adaptive_columns and condition > CONDITION:
        text = f"Add soft modes to the coarse space, -{prefix}feti_coarse_modes 12."
        advice.append(Advice(text, "condition number", condition, CONDITION))
    return advice


def _advise_on_problem(figures: Figures, report: Report) -> list[Advice]:
    """Return advice on elements, parameters and loads."""
    advice = []
    has_many_pressures = (figures.pressures_per_dof or 0.0) > PRESSURES_PER_DOF
    stiffening = figures.pressure_stiffening or 1.0
    if has_many_pressures and stiffening > STIFFENING:
        text = (
            "Use P2 displacements or a smaller κ: with more pressures than dofs, a nearly "
            "incompressible body locks."
        )
        quantity = "stiffness with the pressure over that without"
        advice.append(Advice(text, quantity, stiffening, STIFFENING))
    if report.floor > ROUNDING:
        text = (
            "Lower a penalty such as κ, and enforce its constraint by an augmented Lagrangian: "
            "rounding ends the linear solve above its tolerance."
        )
        advice.append(Advice(text, "residual that is rounding", report.floor, ROUNDING))
    if report.error_floor > ROUNDING:
        text = "Lower a penalty or a jump of the stiffness: rounding limits the accuracy of x."
        quantity = "estimated error that is rounding"
        advice.append(Advice(text, quantity, report.error_floor, ROUNDING))
    negative = report.inertia.assembled or 0
    if negative:
        text = "Load in smaller steps: the tangent is indefinite, and CG cannot solve with it."
        advice.append(Advice(text, "negative eigenvalues, at least", negative, 0))
    return advice


def _primal(report: Report, prefix: str) -> str:
    """Return the options that select the primal formulation and its preconditioner."""
    options = f"-{prefix}feti_formulation primal"
    if report.options.pc_type != "dirichlet":
        options += f" -{prefix}feti_pc_type dirichlet"
    return options
