# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Properties that all Krylov methods of the primal formulation share."""

from types import SimpleNamespace

from petsc4py import PETSc

import numpy as np
import pytest
from cases import case, each
from collective import agree, equal, random_part, small, whole

from dolfinx_feti.feti.primal.krylov.gmres import gmres
from dolfinx_feti.feti.primal.krylov.registry import KRYLOV_METHODS, RegisteredMethod, select_method
from dolfinx_feti.feti.primal.stopping import StoppingTest

GRID = case((3, 2), (3, 2), 2)
Reason = PETSc.KSP.ConvergedReason
every_method = pytest.mark.parametrize(
    "method", [method.solve for method in KRYLOV_METHODS.values()], ids=KRYLOV_METHODS
)


@pytest.fixture
def system(torn_grid, create_primal):
    """The assembled interface operator of a grid, with its preconditioner."""
    return create_primal(torn_grid(**GRID)).system


def run(method, system, f, *, target=1e-10, max_it=200):
    """Solve by a Krylov method.

    Args:
        method: Function of the method.
        system: System on the assembled interface.
        f: Right-hand side, not summed over copies, (n_Γ,).
        target: Norm of the residual that ends the solve.
        max_it: Most iterations.

    Returns:
        Solution, (n_Γ,), how the method ended, the basis of at most five iterations, and the
        monitored pairs of iteration and norm.
    """
    norms = []
    stopping = StoppingTest(target, max_it)
    x, info, basis = method(
        system,
        f,
        stopping,
        monitor=lambda its, norm: norms.append((its, norm)),
        stored_iterations=5,
        allow_indefinite=False,
    )
    return x, info, basis, norms


@every_method
def test_residual_meets_the_target_and_each_norm_is_monitored(method, system):
    """There is one norm for the start and one for each iteration."""
    f = random_part(system.copies.size)
    x, info, _, norms = run(method, system, f)
    agree(info.reason == Reason.CONVERGED_RTOL, info)
    agree([its for its, _ in norms] == list(range(info.iterations + 1)), norms)
    small(system.norm(system.residual(f, x)), 1e-9)


@every_method
def test_stored_basis_satisfies_the_arnoldi_relation(method, system):
    """A Z = R H for the stored iterations, of which there may be none."""
    _, _, basis, _ = run(method, system, random_part(system.copies.size))
    AZ = np.array([system.apply(z) for z in basis.Z])
    agree(len(basis.Z) <= 5)
    equal(whole(AZ.T), whole((basis.H.T @ basis.R).T), 1e-9)


@every_method
def test_iteration_limit_ends_a_solve(method, system):
    """The reason is DIVERGED_MAX_IT, after as many iterations as are allowed."""
    _, info, _, _ = run(method, system, random_part(system.copies.size), max_it=2)
    agree(info.reason == Reason.DIVERGED_MAX_IT and info.iterations == 2, info)


@every_method
def test_zero_load_needs_no_iteration(method, system):
    """The solution is zero."""
    x, info, _, _ = run(method, system, np.zeros(system.copies.size))
    agree(info.reason > 0 and info.iterations == 0 and not x.any(), info)


@every_method
def test_nan_load_is_reported(method, system):
    """The reason is DIVERGED_NANORINF."""
    _, info, _, _ = run(method, system, np.full(system.copies.size, np.nan))
    agree(info.reason == Reason.DIVERGED_NANORINF, info)


@pytest.mark.serial
@pytest.mark.parametrize(
    ("is_symmetric", "is_indefinite", "expected"),
    [(True, False, "cg"), (True, True, "minres"), (False, False, "gmres"), (False, True, "gmres")],
)
def test_method_is_chosen_by_symmetry_and_definiteness(
    is_symmetric, is_indefinite, expected, monkeypatch
):
    """A method for indefinite symmetric matrices is chosen for them, and for no others."""
    minres = RegisteredMethod(gmres, needs_symmetric=True, solves_indefinite=True)
    monkeypatch.setitem(KRYLOV_METHODS, "minres", minres)
    name = select_method(is_symmetric=is_symmetric, is_indefinite=is_indefinite)
    assert name == expected


@pytest.mark.serial
def test_cg_is_chosen_if_no_method_solves_indefinite_matrices():
    """CG then reports the negative curvature."""
    assert select_method(is_symmetric=True, is_indefinite=True) == "cg"


@pytest.mark.parametrize("name", ["cg", "gmres"])
def test_cg_and_gmres_store_vectors_for_recycling(name, system):
    """Ritz vectors are computed from the stored basis."""
    _, _, basis, _ = run(KRYLOV_METHODS[name].solve, system, random_part(system.copies.size))
    agree(len(basis.Z) > 0)


# ---- the stopping test ----------------------------------------------------------------------

WITH_ERROR = StoppingTest(1.0, 9, error_test=SimpleNamespace(error_tolerance=0.5))
WITHOUT_ERROR = StoppingTest(1.0, 9)
#: Test, ‖r‖, iterations, η; and the reason.
RESIDUALS = {
    "above its target": (WITHOUT_ERROR, 2.0, 8, np.nan, Reason.ITERATING),
    "above its target at last": (WITHOUT_ERROR, 2.0, 9, np.nan, Reason.DIVERGED_MAX_IT),
    "at its target": (WITHOUT_ERROR, 1.0, 9, np.nan, Reason.CONVERGED_RTOL),
    "not finite": (WITHOUT_ERROR, np.inf, 1, np.nan, Reason.DIVERGED_NANORINF),
    "at its target with an unknown error": (WITH_ERROR, 1.0, 9, np.nan, Reason.ITERATING),
    "at its target with a large error": (WITH_ERROR, 1.0, 1, 0.6, Reason.ITERATING),
    "at its target with a small error": (WITH_ERROR, 1.0, 1, 0.5, Reason.CONVERGED_RTOL),
    "zero with an unknown error": (WITH_ERROR, 0.0, 0, np.nan, Reason.CONVERGED_RTOL),
}


@pytest.mark.serial
@each("residual", RESIDUALS)
def test_stopping_test_of_the_residual(residual):
    """A residual at its target converges, unless an error is to be tested and is too large."""
    test, norm, its, error, expected = residual
    reason = test.reason_of_residual(norm, its, error)
    assert reason == expected


@pytest.mark.serial
@pytest.mark.parametrize(
    ("error", "its", "expected"),
    [
        (0.5, 9, Reason.CONVERGED_RTOL),
        (0.6, 8, Reason.ITERATING),
        (0.6, 9, Reason.DIVERGED_MAX_IT),
        (np.nan, 8, Reason.ITERATING),
    ],
)
def test_stopping_test_of_the_error(error, its, expected):
    """An error above its tolerance continues the solve up to the iteration limit."""
    assert WITH_ERROR.reason_of_error(error, its) == expected
