# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The generalised inverse K⁺, exact under prestress (docs/theory.md).

.. math:: K_ρ = K + ρ\, R R^⊤, \quad K^+ = K_ρ^{-1}, \quad
          W = K R, \quad E = R - K_ρ^{-1} W, \quad D = E^⊤ W

for *any* symmetric K and orthonormal R, (n_i, k); where K R = 0, E = R and D = 0 are the paper's
(eq. 39, Augustin_eq:localSolutions; eq. 40). R is a function of the present matrix alone: rigid
body modes (``modes``), null vectors (``nullspace``), buckling modes, so that :math:`K_ρ` is
positive definite, and soft ones (``soft``). S replaces K where the interior is eliminated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from dolfinx_feti.errors import FactorError, SingularBlockError
from dolfinx_feti.feti.gluing.jump import Dofs
from dolfinx_feti.feti.subdomain.blocks import as_slice, named
from dolfinx_feti.feti.subdomain.factors.dense import SINGLE, DenseFactor
from dolfinx_feti.feti.subdomain.factors.protocol import Factor, sum_known
from dolfinx_feti.feti.subdomain.modes import SubdomainModes, kernel_basis
from dolfinx_feti.feti.subdomain.nullspace import factor_tells_singular, growth, null_space
from dolfinx_feti.feti.subdomain.operator import Operator
from dolfinx_feti.feti.subdomain.orthonormal import append_orthonormal, orthonormal, symmetric_part
from dolfinx_feti.feti.subdomain.soft import Basis, buckling_modes, join, soft_modes
from dolfinx_feti.runtime.arrays import Array, Indices
from dolfinx_feti.runtime.collective import deferred
from dolfinx_feti.runtime.events import event

Solve = Callable[[Array], Array]

#: ‖K R‖ below this multiple of ‖K‖‖R‖ counts as zero: rounding of the assembly.
KERNEL_TOLERANCE = 1e-12

#: Rounds of enrichment of one subdomain for one matrix.
ENRICHMENTS = 3

#: ρ is at least this multiple of the most negative curvature that it has to lift above zero.
LIFT = 2.0

#: Error of a solve in single precision up to which it preconditions.
ROUGH = 0.1

#: Share of the mean stiffness of the interface dofs by which D is negative where stress softens a
#: subdomain.
SOFTENED = 5e-4

#: An eigenvalue of D above this multiple of −ρ counts as zero: rounding of the local solves.
DEFECT_TOLERANCE = 1e-13


@dataclass(frozen=True, slots=True)
class PseudoInverse:
    """K⁺ of every subdomain of one matrix; S⁺ where the interior is eliminated.

    Attributes:
        modes: Those of each subdomain.
        factors: Factors of K_ρ, without soft modes.
        rows: The dofs of each subdomain, a slice where they are consecutive.
    """

    modes: tuple[SubdomainModes, ...]
    factors: tuple[Factor, ...]
    rows: tuple[slice | Indices, ...]

    def solve(self, y: Array, *, up_to_soft_modes: bool = False) -> Array:
        """Apply the generalised inverse, K⁺ y, (n,), or K⁺ Y, (n, r); zero on fixed dofs.

        The result may have any share of E_Y if it is wanted ``up_to_soft_modes``.
        """

        def solve() -> Array:
            x = np.zeros_like(y)
            for factor, rows in zip(self.factors, self.rows, strict=True):
                x[rows] = factor.solve(y[rows])
            if not up_to_soft_modes:
                for rows, modes in zip(self.rows, self.modes, strict=True):
                    if modes.soft:
                        x[rows] -= modes.E_Y @ (modes.Y.T @ x[rows])
            return x

        with event("FETILocalSolve"):
            return deferred(solve, y.shape)

    def solver(self, i: int) -> Solve:
        """Return what applies the generalised inverse of subdomain i to columns, (n_i, r).

        It serves until the inverse of another one is applied.
        """
        factor, modes = self.factors[i], self.modes[i]
        solve: Solve = factor.solve
        if isinstance(factor, DenseFactor):
            solve = factor.solver()
        if not modes.soft:
            return solve

        def without_soft_modes(F: Array) -> Array:
            X = solve(F)
            return np.asarray(X - modes.E_Y @ (modes.Y.T @ X))

        return without_soft_modes

    @property
    def rough(self) -> bool:
        """Whether some factor of this process is in single precision."""
        return any(map(_is_single, self.factors))

    def negative(self) -> int | None:
        """Count the negative eigenvalues of all factored K_ρ of this process; None if not known."""
        return sum_known([factor.pivots.negative for factor in self.factors])

    def memory(self) -> float:
        """Return the memory of the factors of this process in MiB."""
        return sum(factor.memory() for factor in self.factors)

    def destroy(self) -> None:
        """Free the factors."""
        for factor in self.factors:
            factor.destroy()


