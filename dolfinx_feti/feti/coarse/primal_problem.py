# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The coarse problem of the primal formulation: Galerkin matrix A₀, its solver, the projection Π.

.. math:: A_0 = B^⊤ V^⊤ A\, V B, \qquad Π = I - V B\, A_0^{-1} B^⊤ V^⊤ A

(docs/theory.md, *The coarse problem of the primal form*) with the averaged columns V, N_c of them,
and their independent combinations B, (N_c, N_0). V and B may belong to an earlier matrix; Vᵀ A and
A₀ belong to the present one. A has at least as many negative eigenvalues as A₀, its restriction to
the span of V B (Courant and Fischer).
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from dolfinx_feti.feti.coarse.averaged import AveragedBasis
from dolfinx_feti.feti.coarse.energy import (
    Combinations,
    EnergyTolerances,
    change_of_basis,
    energy_tolerances,
    independent_combinations,
)
from dolfinx_feti.feti.coarse.null_space import is_null_space, make_regular
from dolfinx_feti.feti.coarse.products import StoredProducts, amplifies_rounding, compute_products
from dolfinx_feti.feti.coarse.rounding import NEGATIVE_ENERGY_MARGIN, column_energy_rounding
from dolfinx_feti.feti.coarse.solver import CoarseSolver
from dolfinx_feti.feti.coarse.zero_energy import ZeroEnergyFields
from dolfinx_feti.feti.interface.copies import Copies
from dolfinx_feti.feti.subdomain.failures import on_subdomains
from dolfinx_feti.feti.subdomain.schur_operator import SchurOperator
from dolfinx_feti.feti.subsolver_options import DirectOptions
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.matrix import Torn
from dolfinx_feti.torn.null_space import read_null_space


class PrimalCoarseProblem:
    """V, Vᵀ A and the factored A₀ of one matrix; created by :func:`create_primal_coarse_problem`.

    Attributes:
        V: The averaged columns.
        N_c: Number of columns over all processes.
        combinations: B, and the combinations B₀ of zero energy.
        VtA: The products Vᵀ A.
        A_0: Galerkin matrix of V B, (N_0, N_0).
        solver: Its solver.
        negative_eigenvalues: Number of negative eigenvalues of A₀ beyond rounding, a lower bound of
            those of A; None if not known.
        zero_energy_fields: Fields of zero energy.
    """

    def __init__(
        self,
        V: AveragedBasis,
        combinations: Combinations,
        products: StoredProducts,
        A_0: PETSc.Mat,
        solver: CoarseSolver,
        negative_eigenvalues: int | None,
    ) -> None:
        """Own the products, A₀ and its solver; V outlives this object. Collective.

        Args:
            V: The averaged columns.
            combinations: B and B₀.
            products: Vᵀ A.
            A_0: Galerkin matrix of V B, (N_0, N_0).
            solver: Its solver.
            negative_eigenvalues: Number of negative eigenvalues of A₀; None if not known.
        """
        self.V = V
        self.N_c = V.N_c
        self.combinations = combinations
        self.VtA = products
        self.A_0 = A_0
        self.solver = solver
        self.negative_eigenvalues = negative_eigenvalues
        self.zero_energy_fields = ZeroEnergyFields(V, combinations, A_0, solver)
        self._owned = Lifetime()
        for owned in (products, A_0, solver):
            self._owned.own(owned)
        self._x, self._e = (self._owned.own(vector) for vector in A_0.createVecs())

    @property
    def copies(self) -> Copies:
        """Copies of the interface dofs."""
        return self.V.copies

    def initial_guess(self, r: Array) -> Array:
        """Return V B A₀⁻¹ Bᵀ Vᵀ r of an assembled r; both by copies, (n_Γ,). Collective."""
        return self.V.prolong(self.solve(self.V.restrict(r)))

    def correct(self, z: Array, r: Array) -> Array:
        """Return z + V B A₀⁻¹ Bᵀ Vᵀ (r − A z), which is Π z if Vᵀ r = 0. Collective.

        Args:
            z: Assembled correction by its copies, (n_Γ,).
            r: Assembled residual by its copies, (n_Γ,).
        """
        e = self.V.restrict(r) - self.VtA.multiply(z)  # Vᵀ (r − A z)
        return z + self.V.prolong(self.solve(e))

    def solve(self, e: Array) -> Array:
        """Return B A₀⁻¹ Bᵀ e, (n_c,) → (n_c,); NaN if the solver fails. Collective."""
        B = self.combinations.B
        self._e.array[:] = B.T @ e
        self.solver.solve(self._e, self._x)
        return np.asarray(B @ self._x.array_r)

    def destroy(self) -> None:
        """Free Vᵀ A, A₀ and its solver, but not V."""
        self._owned.close()


