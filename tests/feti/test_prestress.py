# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Walls under pressure, where rotations leave the kernels: each linear solve is accurate."""

from dataclasses import replace

import numpy as np
import pytest
from cases import every_scaling, every_type
from collective import COMM, agree, equal, norm, random_part, small
from mixed import by_place, errors_of_solves, solve_assembled
from modes import modes_of
from problems import cube, dirichlet, tagged
from walls import tube, under_pressure, wall

import dolfinx
import ufl

from dolfinx_feti import kinematics, loads, materials
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.decomposition import tear
from dolfinx_feti.fem.split_form import dolfinx_form
from dolfinx_feti.loading.load_steps import follow_load
from dolfinx_feti.loading.steps import Steps
from dolfinx_feti.torn.matrix import Torn

MILD_PRESSURES = (2.0, 10.0)
PHYSIOLOGICAL_PRESSURES = (2.0, 10.0, 30.0)
TIGHT_TOLERANCE = {"snes_rtol": 1e-10}


def check_every_step(degree, subdomains, pressures, *, tangent="symmetric", kappa=1e3, **options):
    """Inflate a tube; assert that each linear solve has its residual and agrees with MUMPS.

    Args:
        degree: Degree of the displacement.
        subdomains: Number of subdomains.
        pressures: Pressures to be solved for, one after the other [mmHg].
        tangent: Kind of the pressure's tangent.
        kappa: κ [kPa].
        **options: PETSc options without prefix.

    Returns:
        Linear iterations of each Newton step.
    """
    body = wall(tube(), degree=degree, tangent=tangent, kappa=kappa)
    problem = body.problem(subdomains, {"ksp_rtol": 1e-8} | options)
    errors = errors_of_solves(problem)
    steps = body.inflate(problem, pressures)
    agree(len(steps) == len(errors) >= 2 * len(pressures))
    small(max(step.linear_residual for step in steps), 1e-8)
    small(np.max(errors), 1e-6)
    return [step.linear_iterations for step in steps]


@pytest.mark.parametrize("subdomains", [1, 4, 16])
@pytest.mark.parametrize(("degree", "growth"), [(1, 2.0), (2, 2.5)])
def test_iterations_hardly_grow_with_the_pressure(degree, growth, subdomains):
    """Many subdomains of P1 buckle alone; the stabilisation limits the iterations."""
    pressures = PHYSIOLOGICAL_PRESSURES if degree == 1 or subdomains < 16 else MILD_PRESSURES
    iterations = check_every_step(degree, subdomains, pressures)
    small(max(iterations) / max(iterations[0], 5), growth)  # the coarse space nearly solves


@pytest.mark.parametrize("tangent", ["none", "full"])
@pytest.mark.parametrize("degree", [1, 2])
def test_every_tangent_of_the_load_is_solved(degree, tangent):
    """The load's tangent is left out, or complete and unsymmetric."""
    check_every_step(degree, 4, MILD_PRESSURES, tangent=tangent)


@every_type
@every_scaling
def test_every_type_and_scaling_is_solved_under_pressure(kind, scaling):
    """Linear solves agree with MUMPS in each Newton step, for P1 and P2."""
    for degree, subdomains in ((1, 6), (2, 3)):
        check_every_step(degree, subdomains, MILD_PRESSURES, feti_type=kind, feti_scaling=scaling)


@pytest.mark.parametrize("preconditioner", ["lumped", "identity"])
def test_other_preconditioners_are_solved_under_pressure(preconditioner):
    """Linear solves agree with MUMPS in each Newton step."""
    check_every_step(1, 4, MILD_PRESSURES, kappa=100.0, feti_pc_type=preconditioner)


@pytest.mark.parametrize(("kind", "kappa"), [("all_floating", 1000.0), ("classical", 1e5)])
def test_wall_is_inflated_to_300_mmhg(kind, kappa):
    """There are few load steps, and linear solves take about the iterations of the first."""
    body = wall(tube(), kappa=kappa)
    problem = body.problem(6, {"feti_type": kind})

    def set_load(mmhg):
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


@pytest.mark.parametrize("degree", [1, 2])
def test_rotations_turn_the_internal_forces(degree):
    """K (ω × x) = ω × f_int in each subdomain, for the deformed x: Π is frame indifferent."""
    body = wall(tube(), degree=degree)
    body.u.interpolate(lambda x: 0.05 * np.stack([x[1] * x[2], np.sin(x[0]), x[0] ** 2 - x[1]]))
    body.p.interpolate(lambda x: 2.0 + np.cos(3 * x[0]))
    problem = body.problem(4)
    problem._system.residual()
    problem._system.linearise()
    V = body.u.function_space
    space = tear(V, problem.decomposition)
    internal = ufl.derivative(body.energy, body.u, ufl.TestFunction(V))
    f = np.zeros(3 * len(space.local_block))
    dolfinx.fem.assemble_vector(f, dolfinx_form(internal, (space,), Compiler(COMM)))
    x = V.tabulate_dof_coordinates() + body.u.x.array.reshape(-1, 3)
    torn = Torn(problem.A)
    for ω in np.eye(3):
        image = torn.multiply(np.cross(ω, x[space.local_block]).ravel())
        equal(image, np.cross(ω, f.reshape(-1, 3)).ravel(), 1e-10)
    agree(np.abs(f).max() > 1e-2)
    torn.destroy()