def create_pseudo_inverse(
    operator: Operator,
    dofs: Dofs,
    near_kernel: Array,
    *,
    soft: int,
    threshold: float,
    rough: bool,
    adaptive: bool,
) -> PseudoInverse:
    """Find the modes of every subdomain and factor K_ρ, in single precision if ``rough`` will do.

    Up to ``soft`` modes below the threshold join R, but not where there are ``adaptive`` columns,
    too: these find the soft modes of a subdomain that no stress softens. A FactorError is that of a
    subdomain, not of all processes.
    """
    torn = operator.torn
    weight = np.where(dofs.glued, torn.stiffness(), 0.0)
    rigid = [kernel_basis(near_kernel[rows], dofs.fixed[rows]) for rows in torn.subdomains]
    defects = _defects(operator, dofs, rigid)
    if operator.eliminated:
        rigid = [orthonormal(R[on]) for R, on in zip(rigid, dofs.on_interface, strict=True)]
    factors, modes = [], []
    for i, (R, defect) in enumerate(zip(rigid, defects, strict=True)):
        with named(torn.first + i):
            stiffness = weight[operator.dofs[i]]
            K = _Block(operator, i, operator.diagonal(i), stiffness, rough)
            find = partial(soft_modes, weight=stiffness, most=soft, threshold=threshold)
            factor, of_block = _regularise(K, R, defect, find, adaptive=adaptive)
        factors.append(factor)
        modes.append(of_block)
    return PseudoInverse(
        tuple(modes), tuple(factors), tuple(as_slice(rows) for rows in operator.dofs)
    )


class _Block(NamedTuple):
    """The matrix K of one subdomain, or its S, which may be factored with less work if rough.

    The diagonal is its absolute one, the stiffness that of the interface dofs before a pressure is
    condensed, else zero, (n,) each.
    """

    operator: Operator
    i: int
    diagonal: Array
    stiffness: Array
    rough: bool

    def factor(self, R: Array, rho: float, shift: Array | None = None) -> Factor:
        return self.operator.factor(self.i, R, rho, shift)

    def factor_roughly(self, R: Array, rho: float) -> Factor:
        factor = self.operator.factor_roughly(self.i, R, rho) if self.rough else None
        if factor is None:
            return self.factor(R, rho)
        if not _is_single(factor) or growth(factor, self.diagonal) * SINGLE <= ROUGH:
            return factor
        factor.destroy()
        return self.factor(R, rho)

    def product(self, X: Array) -> Array:
        return self.operator.local_product(self.i, X)

    def regularised_product(self, R: Array, rho: float, X: Array) -> Array:
        return self.product(X) + rho * (R @ (R.T @ X))  # K_ρ X

    def is_singular(self, factor: Factor) -> bool:
        return factor_tells_singular(factor, self.diagonal)


def _is_single(factor: Factor) -> bool:
    return isinstance(factor, DenseFactor) and factor.single


