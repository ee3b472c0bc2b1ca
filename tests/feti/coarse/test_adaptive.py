# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Adaptive columns agree with dense eigenvectors, as do the products they are computed from."""

import itertools
from types import SimpleNamespace

import numpy as np
import primal_form
import pytest
import scipy.linalg
from cases import case, every_interior, every_type
from collective import COMM, agree, equal, random_part, small

from dolfinx_feti.feti.coarse.adaptive import (
    INTERFACE_DOFS_FOR_ALL_COLUMNS,
    MAX_STEPS,
    MIN_STEPS,
    adaptive_columns,
)
from dolfinx_feti.feti.primal.assembled_product import (
    copy_block,
    create_assembled_product,
    load_block_code,
)

SEED = 2013
ADAPTIVE = "dolfinx_feti.feti.coarse.adaptive"
GRID = case((3, 2), (3, 2), 2)


class Subdomains:
    """Subdomains with random weights δ, spectra of T_i A T_iᵀ from 1e-6 to 1, and two columns E."""

    def __init__(self, *sizes):
        rng = np.random.default_rng(SEED)
        ends = np.cumsum([0, *sizes])
        blocks = [slice(a, b) for a, b in itertools.pairwise(ends)]
        self.copies = SimpleNamespace(rows=blocks, delta=rng.uniform(0.2, 0.9, ends[-1]), comm=COMM)
        self.A = []
        self.E = []
        for n in sizes:
            Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
            self.A.append(Q * np.geomspace(1e-6, 1.0, n) @ Q.T)
            self.E.append(rng.standard_normal((n, min(2, n // 4))))
        self.S_ρ = [0.1 * A + 1e-5 * np.eye(len(A)) for A in self.A]

    def solve(self, i, F):
        return np.linalg.solve(self.S_ρ[i], F)

    def columns(self, max_columns, threshold, solve=None):
        """Return the adaptive columns of all subdomains, (n_{Γ,i}, k_i) each."""
        return adaptive_columns(
            self.copies,
            lambda i, X: self.A[i] @ X,
            solve or self.solve,
            self.E,
            max_columns=max_columns,
            threshold=threshold,
        )

    def average_energy(self, i):
        """Return δ T_i A T_iᵀ δ, the energy of averages, (n_{Γ,i}, n_{Γ,i})."""
        δ = self.copies.delta[self.copies.rows[i]]
        return δ[:, None] * self.A[i] * δ

    def eigenvalues(self, i, U=None):
        """Return the eigenvalues χ of fields u with Eᵀ S_ρ u = 0 and, with a U, Uᵀ S_ρ u = 0."""
        u = np.linalg.solve(self.S_ρ[i], scipy.linalg.null_space(self.E[i].T))
        if U is not None:
            u = u @ scipy.linalg.null_space(U.T @ self.S_ρ[i] @ u)
        return scipy.linalg.eigh(
            u.T @ self.average_energy(i) @ u, u.T @ self.S_ρ[i] @ u, eigvals_only=True
        )


@pytest.mark.parametrize("threshold", [0.1, 1.0, 4.0])
def test_all_eigenvectors_above_the_threshold_are_found(threshold, monkeypatch):
    """With enough columns allowed; they have unit energy, and all others are below it."""
    body = Subdomains(12, 30)
    monkeypatch.setattr(f"{ADAPTIVE}.INTERFACE_DOFS_FOR_ALL_COLUMNS", 1)
    monkeypatch.setattr(f"{ADAPTIVE}.MIN_STEPS", 6)
    monkeypatch.setattr(f"{ADAPTIVE}.MAX_STEPS", 6)
    for i, U in enumerate(body.columns(30, threshold)):
        χ = body.eigenvalues(i)
        agree(U.shape[1] == np.count_nonzero(χ > threshold))
        equal(U.T @ body.S_ρ[i] @ U, np.eye(U.shape[1]), 1e-8)
        equal(np.diag(U.T @ body.average_energy(i) @ U), χ[χ > threshold][::-1], 1e-6)
        small(np.abs(body.E[i].T @ body.S_ρ[i] @ U).max(initial=0.0), 1e-8)
        agree(body.eigenvalues(i, U).max() <= threshold * (1.0 + 1e-8))


def test_limited_columns_approximate_the_largest_eigenvalues():
    """A search with a tenth of the interface dofs comes close to them."""
    body = Subdomains(INTERFACE_DOFS_FOR_ALL_COLUMNS // 2)
    (U,) = body.columns(60, 0.1)
    χ = body.eigenvalues(0)[::-1]
    agree(0 < U.shape[1] <= 30)
    ritz_values = np.diag(U.T @ body.average_energy(0) @ U)
    agree(np.all(np.diff(ritz_values) <= 1e-8))
    agree(np.all(ritz_values <= χ[: len(ritz_values)] * (1.0 + 1e-8)))
    agree(ritz_values[:4].sum() >= 0.8 * χ[:4].sum())


@pytest.mark.parametrize("threshold", [1e-3, 1e3])
def test_steps_continue_while_most_values_exceed_the_threshold(threshold):
    """If all exceed it, to the last step, and if few do, no further than the first ones."""
    body = Subdomains(INTERFACE_DOFS_FOR_ALL_COLUMNS // 4)
    block_sizes = []

    def counting_solve(i, F):
        block_sizes.append(F.shape[1])
        return body.solve(i, F)

    body.columns(24, threshold, counting_solve)
    steps = MAX_STEPS if threshold < 1.0 else MIN_STEPS
    agree(block_sizes == [1] * steps, block_sizes)


def test_columns_are_allotted_by_interface_dofs():
    """A subdomain has its share of 640 interface dofs, at most a column for each, or none."""
    body = Subdomains(
        0,
        1,
        2,
        2 * MAX_STEPS,
        INTERFACE_DOFS_FOR_ALL_COLUMNS // 4,
        INTERFACE_DOFS_FOR_ALL_COLUMNS // 2,
    )
    counts = [U.shape[1] for U in body.columns(48, 0.0)]
    agree(counts == [0, 1, 2, MAX_STEPS, 12, 24])
    agree(all(U.shape == (len(S), 0) for U, S in zip(body.columns(0, 0.0), body.S_ρ, strict=True)))
    body.copies.delta[:] = 0.0
    agree(not any(U.size for U in body.columns(9, 1e-12)))


def test_columns_do_not_depend_on_other_subdomains():
    """Random numbers begin anew with each subdomain."""
    together = Subdomains(80, 80)
    alone = Subdomains(80)
    for own, other in ((together.A, alone.A), (together.S_ρ, alone.S_ρ), (together.E, alone.E)):
        own[1] = other[0]
    together.copies.delta[80:] = alone.copies.delta
    equal(together.columns(36, 0.5)[1], alone.columns(36, 0.5)[0])


def volume_changes(cells):
    """Return K_p, the mean of div φ over each cell of a brick, (cells, dofs)."""
    shape = [n + 1 for n in cells]
    number = np.arange(np.prod(shape)).reshape(shape)
    corners = np.array(list(itertools.product((0, 1), repeat=2)))
    mean = corners - 0.5  # of ∇φ over a cell
    K_p = np.zeros((np.prod(cells), number.size, 2))
    for row, (i, j) in zip(K_p, itertools.product(*map(range, cells)), strict=True):
        row[number[i : i + 2, j : j + 2].ravel()] = mean
    return K_p.reshape(len(K_p), -1)


@every_type
@every_interior
def test_adaptive_columns_save_iterations_for_a_large_bulk_modulus(
    kind, interior, torn_grid, create_primal, monkeypatch
):
    """A large κ makes averages costly; with a small κ columns do no harm."""
    monkeypatch.setattr(f"{ADAPTIVE}.INTERFACE_DOFS_FOR_ALL_COLUMNS", 40)
    cells = (4, 4)
    K_p = volume_changes(cells)
    iterations = {}
    for κ, adaptive in itertools.product((1e2, 1e6), (False, True)):

        def stiffen(K, dofs, κ=κ):
            for K_i in K:
                K_i += κ * K_p.T @ K_p

        def columns(setup, copies):
            S = setup.operator
            blocks = setup.inverse.by_subdomain
            E = [K_i.E_on_interface for K_i in blocks]
            return adaptive_columns(
                copies,
                create_assembled_product(S, copies).apply,
                lambda i, F: blocks[i].solve_on_interface(F),
                E,
                max_columns=36,
                threshold=2.0,
            )

        problem = torn_grid((4, 3), cells, components=2, change=stiffen)
        create_columns = columns if adaptive else None
        primal = create_primal(
            problem, create_columns, type=kind, interior=interior, coarse_modes=0
        )
        _, outcome = primal_form.cg(primal.system, random_part(primal.system.copies.size))
        agree(outcome.reason > 0)
        iterations[κ, adaptive] = outcome.iterations
    agree(iterations[1e2, True] <= iterations[1e2, False], iterations)
    agree(iterations[1e6, True] < iterations[1e6, False], iterations)


# ---- what a subdomain sees of the assembled interface ---------------------------------------


@every_type
@every_interior
def test_assembled_products_agree_with_dense_matrices(kind, interior, torn_grid, create_primal):
    """T_i A T_iᵀ of the formed S, with neighbours on any process; δ^−½ S_i δ^−½ otherwise."""
    problem = torn_grid(**GRID)
    primal = create_primal(problem, type=kind, interior=interior)
    exact = primal_form.reference(problem, primal)
    copies = primal.system.copies
    start = COMM.scan(copies.size) - copies.size
    glued = exact.T.any(axis=1)  # the rows without a prescribed value
    coupled = exact.T @ exact.T.T > 0.0
    product = create_assembled_product(primal.operator, copies)
    max_error = 0.0
    for i, block in enumerate(copies.rows):
        rows = np.arange(start + block.start, start + block.stop)
        copies_of = coupled[rows].astype(float)  # T_i Tᵀ: the copies of each row
        is_single_copy = ~glued[rows]
        copies_of[is_single_copy, rows[is_single_copy]] = 1.0
        A = copies_of @ exact.S @ copies_of.T
        if interior == "keep":
            root = np.where(is_single_copy, 1.0, exact.delta[rows]) ** -0.5
            A = root[:, None] * exact.S[np.ix_(rows, rows)] * root
        product_i = product.apply(i, np.eye(len(rows)))
        max_error = max(
            max_error, float(np.abs(product_i - A).max(initial=0.0) / np.abs(A).max(initial=1.0))
        )
    small(max_error, 1e-10 if interior == "keep" else 1e-6)  # A is unpacked in single precision


def test_copied_rows_may_be_in_any_order(torn_grid, create_primal):
    """The result is the lower triangle of the selected rows and columns, row by row."""
    operator = create_primal(torn_grid(**GRID), interior="eliminate").operator
    code = load_block_code(COMM)
    for i, S_i in enumerate(operator.by_subdomain):
        n = S_i.matrix.n
        S = S_i.multiply(np.eye(n))
        rows = np.random.default_rng(i).permutation(n)[:5].astype(np.int32)
        expected = S[np.ix_(rows, rows)][np.tril_indices(len(rows))]
        equal(copy_block(code, S_i, rows), expected, 1e-12)
