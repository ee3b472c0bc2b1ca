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
    change_of_basis,
    energy_tolerances,
    independent_combinations,
)
from dolfinx_feti.feti.coarse.null_space import is_null_space, make_regular
from dolfinx_feti.feti.coarse.products import (
    amplifies_rounding,
    compute_products,
    interface_stiffness,
)
from dolfinx_feti.feti.coarse.rounding import NEGATIVE_ENERGY_MARGIN, column_energy_rounding
from dolfinx_feti.feti.coarse.solver import CoarseSolver
from dolfinx_feti.feti.coarse.zero_energy import ZeroEnergyFields
from dolfinx_feti.feti.interface.copies import Copies
from dolfinx_feti.feti.subdomain.failures import on_subdomains
from dolfinx_feti.feti.subdomain.schur_operator import SchurOperator
from dolfinx_feti.feti.subsolver_options import DirectOptions
from dolfinx_feti.runtime.arrays import Array, concatenate
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.null_space import read_null_space


class PrimalCoarseProblem:
    """V, Vᵀ A and the factored A₀ of one matrix.

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
        S: SchurOperator,
        *,
        options: DirectOptions,
        is_symmetric: bool = True,
        combinations: Combinations | None = None,
        allow_single_precision: bool = True,
    ) -> None:
        """Assemble and factor the Galerkin matrix. Collective.

        Args:
            V: The averaged columns, which outlive this object; the caller destroys them.
            S: Schur complements of the present matrix.
            options: Options of the coarse solver.
            is_symmetric: Whether A is symmetric. If not, A₀ is factored by LU, which does not
                count negative eigenvalues.
            combinations: Combinations of the columns that were computed for an earlier matrix; None
                to compute them for the present one.
            allow_single_precision: Whether Vᵀ A may be stored in single precision, because V and
                K_ρ⁻¹ belong to the present matrix (``products``).

        Raises:
            SetUpError: A product on a subdomain, or the factor of A₀, failed; on all processes.
        """
        self.V = V
        self.N_c = V.N_c
        comm = V.copies.comm
        tolerances = energy_tolerances(interface_stiffness(V, S), comm)
        with Lifetime() as owned:
            self.VtA, energies = compute_products(
                V, S, is_symmetric=is_symmetric, allow_single_precision=allow_single_precision
            )
            owned.own(self.VtA)
            with Lifetime() as temporary:
                temporary.own(energies)  # Vᵀ A V
                if combinations is None:
                    self.combinations = on_subdomains(
                        lambda: independent_combinations(
                            energies, V.blocks, tolerances.zero_energy
                        ),
                        comm,
                    )
                else:
                    self.combinations = combinations.without_zero_energy()
                B = self.combinations.B
                self.A_0 = owned.own(change_of_basis(energies, B))  # Bᵀ Vᵀ A V B
            self._make_regular_along_null_space(S)
            self.A_0.setOption(PETSc.Mat.Option.SYMMETRIC, is_symmetric)

            self.solver = owned.own(
                CoarseSolver(
                    self.A_0,
                    options=options,
                    is_symmetric=is_symmetric,
                    errors=V.copies.errors,
                    zero_pivot=tolerances.zero_pivot,
                    block_widths=self.combinations.widths,
                )
            )
            if self.VtA.has_single_precision() and amplifies_rounding(self.A_0, self.solver):
                self.VtA.store_in_double_precision()

            self.negative_eigenvalues = self.solver.inertia().negative
            if is_symmetric and self.negative_eigenvalues:
                self.negative_eigenvalues = self._negative_beyond_rounding(S, options)
            self.zero_energy_fields = ZeroEnergyFields(V, self.combinations, self.A_0, self.solver)
            self._x, self._e = (owned.own(vector) for vector in self.A_0.createVecs())
            self._owned = owned.pop_all()

    @property
    def copies(self) -> Copies:
        """Copies of the interface dofs."""
        return self.V.copies

    def _make_regular_along_null_space(self, S: SchurOperator) -> None:
        """Make A₀ regular along the null space Z of A that the user has given. Collective.

        The span of V B contains Z, unless subdomains resist it: K_i Z ≠ 0, although A Z = 0. Then
        A₀ y ≠ 0 for the amplitudes y of :meth:`_amplitudes`, and A₀ remains as it is. It may have
        zero pivots, which the coarse solver leaves out.

        The solutions are right, but take more iterations. An example is a free rectangle of six
        subdomains with eliminated interiors, and with springs whose sum is zero
        (tests/feti/test_null_space.py). It takes 9 iterations without springs, and 37 to 339 with
        springs of 1e-6 to 1e-2 of the stiffness. With these and a clamped side it takes 5 to 8.

        Args:
            S: Schur complements of the present matrix.
        """
        copies = self.V.copies
        Z = read_null_space(S.torn)[copies.dofs]
        y = on_subdomains(lambda: self._amplitudes(Z), copies.comm)
        if is_null_space(self.A_0, y):
            make_regular(self.A_0, y)

    def _amplitudes(self, Z: Array) -> Array:
        """Return y with Z = V B y for fields in the span of V B.

        On each subdomain Z = U_i s_i. Then Z = V s, because the average of a single-valued field is
        the field; and s = B y. Both equations are solved in the sense of least squares.

        Args:
            Z: Single-valued fields by their copies, (n_Γ, k).

        Returns:
            The amplitudes of this process, (n_0, k); meaningless for fields outside the span.
        """
        V = self.V
        B = self.combinations.B
        if not Z.size:
            return np.zeros((B.shape[1], Z.shape[1]))
        subdomains = zip(V.U, V.copies.rows, strict=True)
        s = np.vstack([np.linalg.pinv(U_i) @ Z[rows] for U_i, rows in subdomains])  # Z = U s
        y = scipy.sparse.linalg.spsolve((B.T @ B).tocsc(), B.T @ s)  # s = B y
        return np.asarray(y).reshape(B.shape[1], Z.shape[1])

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

    def _negative_beyond_rounding(self, S: SchurOperator, options: DirectOptions) -> int | None:
        """Return the number of negative eigenvalues of A₀ + ε, with ε above rounding. Collective.

        ε is diagonal: a multiple of the bounds of the rounding errors of the energies of V B,
        Σ_j b_j² (bound of column j) for a combination b. That neglects products of different
        columns, and may be too small by a factor of their number; the multiple makes up for it.

        Args:
            S: Schur complements of the present matrix.
            options: Options of the coarse solver.
        """
        bounds = column_energy_rounding(S, self.V.W)
        of_columns = self.V.dofmap.scatter_reverse(concatenate(bounds))
        B = self.combinations.B
        with Lifetime() as owned:
            ε = owned.own(self.A_0.createVecRight())
            ε.array[:] = NEGATIVE_ENERGY_MARGIN * (B.multiply(B).T @ of_columns)
            shifted = owned.own(self.A_0.copy())
            shifted.setDiagonal(ε, addv=PETSc.InsertMode.ADD_VALUES)
            # A₀ + ε most often has negative eigenvalues, and fronts factor definite matrices only.
            # Without block widths the solver does not try fronts: a group counts the eigenvalues.
            solver = owned.own(CoarseSolver(shifted, options=options, is_symmetric=True))
            return solver.inertia().negative
