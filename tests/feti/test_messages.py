# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Advice is never what is in force: all messages, with the options that they recommend."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from types import SimpleNamespace

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree
from hand_torn import random_values, solve, unsymmetric
from problems import cube, elasticity

from dolfinx_feti import LinearProblem
from dolfinx_feti.diagnosis import advice
from dolfinx_feti.feti.options import CHOICES, FETIOptions
from dolfinx_feti.feti.solver import _remedy
from dolfinx_feti.problems.history import CLOSER, FAILURES

Reason = PETSc.KSP.ConvergedReason
REASONS = {value: name for name, value in vars(Reason).items() if name.startswith("DIVERGED")}
GRID = {"subdomains": (3, 3), "cells": (2, 2), "components": 2}


def recommended(message):
    """Return the options with a value that a message recommends, and not those that it blames."""
    return re.findall(r"(?<!but )-test_feti_(\w+) (\w+)", message)


@pytest.mark.serial
@pytest.mark.parametrize("method", ["cg", "gmres", "minres"])
@pytest.mark.parametrize("floor", [np.nan, 1e-2])
@pytest.mark.parametrize("reason", REASONS, ids=REASONS.values())
def test_no_remedy_is_in_force(reason, floor, method):
    """For each reason, with each choice of words and both forms."""
    texts = set()
    for values in itertools.product(*CHOICES.values()):
        options = FETIOptions(**dict(zip(CHOICES, values, strict=True)))
        for dual in {options.formulation != "primal", options.formulation == "dual"}:
            form = SimpleNamespace(
                pattern=SimpleNamespace(options=options), solves_indefinite=dual, method=method
            )
            text = _remedy(reason, form, floor=floor).format("test_")
            texts.add(text)
            force = {"dual_ksp_type": method, "formulation": "dual" if dual else "primal"}
            for name, value in recommended(text):
                agree(force.get(name, getattr(options, name, None)) != value, (text, options))
                agree(name in force or value in CHOICES[name], text)
    agree(all(texts) and "feti_stagnation" not in " ".join(texts))


def test_advice_that_is_followed_is_not_repeated(torn_grid, feti):
    """Iterations that do not suffice, and options that are worse than the defaults."""
    problem = torn_grid(stiffness=lambda i: 1e6 ** (i % 2), **GRID)
    options = {
        "feti_pc_type": "identity",
        "feti_scaling": "multiplicity",
        "feti_coarse_q": "identity",
        "feti_formulation": "dual",
    }
    said = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dolfinx_feti.feti.dual.krylov.STAGNATION", 3)
        patch.setattr("dolfinx_feti.feti.solver.RESTARTS", 0)
        for _ in range(4):
            ksp = feti(problem.A, **options)
            reason, _ = solve(ksp, problem, random_values(problem))
            said.append(ksp.getPythonContext().message)
            if reason > 0:
                break
            new = recommended(said[-1])
            agree(new and all(options[f"feti_{name}"] != value for name, value in new), said)
            options |= {f"feti_{name}": value for name, value in new}
    agree(len(said) > 1 and said[-1] == "", said)


UNFIT = [
    {"dual_ksp_type": "cg"},
    {"formulation": "dual"},
    {"pc_type": "lumped"},
    {"interior": "eliminate"},
    {"formulation": "dual", "pc_type": "identity", "interior": "eliminate"},
]


@pytest.mark.parametrize("options", UNFIT, ids=lambda options: " ".join(options.values()))
def test_unsymmetric_matrix_is_solved_as_its_message_says(options, torn_grid, feti):
    problem = torn_grid(change=unsymmetric(0.02), **GRID)
    for _ in range(2):
        ksp = feti(problem.A, **{f"feti_{name}": value for name, value in options.items()})
        reason, _ = solve(ksp, problem, random_values(problem))
        said = ksp.getPythonContext().message
        agree((reason > 0) == (options.get("formulation") == "primal" or said == ""), said)
        options = options | dict(recommended(said))
    agree(reason > 0, said)


@pytest.mark.parametrize("scaling", CHOICES["scaling"])
@pytest.mark.parametrize("modes", [0, 12])
def test_advice_of_a_diagnosis_is_not_in_force(scaling, modes):
    """Whatever else is measured: a jump of the stiffness, and a large condition number."""
    body = elasticity(cube(2, 8))
    chosen = {"feti_scaling": scaling, "feti_coarse_modes": modes}
    problem = LinearProblem(
        body.a,
        body.L,
        bcs=body.bcs,
        subdomains=2 * COMM.size,
        petsc_options_prefix="test_",
        petsc_options=chosen,
    )
    found = problem.diagnose()
    figures = {**found.figures, "jump of stiffness": 1e9}
    report = replace(found.report, eigenvalues=(1.0, 1e9), floor=1e-5)
    said = advice.advise(figures, report, iterations=1000, prefix="test_")
    new = recommended(" ".join(piece.text for piece in said))
    agree(all(str(chosen[f"feti_{name}"]) != value for name, value in new), said)
    agree(len(new) == (scaling == "multiplicity") + (modes == 0), said)
    agree("residual that is rounding" in {piece.quantity for piece in said}, said)


def test_newtons_messages_name_no_option_but_the_limit_of_steps():
    texts = [text for _, text in FAILURES.values()] + list(CLOSER)
    agree(re.findall(r"snes_\w+|feti_\w+|ksp_\w+", " ".join(texts)) == ["snes_max_it"], texts)