def create_primal_coarse_problem(
    V: AveragedBasis,
    S: SchurOperator,
    *,
    options: DirectOptions,
    is_symmetric: bool,
    combinations: Combinations | None = None,
    allow_single_precision: bool = True,
) -> PrimalCoarseProblem:
    """Assemble and factor A₀, and count its negative eigenvalues. Collective.

    Args:
        V: The averaged columns, which outlive the result; the caller destroys them.
        S: Schur complements of the present matrix.
        options: Options of the coarse solver.
        is_symmetric: Whether A is symmetric. If not, A₀ is factored by LU, which does not count
            negative eigenvalues.
        combinations: Combinations of the columns that were computed for an earlier matrix; None to
            compute them for the present one.
        allow_single_precision: Whether Vᵀ A may be stored in single precision, because V and K_ρ⁻¹
            belong to the present matrix (``products``).

    Returns:
        The coarse problem; the caller destroys it.

    Raises:
        SetUpError: A product on a subdomain, or the factor of A₀, failed; on all processes.
    """
    stiffness = np.abs(S.torn.diagonal()[V.copies.dofs])  # of each interface dof, (n_Γ,)
    tolerances = energy_tolerances(stiffness, V.copies.comm)
    with Lifetime() as owned:  # destroyed if a later step fails
        products, energies = compute_products(
            V,
            S,
            stiffness,
            is_symmetric=is_symmetric,
            allow_single_precision=allow_single_precision,
        )
        owned.own(products)  # Vᵀ A
        with Lifetime() as temporary:
            temporary.own(energies)  # Vᵀ A V
            if combinations is None:
                combinations = _combine_columns(V, energies, tolerances)
            else:
                combinations = combinations.without_zero_energy()
            A_0 = owned.own(change_of_basis(energies, combinations.B))  # Bᵀ Vᵀ A V B
        _make_regular_along_null_space(A_0, V, combinations.B, S.torn)
        A_0.setOption(PETSc.Mat.Option.SYMMETRIC, is_symmetric)
        solver = owned.own(
            CoarseSolver(
                A_0,
                options=options,
                is_symmetric=is_symmetric,
                errors=V.copies.errors,
                zero_pivot=tolerances.zero_pivot,
                block_widths=combinations.widths,
            )
        )
        if products.has_single_precision() and amplifies_rounding(A_0, solver):
            products.store_in_double_precision()
        negative = solver.inertia().negative
        if is_symmetric and negative:  # some of them may be rounding errors
            rounding = _energy_rounding(V, combinations.B, S)
            negative = _count_negative_beyond(rounding, A_0, options)
        problem = PrimalCoarseProblem(V, combinations, products, A_0, solver, negative)
        owned.release()  # the problem owns them
    return problem


def _combine_columns(
    V: AveragedBasis, energies: PETSc.Mat, tolerances: EnergyTolerances
) -> Combinations:
    """Return B and B₀ for the energies Vᵀ A V of the present matrix, (N_c, N_c). Collective."""
    blocks = [columns.block for columns in V.by_subdomain]
    return on_subdomains(
        lambda: independent_combinations(energies, blocks, tolerances.zero_energy), V.copies.comm
    )


