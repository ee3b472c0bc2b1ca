# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The figures that a problem reports, and the advice that is derived from them."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from bodies import two_wells
from collective import COMM, agree, equal, small
from problems import cube, elasticity, poisson, torn
from walls import tube, wall

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem
from dolfinx_feti.diagnosis import advice
from dolfinx_feti.diagnosis.figures import figure_text


def quantities(problem):
    """Return the quantities of the advice, and check that the report contains its texts."""
    diagnosis = problem.diagnose()
    agree(
        all(str(a) in str(diagnosis) and a.text.endswith(".") for a in diagnosis.advice), diagnosis
    )
    return {a.quantity for a in diagnosis.advice}


# -- figures


def test_figures_of_a_linear_problem(solve_linear):
    """The figures of a linear problem agree with its decomposition, its solve and the report."""
    problem = solve_linear(elasticity(cube(3, 4)), 6, {"feti_type": "all_floating"})
    diagnosis = problem.diagnose()
    figures = diagnosis.figures
    report = diagnosis.report
    count = COMM.allreduce(problem.decomposition.count)
    agree(report.subdomains == count and len(diagnosis.residuals) == count)
    agree(report.dofs == 3 * 5**3 == sum(figures.dofs_by_copies))
    torn = sum(n * m for m, n in enumerate(figures.dofs_by_copies, start=1))
    agree(torn == report.torn_dofs)
    dofs = figures.dofs_per_subdomain
    small(dofs.mean - torn / count, 1e-9)
    small(figures.dofs_per_process.mean - torn / COMM.size, 1e-9)
    agree(dofs.smallest <= dofs.mean <= dofs.largest, dofs)
    agree((dofs.smallest, dofs.largest) == report.dofs_local, dofs)
    agree(0.0 < figures.interface_share.smallest <= figures.interface_share.largest <= 1.0)
    agree(figures.near_kernel == "3 translations, 3 rotations")
    agree(figures.stiffness_jump >= 1.0 and figures.pressures_per_dof is None)
    agree(diagnosis.method == "cg" and diagnosis.iterations > 3 and diagnosis.message == "")
    small(diagnosis.relative_residual, 1e-8)
    agree(diagnosis.seconds["set-up"] > 0.0 and diagnosis.seconds["solve"] > 0.0)
    agree(
        0.0 < diagnosis.seconds["factors"] < diagnosis.seconds["set-up"] * 1.01, diagnosis.seconds
    )
    record = diagnosis.records[0]
    agree(json.loads(json.dumps(record, allow_nan=False)) == record)
    agree(record["report"]["subdomains"] == count)
    agree(all(other == str(diagnosis) for other in COMM.allgather(str(diagnosis))))
    for word in ("condition number", "3 rotations", "coarse size", f"{report.dofs}, torn"):
        agree(word in str(diagnosis), diagnosis)


@pytest.mark.serial
@pytest.mark.parametrize(
    ("value", "text"), [(0.26149, "0.261"), (7, "7"), (2379.4, "2379"), (np.nan, "–")]
)
def test_a_figure_has_three_digits(value, text):
    """Figures have three significant digits, and all digits of their whole part."""
    assert figure_text(value) == text


def test_residuals_are_those_of_the_state():
    """The subdomains' residuals sum to ‖b − A u‖, before and after a solve."""
    problem = torn(poisson(cube(2, 6)), 5, ksp_rtol=1e-10)
    before = problem.diagnose().residuals
    _, b = problem.linear_system()
    small(np.linalg.norm(before) / b.norm() - 1.0, 1e-12)
    b.destroy()
    problem.solve()
    after = problem.diagnose().residuals
    agree(0.0 < np.linalg.norm(after) <= 1e-10 * np.linalg.norm(before), (before, after))


def test_next_newton_step():
    """The residual of a wall with a condensed pressure is that of Newton's method."""
    body = wall(tube(around=8, along=2), degree=2)
    problem = body.problem(4, {})
    body.inflate(problem, [1.0])
    body.load.value *= 1.5
    u = body.u.x.array.copy()
    diagnosis = problem.diagnose()
    equal(body.u.x.array, u)
    small(np.linalg.norm(diagnosis.residuals) / problem.residual_norm() - 1.0, 1e-9)
    agree(diagnosis.figures.pressures_per_dof > 0.0 and diagnosis.figures.pressure_stiffening > 1.0)
    agree("pressures" in str(diagnosis))


def test_without_a_load():
    """Without a load the condition number is estimated with a random right-hand side."""
    problem = wall(tube(around=8, along=1), degree=1).problem(4, {})
    diagnosis = problem.diagnose()
    agree(diagnosis.iterations >= 0 and diagnosis.message == "")
    equal(diagnosis.residuals, np.zeros(len(diagnosis.residuals)))


