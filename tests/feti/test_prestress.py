# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A wall under pressure: rotations are no kernel any more, and every step is exact all the same."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, equal, norm, raises, small
from mixed import by_place, solve_assembled
from modes import modes_of
from walls import PREFIX, tube, wall

import dolfinx
import ufl

from dolfinx_feti import ConvergenceError, NonlinearProblem, loads
from dolfinx_feti.fem.assembly import dolfinx_form
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.decomposition import tear
from dolfinx_feti.loading.load_steps import follow_load
from dolfinx_feti.loading.steps import Steps
from dolfinx_feti.torn.matrix import Torn

MILD, PHYSIOLOGICAL = (2.0, 10.0), (2.0, 10.0, 30.0)
TIGHT = {"snes_rtol": 1e-10}


class Witness:
    """Compares every linear solve of a problem with MUMPS on the assembled matrix.

    Attributes:
        errors: Relative difference of each step.
    """

    def __init__(self, problem: NonlinearProblem) -> None:
        self.errors: list[float] = []
        problem.solver.getKSP().setPostSolve(self.compare)

    def compare(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        expected = solve_assembled(ksp.getOperators()[0], b)
        self.errors.append(norm(x.array_r - expected) / norm(expected))


def check_every_step(
    degree: int,
    subdomains: int,
    pressures: tuple[float, ...],
    *,
    tangent: str = "symmetric",
    kappa: float = 1000.0,
    **options: object,
) -> list[int]:
    """Inflate; hold each Newton step against its residual and against MUMPS.

    Returns:
        The FETI iterations of each step.
    """
    body = wall(tube(), degree=degree, tangent=tangent, kappa=kappa)
    problem = body.problem(subdomains, {"ksp_rtol": 1e-8} | options)
    witness = Witness(problem)
    steps = body.inflate(problem, pressures)
    agree(len(steps) == len(witness.errors) >= 2 * len(pressures))
    small(max(step.linear_residual for step in steps), 1e-8)
    small(max(witness.errors), 1e-6)
    return [step.linear_iterations for step in steps]


@pytest.mark.parametrize("subdomains", [1, 4, 16])
def test_p2(subdomains):
    iterations = check_every_step(2, subdomains, PHYSIOLOGICAL if subdomains < 16 else MILD)
    small(max(iterations) / max(iterations[0], 5), 2.5)


@pytest.mark.parametrize("subdomains", [1, 4, 16])
def test_p1(subdomains):
    """Subdomains buckle by the dozen, and the props keep the iterations down."""
    iterations = check_every_step(1, subdomains, PHYSIOLOGICAL)
    small(max(iterations) / max(iterations[0], 5), 2.0)  # the coarse space nearly solves


@pytest.mark.parametrize(("kind", "kappa"), [("all_floating", 1000.0), ("classical", 1e5)])
def test_up_to_300_mmhg(kind, kappa):
    """In few load steps, each linear system exact, and the iterations as at rest."""
    body = wall(tube(), kappa=kappa)
    problem = body.problem(6, {"feti_type": kind})

    def set_load(mmhg: float) -> None:
        body.load.value = loads.mmhg(mmhg)

    steps = follow_load(
        problem,
        set_load,
        [100.0, 300.0],
        Steps(first=10.0, least=0.5, growth=2.0, quick=6),
        state=[body.u, body.p],
    )
    newton = [step for each in steps for step in each.all_steps]
    iterations = [step.linear_iterations for step in newton]
    agree(steps[-1].load == 300.0 and len(steps) <= 15, [step.load for step in steps])
    agree(len(newton) <= 80 and sum(iterations) <= 5000, (len(newton), sum(iterations)))
    agree(np.median(iterations) <= 2 * iterations[0], iterations)
    small(max(s.linear_residual / s.linear_rtol for each in steps for s in each.history), 1.0)
    agree(newton[-1].negative > newton[0].negative)


@pytest.mark.parametrize("tangent", ["none", "full"])
@pytest.mark.parametrize("degree", [1, 2])
def test_other_tangents_of_the_load(degree, tangent):
    check_every_step(degree, 4, MILD, tangent=tangent)


@pytest.mark.parametrize("method", ["all_floating", "classical"])
@pytest.mark.parametrize("scaling", ["stiffness", "multiplicity"])
def test_other_methods(method, scaling):
    check_every_step(1, 6, MILD, feti_type=method, feti_scaling=scaling)
    check_every_step(2, 3, MILD, feti_type=method, feti_scaling=scaling)


@pytest.mark.parametrize("preconditioner", ["lumped", "identity"])
def test_other_preconditioners(preconditioner):
    check_every_step(1, 4, MILD, kappa=100.0, feti_pc_type=preconditioner)


@pytest.mark.parametrize("degree", [1, 2])
def test_rotations_turn_the_internal_forces(degree):
    """K·(ω × x) = ω × f_int on every subdomain, with the deformed x: Π is frame indifferent."""
    body = wall(tube(), degree=degree)
    body.u.interpolate(lambda x: 0.05 * np.stack([x[1] * x[2], np.sin(x[0]), x[0] ** 2 - x[1]]))
    body.p.interpolate(lambda x: 2.0 + np.cos(3 * x[0]))
    problem = body.problem(4)
    problem._system.residual()
    problem._system.linearise()
    V = body.u.function_space
    space = tear(V, problem.decomposition)
    internal = ufl.derivative(body.energy, body.u, ufl.TestFunction(V))
    f = np.zeros(3 * len(space.dof))
    dolfinx.fem.assemble_vector(f, dolfinx_form(internal, (space,), Compiler(COMM)))
    x = V.tabulate_dof_coordinates() + body.u.x.array.reshape(-1, 3)
    torn = Torn(problem.A)
    for ω in np.eye(3):
        image = torn.multiply(np.cross(ω, x[space.dof]).ravel())
        equal(image, np.cross(ω, f.reshape(-1, 3)).ravel(), 1e-10)
    agree(np.abs(f).max() > 1e-2)
    torn.destroy()


def test_kernel_is_exact_without_load_only(parts):
    """D = 0 as long as K R = 0; under load the rotations leave the kernel, translations stay.

    Without the load's tangent, that is: it holds on to translations as well.
    """
    body = wall(tube(), tangent="none")
    problem = body.problem(4, {"feti_coarse_modes": 0})
    problem._system.residual()
    problem._system.linearise()
    unloaded = parts(problem.A, coarse_modes=0)
    agree(all(modes_of(unloaded).exact))
    small(max(np.abs(D).max() for D in modes_of(unloaded).D), 0.0)
    agree(unloaded.inertia.definite and unloaded.method == "cg")
    body.inflate(problem, [2.0])
    loaded = parts(problem.A, coarse_modes=0)
    agree(not any(modes_of(loaded).exact))
    defects = list(zip(modes_of(loaded).D, modes_of(loaded).rho, strict=True))
    agree(all(1e-7 * ρ < np.abs(D).max() < ρ for D, ρ in defects))
    ranks = [np.linalg.matrix_rank(D, 1e-10 * ρ) - len(D) for D, ρ in defects]
    agree(max(ranks) <= -3, "a translation has no defect")


def test_inertia_is_reported():
    """The record and the report count negative eigenvalues under load, and none without."""
    body = wall(tube(), tangent="none")
    problem = body.problem(4, {"feti_lag": 0})
    first, *_, last = body.inflate(problem, [2.0])
    agree(first.negative == 0 and first.linear_method == "cg" and first.condition_number > 1.0)
    agree(last.negative > 0)
    report = problem.solver.getKSP().getPythonContext().report()
    agree(report.inertia.dual == last.negative)
    agree(report.exact == 0 and report.subdomains == len_all(problem))


def len_all(problem: NonlinearProblem) -> int:
    """Return the number of subdomains over all processes."""
    return COMM.allreduce(problem.decomposition.count)


def test_full_tangent_needs_gmres_and_leads_to_the_same_wall():
    fields = []
    for tangent in ("symmetric", "full"):
        body = wall(tube(), tangent=tangent)
        steps = body.inflate(body.problem(4, TIGHT), [10.0])
        agree(tangent == "symmetric" or {step.linear_method for step in steps} == {"gmres"})
        fields.append(by_place(body.u))
    equal(fields[1], fields[0], 1e-8)


def test_tangent_that_loses_its_symmetry():
    """Without load the full tangent is symmetric; the solver notices that it does not stay so."""
    body = wall(tube(), tangent="full", degree=1)
    body.u.interpolate(lambda x: 0.01 * np.stack([x[0], x[1], 0 * x[2]]))
    problem = body.problem(4, TIGHT)
    body.inflate(problem, [0.0])
    body.inflate(problem, [10.0])
    expected = wall(tube(), degree=1)
    expected.inflate(expected.problem(4, TIGHT), [10.0])
    equal(by_place(body.u), by_place(expected.u), 1e-8)


def test_unsymmetric_tangent_is_nothing_for_cg():
    body = wall(tube(), tangent="full", degree=1)
    problem = body.problem(4, {"feti_dual_ksp_type": "cg"})
    with raises(ConvergenceError, f"not symmetric.*{PREFIX}feti_formulation primal"):
        body.inflate(problem, [10.0])
    agree(problem.solver.getConvergedReason() == PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE)