def _regularise(
    K: _Block, rigid: Array, defect: float, find_soft: Callable[[Solve], Array], *, adaptive: bool
) -> tuple[Factor, SubdomainModes]:
    """Factor K_ρ without soft modes, and find all modes; the defect of the rigid ones is ‖K R‖."""
    rho = float(K.diagonal.mean()) if len(K.diagonal) else 1.0
    factor, kernel = _with_null_vectors(K, rigid, rho)
    factor, R, rho = _with_buckling_modes(K, factor, kernel, rho)
    exact = defect <= KERNEL_TOLERANCE * rho and R is kernel
    R, E, D = stiff = _basis(K, factor, R, rho, exact=exact)
    softened = _is_softened(K, D)
    columns_suffice = adaptive and _is_single(factor) and not softened
    k, soft = R.shape[1], R[:, :0] if columns_suffice else find_soft(factor.solve)
    Y = append_orthonormal(R, soft)[:, k:]
    if Y.shape[1]:
        R, E, D = join(stiff, Y, factor.solve(Y), rho)
    return factor, SubdomainModes(
        R,
        E,
        D,
        stabilisation=R @ _negative_directions(D, rho),
        exact=exact and Y.shape[1] == 0,
        softened=softened,
        rho=rho,
        kernel=kernel.shape[1],
        null=kernel.shape[1] - rigid.shape[1],
        soft=Y.shape[1],
    )


def _with_null_vectors(K: _Block, R: Array, rho: float) -> tuple[Factor, Array]:
    """Factor K_ρ, and append to R the null vectors that it still has; return both."""
    try:
        factor = K.factor_roughly(R, rho)
        if _is_single(factor) or not K.is_singular(factor):
            return factor, R
        factor.destroy()
    except FactorError:  # a solver that stops at a zero pivot
        pass
    Y = null_space(K.product, lambda known, shift: K.factor(known, 1.0, shift), K.diagonal, R)
    R = append_orthonormal(R, Y)
    factor = K.factor(R, rho)
    if Y.shape[1] and K.is_singular(factor):
        raise SingularBlockError("the regularised matrix stays singular with its null vectors")
    return factor, R


def _with_buckling_modes(
    K: _Block, factor: Factor, R: Array, rho: float
) -> tuple[Factor, Array, float]:
    """Append buckling modes to R until K_ρ is positive definite; return its factor, R and ρ."""
    for _ in range(ENRICHMENTS):
        negative = factor.pivots.negative
        if not negative:
            break
        multiply = partial(K.regularised_product, R, rho)
        more = append_orthonormal(R, buckling_modes(factor.solve, multiply, len(R), negative))
        lowest = np.linalg.eigvalsh(more.T @ K.product(more)).min(initial=np.inf)
        needed = max(rho, -LIFT * float(lowest))
        if more.shape[1] == R.shape[1] and needed == rho:
            break
        raised = K.factor_roughly(more, needed)
        if K.is_singular(raised):  # a border that the factor cannot tell from zero
            raised.destroy()
            break
        factor.destroy()
        factor, R, rho = raised, more, needed
    return factor, R, rho


def _basis(K: _Block, factor: Factor, R: Array, rho: float, *, exact: bool) -> Basis:
    """Return R with E and D of the factored K_ρ; R and 0 where K R = 0."""
    if exact:
        return R, R, np.zeros((R.shape[1], R.shape[1]))
    W = K.product(R)  # W = K R
    E = R - factor.solve(W)  # E = R − K_ρ⁻¹ W
    return R, E, symmetric_part(E.T @ W)  # D = Eᵀ W


def _is_softened(K: _Block, D: Array) -> bool:
    """Tell whether stress softens the subdomain, from D, (k, k)."""
    glued = K.stiffness > 0.0
    if not glued.any():
        return False
    return bool(np.linalg.eigvalsh(D).min(initial=0.0) < -SOFTENED * K.stiffness[glued].mean())


def _defects(operator: Operator, dofs: Dofs, R: Sequence[Array]) -> list[float]:
    """Estimate ‖K R‖ of every subdomain on its free dofs, by ‖K R ω‖ for random weights ω."""
    t = np.zeros(operator.torn.n)
    for rows, R_i in zip(dofs.free, R, strict=True):
        t[rows] = R_i @ np.random.default_rng(len(rows)).uniform(1.0, 2.0, R_i.shape[1])
    image = operator.torn.multiply(t)
    return [float(np.linalg.norm(image[rows])) for rows in dofs.free]


def _negative_directions(D: Array, rho: float) -> Array:
    """Return 2 y √−δ for the eigenvalues δ < 0 of D, above rounding."""
    δ, y = np.linalg.eigh(D)
    negative = δ < -DEFECT_TOLERANCE * rho
    return np.asarray(2.0 * y[:, negative] * np.sqrt(-δ[negative]))