def _make_regular_along_null_space(
    A_0: PETSc.Mat, V: AveragedBasis, B: scipy.sparse.csr_array, torn: Torn
) -> None:
    """Make A₀ regular along the null space Z of A that the user has given. Collective.

    The span of V B contains Z, unless subdomains resist it: K_i Z ≠ 0, although A Z = 0. Then
    A₀ y ≠ 0 for the amplitudes y of :func:`_amplitudes`, and A₀ remains as it is. It may have zero
    pivots, which the coarse solver leaves out.

    The solutions are right, but take more iterations. An example is a free rectangle of six
    subdomains with eliminated interiors, and with springs whose sum is zero
    (tests/feti/test_null_space.py). It takes 9 iterations without springs, and 37 to 339 with
    springs of 1e-6 to 1e-2 of the stiffness. With these and a clamped side it takes 5 to 8.

    Args:
        A_0: Galerkin matrix of V B, (N_0, N_0), changed in place.
        V: The averaged columns.
        B: Their independent combinations, rows and columns of this process, (n_c, n_0).
        torn: The torn matrix, to which Z is attached.
    """
    copies = V.copies
    Z = read_null_space(torn)[copies.dofs]
    y = on_subdomains(lambda: _amplitudes(V, B, Z), copies.comm)
    if is_null_space(A_0, y):
        make_regular(A_0, y)


def _amplitudes(V: AveragedBasis, B: scipy.sparse.csr_array, Z: Array) -> Array:
    """Return y with Z = V B y for fields in the span of V B.

    On each subdomain Z = U_i s_i. Then Z = V s, because the average of a single-valued field is the
    field; and s = B y. Both equations are solved in the sense of least squares.

    Args:
        V: The averaged columns.
        B: Their independent combinations, (n_c, n_0).
        Z: Single-valued fields by their copies, (n_Γ, k).

    Returns:
        The amplitudes of this process, (n_0, k); meaningless for fields outside the span.
    """
    if not Z.size:
        return np.zeros((B.shape[1], Z.shape[1]))
    s = np.vstack(
        [np.linalg.pinv(columns.U) @ Z[columns.rows] for columns in V.by_subdomain]  # Z = U s
    )
    y = scipy.sparse.linalg.spsolve((B.T @ B).tocsc(), B.T @ s)  # s = B y
    return np.asarray(y).reshape(B.shape[1], Z.shape[1])


def _energy_rounding(V: AveragedBasis, B: scipy.sparse.csr_array, S: SchurOperator) -> Array:
    """Return bounds of the rounding errors of the diagonal of A₀, (n_0,). Collective.

    The bound of a combination b is Σ_j b_j² (bound of column j). That neglects products of
    different columns, and may be too small by a factor of their number;
    ``NEGATIVE_ENERGY_MARGIN`` makes up for it.

    Args:
        V: The averaged columns.
        B: Their independent combinations, (n_c, n_0).
        S: Schur complements of the present matrix.
    """
    bounds = column_energy_rounding(S, V.by_subdomain)
    return np.asarray(B.multiply(B).T @ V.dofmap.scatter_reverse(bounds))


def _count_negative_beyond(rounding: Array, A_0: PETSc.Mat, options: DirectOptions) -> int | None:
    """Return the number of negative eigenvalues of A₀ + ε, with ε above rounding. Collective.

    Args:
        rounding: Bounds of the rounding errors of the diagonal, (n_0,); ε is a multiple of them.
        A_0: Galerkin matrix, (N_0, N_0), which does not change.
        options: Options of the coarse solver.
    """
    with Lifetime() as owned:
        ε = owned.own(A_0.createVecRight())
        ε.array[:] = NEGATIVE_ENERGY_MARGIN * rounding
        shifted = owned.own(A_0.copy())
        shifted.setDiagonal(ε, addv=PETSc.InsertMode.ADD_VALUES)
        # A₀ + ε most often has negative eigenvalues, and fronts factor definite matrices only.
        # Without block widths the solver does not try fronts: a group counts the eigenvalues.
        solver = owned.own(CoarseSolver(shifted, options=options, is_symmetric=True))
        return solver.inertia().negative
