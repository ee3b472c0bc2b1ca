# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Fields of the coarse space without energy: mechanisms, or columns that depend on each other.

.. math:: V s, \qquad s = B y + B_0 y_0, \quad A_0\, y = 0

with the independent combinations B of the columns, and combinations B₀ of zero energy (``energy``).
If V s ≠ 0, it is a mechanism, a motion that nothing resists. If V s = 0, the columns only depend on
each other, which does no harm.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.coarse.averaged import AveragedBasis
from dolfinx_feti.feti.coarse.energy import Combinations
from dolfinx_feti.feti.coarse.solver import CoarseSolver
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import total_of
from dolfinx_feti.runtime.lifetime import Lifetime

#: ‖V s‖/‖V (±s)‖, with random signs of the entries of s, up to which V s is rounding. Dependent
#: columns cancel in V s, but not with random signs; rounding leaves a quotient of some 1e-10. The
#: quotient of a mechanism is smallest if many other columns depend on each other: one mechanism
#: beside 10 000 subdomains with dependent columns has about 1/√10 000 = 1e-2. The bound is a choice
#: between 1e-10 and 1e-2.
MAX_CANCELLED_NORM = 1e-5

#: Steps y ← y − A₀⁻¹ A₀ y, which project a random y to the kernel of A₀. The second one removes the
#: rounding errors of the first.
PROJECTION_STEPS = 2

#: Seed of :meth:`ZeroEnergyFields.has_mechanism`. Any other one would do.
MECHANISM_SEED = 0


class ZeroEnergyFields:
    """Number of the zero-energy combinations of a coarse space, and random fields of their span."""

    def __init__(
        self, V: AveragedBasis, combinations: Combinations, A_0: PETSc.Mat, solver: CoarseSolver
    ) -> None:
        """Refer to a coarse space, which outlives this object.

        Args:
            V: The coarse basis.
            combinations: B and B₀.
            A_0: Galerkin matrix of V B, (N_0, N_0).
            solver: Its solver, which leaves out zero pivots.
        """
        self._V = V
        self._combinations = combinations
        self._A_0 = A_0
        self._solver = solver

    def count(self) -> int:
        """Return the number of zero pivots of A₀ and of columns of B₀ together. Collective.

        A solver that does not report zero pivots counts as one without any.
        """
        zero_pivots = self._solver.inertia().zero_pivots or 0
        columns = self._combinations.B_0.shape[1]
        return zero_pivots + self._V.copies.comm.allreduce(columns)

    def has_mechanism(self) -> bool:
        """Return True if a random field of zero energy does not vanish, V s ≠ 0. Collective.

        It is compared with V (±s), random signs for each column. If the columns depend on each
        other, they cancel in V s, but not in V (±s).
        """
        s = self._amplitudes(MECHANISM_SEED)
        # The seed only has to differ from those of the amplitudes.
        signs = np.random.default_rng(self._V.n_c).choice([-1.0, 1.0], len(s))
        copies = self._V.copies
        fields = [self._V.prolong(s), self._V.prolong(signs * s)]
        squares = np.array([t @ (copies.delta * t) for t in fields])
        square, square_with_signs = total_of(squares, copies.comm)  # ‖V s‖², ‖V (±s)‖²
        return bool(square > MAX_CANCELLED_NORM**2 * square_with_signs)

    def field(self, seed: int) -> Array:
        """Return a random field V s of zero energy by its copies, (n_Γ,). Collective.

        Args:
            seed: A number ≥ 0; another one yields another field.
        """
        return self._V.prolong(self._amplitudes(seed))

    def _amplitudes(self, seed: int) -> Array:
        """Return random amplitudes s = B y + B₀ y₀ with A₀ y = 0, (n_c,). Collective.

        The first row of the process joins the seed, so that processes have different numbers, which
        are the same in each run.
        """
        first_row = self._A_0.getOwnershipRange()[0]
        rng = np.random.default_rng([seed, first_row])
        with Lifetime() as owned:
            x, A_0_y = map(owned.own, self._A_0.createVecs())
            y = rng.standard_normal(x.getLocalSize())
            for _ in range(PROJECTION_STEPS):
                x.array[:] = y
                self._A_0.mult(x, A_0_y)
                self._solver.solve(A_0_y, x)  # x = A₀⁻¹ A₀ y
                y = y - x.array_r
        B = self._combinations.B
        B_0 = self._combinations.B_0
        y_0 = rng.standard_normal(B_0.shape[1])
        return np.asarray(B @ y + B_0 @ y_0)