def test_solve_that_fails():
    """The report of a failed solve has its reason, and no figures of the solver."""
    diagnosis = torn(elasticity(cube(3, 3), clamped=None), 4).diagnose()
    agree(diagnosis.report is None and diagnosis.advice == () and diagnosis.figures is None)
    agree("singular" in diagnosis.message and "singular" in str(diagnosis))
    agree(diagnosis.records[0]["report"] is None)


# -- advice: a problem that gets it, and one that does not


def advises(quantity, wrong, *right):
    """Assert that one problem has advice on a quantity, and the others have none."""
    agree(quantity in quantities(wrong))
    for problem in right:
        agree(quantity not in quantities(problem))


def test_few_and_many_dofs(monkeypatch):
    """Subdomains with too few or too many dofs cause advice."""
    body = elasticity(cube(2, 30))
    few = torn(body, 8 * COMM.size)
    many = torn(body, COMM.size)
    advises("mean dofs of a subdomain", few, many)
    monkeypatch.setattr(advice, "MANY_DOFS", 300)
    texts = [a.text for a in many.diagnose().advice]
    agree(texts == ["Use more subdomains."])


def test_one_subdomain_for_each_process_is_not_too_small():
    """One subdomain on each process is not called too small, as fewer are impossible."""
    problem = torn(poisson(cube(2, 6)), COMM.size)
    problem.solve()
    diagnosis = problem.diagnose()
    agree(diagnosis.figures.subdomains_per_process.largest == 1)
    agree("mean dofs of a subdomain" not in [each.quantity for each in diagnosis.advice], diagnosis)


def test_many_iterations(monkeypatch):
    """Many iterations, as without a preconditioner, cause advice."""
    monkeypatch.setattr(advice, "FEW_DOFS", 0)
    body = elasticity(cube(3, 4))
    weak = {"feti_pc_type": "identity", "feti_coarse_modes": 0}
    monkeypatch.setattr(advice, "MANY_ITERATIONS", 40)
    slow = torn(body, 8 * COMM.size, ksp_rtol=1e-12, **weak)
    advises("iterations", slow, torn(body, 2 * COMM.size))


def test_uneven_subdomains():
    """Subdomains of very different sizes cause advice."""
    body = poisson(cube(2, 12))
    cells = np.arange(body.cells)
    last = np.maximum(cells - int(0.95 * body.cells), 0)  # the first part has nearly all cells
    advises("largest subdomain over mean", torn(body, last), torn(body, 4 * COMM.size))


def layered(hard):
    """Return a body, the same with layers 1e5 times as stiff, and x₁ of its cells' midpoints."""
    body = poisson(cube(2, 8))
    mesh = body.V.mesh
    factor = ufl.conditional(hard(ufl.SpatialCoordinate(mesh)[1]), 1e5, 1.0)
    stiff = replace(body, a=factor * body.a.integrals()[0].integrand() * ufl.dx)
    cells = np.arange(body.cells, dtype=np.int32)
    return body, stiff, dolfinx.mesh.compute_midpoints(mesh, 2, cells)[:, 1]


def test_equal_weights_at_a_jump():
    """Multiplicity scaling across a jump of stiffness causes advice to use stiffness scaling."""
    body, stiff, height = layered(lambda y: y > 0.5)
    halves = (height > 0.5).astype(np.int32)
    equals = {"feti_scaling": "multiplicity"}
    right = torn(stiff, halves), torn(body, halves, **equals)
    advises("jump of the stiffness between subdomains", torn(stiff, halves, **equals), *right)


def test_no_soft_modes():
    """Layered subdomains without soft modes in the coarse space cause advice to add them."""
    body, hard, _ = layered(lambda y: ufl.sin(8 * np.pi * y) > 0.0)
    n = 6 * COMM.size
    paper = {"feti_coarse_modes": 0}
    weak = torn(hard, n, feti_scaling="multiplicity", feti_formulation="dual", **paper)
    advises("condition number", weak, torn(hard, n), torn(body, n, **paper))


@pytest.mark.parametrize("degree", [1, 2])
def test_locking(degree):
    """Volumetric locking is reported for a P1–P0 wall, and not for a P2–P0 wall."""
    body = wall(tube(around=8, along=2), degree=degree, kappa=1e4)
    body.load.value = 0.1
    locks = "stiffness with the pressure over that without" in quantities(body.problem(2, {}))
    agree(locks == (degree == 1))


def test_indefinite_tangent():
    """An indefinite tangent is reported on the ridge between two valleys, and not in a valley."""
    u, energy, bcs = two_wells()
    problem = NonlinearProblem(energy, u, bcs=bcs, subdomains=4)
    agree("negative eigenvalues, at least" in quantities(problem))
    problem.solve()
    agree("negative eigenvalues, at least" not in quantities(problem))