def test_kernel_is_exact_only_without_load(create_dual):
    """D = 0 as long as K R = 0; under load rotations leave the kernel, and translations stay.

    The tangent of the load is left out, since it resists translations. The record and the report
    count negative eigenvalues under load, and none at rest.
    """
    body = wall(tube(), tangent="none")
    problem = body.problem(4, {"feti_coarse_modes": 0, "feti_lag": 0})
    problem._system.residual()
    problem._system.linearise()
    unloaded = create_dual(problem.A, coarse_modes=0)
    agree(all(modes_of(unloaded).is_exact))
    small(max(np.abs(D).max() for D in modes_of(unloaded).D), 0.0)
    agree(unloaded.inertia.is_definite and unloaded.method == "cg")
    first, *_, last = body.inflate(problem, [2.0])
    agree(first.negative == 0 and first.linear_method == "cg" and first.condition_number > 1.0)
    report = problem.solver.getKSP().getPythonContext().report()
    agree(report.inertia.dual == last.negative > 0)
    agree(report.exact == 0 and report.subdomains == COMM.allreduce(problem.decomposition.count))
    loaded = create_dual(problem.A, coarse_modes=0)
    agree(not any(modes_of(loaded).is_exact))
    defects = list(zip(modes_of(loaded).D, modes_of(loaded).rho, strict=True))
    agree(all(1e-7 * ρ < np.abs(D).max() < ρ for D, ρ in defects))
    ranks = [np.linalg.matrix_rank(D, 1e-10 * ρ) - len(D) for D, ρ in defects]
    agree(max(ranks) <= -3, "a translation has no defect")


@pytest.mark.parametrize("rests", [False, True])
def test_full_tangent_takes_gmres_and_gives_the_same_wall(rests):
    """Without load it is symmetric, and the solver detects when it no longer is."""
    expected = wall(tube())
    body = wall(tube(), tangent="full")
    expected.inflate(expected.problem(4, TIGHT_TOLERANCE), [10.0])
    problem = body.problem(4, TIGHT_TOLERANCE)
    if rests:
        body.u.interpolate(lambda x: 0.01 * np.stack([x[0], x[1], 0 * x[2]]))
        body.inflate(problem, [0.0])
    agree({step.linear_method for step in body.inflate(problem, [10.0])} == {"gmres"})
    equal(by_place(body.u), by_place(expected.u), 1e-8)


# ---- a surface with a free rim: the tangent is not symmetric ---------------------------------


def clamped_below(V):
    """Return the condition that all dofs on z = 0 are zero."""
    return [dirichlet(V, lambda x: np.isclose(x[2], 0.0))]


def free_tube(tangent):
    """Return a tube clamped at one end, 8 160 dofs."""
    body = wall(tube(around=16, along=4, length=1.2), tangent=tangent)
    return replace(body, bcs=clamped_below(body.u.function_space))


def free_block(tangent, cells=6):
    """Return a neo-Hookean cube clamped below, under pressure above, P2–P0 with κ = 1000 kPa."""
    mesh = cube(3, cells)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    u, p = (dolfinx.fem.Function(W) for W in (V, dolfinx.fem.functionspace(mesh, ("DG", 0))))
    F = kinematics.deformation_gradient(u)
    C = kinematics.right_cauchy_green(F)
    J = kinematics.jacobian(F)
    psi = materials.neo_hookean(C, c=3.0, J=J) + materials.perturbed_lagrangian(J, p, 1000.0)
    degree = {"metadata": {"quadrature_degree": 4}}
    energy = psi * ufl.dx(**degree)
    above = tagged(mesh, lambda x: np.isclose(x[2], 1.0))
    return under_pressure(u, p, clamped_below(V), energy, above(1, **degree), tangent)


@pytest.mark.parametrize("create", [free_tube, free_block])
def test_gmres_takes_about_the_iterations_of_the_symmetric_part(create):
    """At 10 mmHg with a random load; both solutions agree with LU."""
    counts = {}
    for tangent in ("symmetric", "full"):
        body = create(tangent)
        body.load.value = loads.mmhg(10.0)
        problem = body.problem(16, {"ksp_rtol": 1e-8})
        problem._system.residual()
        problem._system.linearise()
        A = problem.A
        ksp = problem.solver.getKSP()
        ksp.setOperators(A)
        b, x = A.createVecs()
        b.array[:] = random_part(b.getLocalSize(), seed=3)
        ksp.solve(b, x)
        context = ksp.getPythonContext()
        agree(ksp.getConvergedReason() > 0, context.message)
        agree(context.formulation.name == "primal")
        agree(context.method == {"symmetric": "cg", "full": "gmres"}[tangent])
        expected = solve_assembled(A, b)
        small(norm(x.array_r - expected) / norm(expected), 1e-5)
        counts[tangent] = context.iterations
    agree(counts["full"] <= 1.3 * counts["symmetric"], counts)


def test_gmres_iterations_do_not_grow_along_a_load_path():
    """Each Newton step for a block with a free rim takes about the iterations of the first."""
    body = free_block("full", 4)
    steps = body.inflate(body.problem(8, {"ksp_rtol": 1e-8}), [4.0, 8.0])
    iterations = [step.linear_iterations for step in steps]
    agree({step.linear_method for step in steps} == {"gmres"})
    agree(max(iterations) <= 1.5 * iterations[0], iterations)
