# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""All modes of one subdomain for one matrix, and the factor of :math:`K_ρ` (docs/theory.md).

.. math:: K_ρ = K + ρ\, R R^⊤, \qquad W = K R, \quad E = R - K_ρ^{-1} W, \quad D = E^⊤ W

for any symmetric K and orthonormal R, (n_i, k). These E and D are those of ``modes``, because
:math:`K_ρ R = W + ρ R`; :math:`ρ\, (I - R^⊤ E)` would lose the digits of D by cancellation. If
K R = 0, E = R and D = 0 are the paper's (eq. 39, eq. 40). R and Y depend only on the current
matrix, not on the modes of earlier ones:

1. rigid modes, and null vectors if there are any (``kernel_detection``), join R;
2. buckling modes join R, and make :math:`K_ρ` positive definite;
3. E and D follow;
4. soft modes join Y and E, but not the factor (``soft_modes``).

The matrix is that of ``scaled``; the hats are omitted here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_feti.errors import FactorError, SingularBlockError
from dolfinx_feti.feti.subdomain.factors.protocol import Factor
from dolfinx_feti.feti.subdomain.kernel_detection import MAX_NULL_FORCE, MAX_RIGID_FORCE
from dolfinx_feti.feti.subdomain.modes import SubdomainModes
from dolfinx_feti.feti.subdomain.null_vectors import positive_diagonal
from dolfinx_feti.feti.subdomain.orthonormal import append_orthonormal, symmetric_part
from dolfinx_feti.feti.subdomain.scaled import ScaledFactor, ScaledMatrix
from dolfinx_feti.feti.subdomain.soft_modes import append_soft_modes, buckling_modes, soft_modes
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.lifetime import Lifetime

#: Rounds of buckling modes of one subdomain for one matrix. Without buckling modes, the dual form
#: of a tube of 12 subdomains at 80 mmHg takes 31797 iterations instead of 1146. One round is enough
#: there. A second one adds modes that Lanczos' method has missed, or raises ρ if it was too small.
MAX_BUCKLING_ROUNDS = 3

#: Smallest ρ, as a multiple of the most negative eigenvalue that it has to lift above zero. With 2,
#: the lifted eigenvalue is as far above zero as it was below; with 1, K_ρ would be singular. A tube
#: at 80 mmHg takes the same number of iterations with 1.1, 2 and 4.
LIFT = 2.0

#: A subdomain counts as softened by stress if D has a negative eigenvalue δ with |δ| above this
#: multiple of the mean stiffness of the interface dofs. A tube of 12 subdomains at 80 mmHg takes
#: 416 iterations in all with this bound, with half of it, and with twice of it. It takes 455 if
#: softened subdomains get no soft modes.
MIN_SOFTENING = 5e-4

#: Largest |δ| of a negative eigenvalue δ of D, over ρ, that counts as rounding of the local solves.
#: In the tests most rounding errors are below 4e-14, and stress gives more than 1e-10. Three
#: eigenvalues, from 1e-13 to 6e-13, count as negative, and may be rounding as well.
DEFECT_RTOL = 1e-13


@dataclass(frozen=True, slots=True)
class SoftModeOptions:
    """Which soft modes join Y.

    Attributes:
        max_count: Largest number of soft modes of a subdomain.
        threshold: Largest stiffness of a soft mode, over that of the interface dofs.
        allow_omission: Whether soft modes may be left out because adaptive columns, which are
            computed later, contain them: in the primal form with formed S_i, unless an option
            switches these columns off.
    """

    max_count: int
    threshold: float
    allow_omission: bool


@dataclass(frozen=True, slots=True)
class RegularisedMatrix:
    """K_ρ = K + ρ R Rᵀ, factored.

    Attributes:
        K: The matrix, (n_i, n_i).
        R: Orthonormal modes, (n_i, k).
        rho: The stiffness ρ.
        factor: Factor of K_ρ.
    """

    K: ScaledMatrix
    R: Array
    rho: float
    factor: ScaledFactor

    def is_singular(self) -> bool:
        """Return True if K_ρ is singular within the tolerances of ``kernel_detection``.

        The test costs a solve with random vectors.
        """
        return self.K.is_singular(self.factor)

    def multiply(self, X: Array) -> Array:
        """Return K_ρ X, (n_i, r)."""
        return self.K.multiply(X) + self.rho * (self.R @ (self.R.T @ X))

    def solve(self, Y: Array) -> Array:
        """Return K_ρ⁻¹ Y, (n_i, r)."""
        return self.factor.solve(Y)

    def destroy(self) -> None:
        """Free the factor."""
        self.factor.destroy()


def find_modes(
    K: ScaledMatrix, rigid: Array, rigid_force: float, options: SoftModeOptions
) -> tuple[Factor, SubdomainModes]:
    """Compute all modes of a subdomain, and factor K_ρ.

    Args:
        K: The matrix, (n_i, n_i).
        rigid: Its orthonormal rigid modes, (n_i, k).
        rigid_force: ‖K_i R ω‖ of the rigid modes on all free dofs, with random weights ω from 1 to
            2, which estimates ‖K_i R‖; not scaled.
        options: Which soft modes join Y.

    Returns:
        The factor of K_ρ, which the caller destroys, and the modes. Both are those of the matrix
        before scaling.

    Raises:
        FactorError: K_ρ has no factor.
        SingularBlockError: K_ρ is singular although all null vectors are in R.
    """
    with Lifetime() as factors:  # destroys them after an error; a factor may be destroyed twice
        without_buckling = factors.own(_regularise_with_null_vectors(K, rigid))
        K_ρ = factors.own(_append_buckling_modes(without_buckling))
        modes = _complete_modes(
            K_ρ,
            rigid_force,
            options,
            n_rigid=rigid.shape[1],
            n_null=without_buckling.R.shape[1] - rigid.shape[1],
        )
        factors.release()  # the caller owns the factor
    return K_ρ.factor.unscaled, modes


def _regularise_with_null_vectors(K: ScaledMatrix, rigid: Array) -> RegularisedMatrix:
    """Factor K_ρ with the rigid modes, and with null vectors if it is singular without them.

    Args:
        K: The matrix, (n_i, n_i).
        rigid: Its orthonormal rigid modes, (n_i, k).

    Returns:
        K_ρ, with the null vectors after the rigid modes in R.

    Raises:
        FactorError: K_ρ has no factor.
        SingularBlockError: K_ρ is singular although all null vectors are in R.
    """
    rho = float(K.diagonal_of_K.mean()) if len(K.diagonal_of_K) else 1.0
    without_null_vectors = _factor_if_regular(K, rigid, rho)
    if without_null_vectors is not None:
        return without_null_vectors
    null = K.null_vectors(rigid)
    R = append_orthonormal(rigid, null)
    K_ρ = RegularisedMatrix(K, R, rho, K.factor(R, rho))
    if null.shape[1] and K_ρ.is_singular():
        K_ρ.destroy()
        raise SingularBlockError(
            "its matrix is singular to rounding even though its null vectors are regularised; "
            "shapes or coefficients of very different scales cause this"
        )
    return K_ρ  # regular, or, if there are no null vectors, only badly conditioned


def _factor_if_regular(K: ScaledMatrix, R: Array, rho: float) -> RegularisedMatrix | None:
    """Factor K_ρ, in single precision if K allows it.

    Args:
        K: The matrix, (n_i, n_i).
        R: Orthonormal modes, (n_i, k).
        rho: The stiffness ρ.

    Returns:
        K_ρ; None if it is singular within the tolerances, or has no factor.
    """
    K_ρ: RegularisedMatrix | None = None
    try:
        K_ρ = RegularisedMatrix(K, R, rho, K.factor_for_preconditioner(R, rho))
        # A factor known to be well conditioned has passed a stricter test of the same growth.
        if K_ρ.factor.is_well_conditioned or not K_ρ.is_singular():
            return K_ρ
    except FactorError:
        # Some solvers stop at a zero pivot of a singular K_ρ, in the factorisation or in a solve.
        # After any other error the caller fails as well, in a product with K or in the next
        # factorisation.
        pass
    if K_ρ is not None:
        K_ρ.destroy()
    return None


def _append_buckling_modes(K_ρ: RegularisedMatrix) -> RegularisedMatrix:
    """Append buckling modes to R, and raise ρ, until K_ρ is positive definite.

    K_ρ may remain indefinite in two cases: if its solver does not report negative eigenvalues, no
    buckling modes are computed; and after :data:`MAX_BUCKLING_ROUNDS` some may be missing. The
    number of negative eigenvalues that the factor reports is then None or positive, and selects a
    Krylov method for indefinite systems (``setup.Inertia``).

    Args:
        K_ρ: The matrix. Destroyed if another one is returned; the caller may destroy it again.

    Returns:
        K_ρ, or one with buckling modes after the columns of R, or with a larger ρ.

    Raises:
        FactorError: The matrix with buckling modes has no factor.
    """
    K = K_ρ.K
    for _ in range(MAX_BUCKLING_ROUNDS):
        negative = K_ρ.factor.inertia.negative
        if not negative:
            break
        buckling = buckling_modes(K_ρ.solve, K_ρ.multiply, len(K_ρ.R), negative)
        R = append_orthonormal(K_ρ.R, buckling)
        lowest = np.linalg.eigvalsh(R.T @ K.multiply(R)).min(initial=np.inf)
        rho = max(K_ρ.rho, -LIFT * float(lowest))
        if R.shape[1] == K_ρ.R.shape[1] and rho == K_ρ.rho:
            break  # nothing has changed
        with_buckling = RegularisedMatrix(K, R, rho, K.factor_for_preconditioner(R, rho))
        if with_buckling.is_singular():  # keep the K_ρ without them: indefinite, but regular
            with_buckling.destroy()
            break
        K_ρ.destroy()
        K_ρ = with_buckling
    return K_ρ


def _complete_modes(
    K_ρ: RegularisedMatrix,
    rigid_force: float,
    options: SoftModeOptions,
    *,
    n_rigid: int,
    n_null: int,
) -> SubdomainModes:
    """Compute E, D, soft modes and stabilisation for the R of a factored K_ρ.

    Args:
        K_ρ: The matrix, with R.
        rigid_force: Estimate of ‖K_i R‖ for the rigid modes; see :func:`find_modes`.
        options: Which soft modes join Y.
        n_rigid: Number of rigid modes, the first columns of R.
        n_null: Number of null vectors, the next columns of R.

    Returns:
        The modes of the matrix before it was scaled.
    """
    K = K_ρ.K
    has_buckling_modes = K_ρ.R.shape[1] > n_rigid + n_null
    is_kernel = (
        not has_buckling_modes
        and rigid_force <= MAX_RIGID_FORCE * K_ρ.rho
        and _is_mapped_to_rounding(K, null=K_ρ.R[:, n_rigid:])
    )
    if is_kernel:
        E = K_ρ.R
        D: Array = np.zeros((E.shape[1], E.shape[1]))
    else:
        E, D = _displacements_and_defect(K_ρ)
    is_softened = _is_softened(K, D)
    Y = _find_soft_modes(K_ρ, options, is_softened=is_softened)
    if Y.shape[1]:
        E, D = append_soft_modes(E, D, Y, K_ρ.solve(Y), K_ρ.rho)
    # R and Y are transformed like forces, E like displacements.
    R = K.unscaled_forces(K_ρ.R)
    Y = np.asfortranarray(K.unscaled_forces(Y))  # columns of Y are read one by one
    return SubdomainModes(
        R=R,
        Y=Y,
        E=K.unscaled_displacements(E),
        D=D,
        stabilisation=np.hstack([R, Y]) @ _negative_directions(D, K_ρ.rho),
        is_exact=is_kernel and Y.shape[1] == 0,
        is_softened=is_softened,
        rho=K_ρ.rho,
        n_rigid=n_rigid,
        n_null=n_null,
    )


def _is_mapped_to_rounding(K: ScaledMatrix, null: Array) -> bool:
    """Return True if the forces of null vectors y, (n_i, r), are rounding errors.

    The forces are those of the equilibrated matrix, ‖K̃ ỹ‖ with ỹ = d^½ y, over ‖ỹ‖.
    """
    if not null.size:
        return True
    root = np.sqrt(positive_diagonal(K.diagonal_of_K))[:, None]
    force = np.linalg.norm(K.multiply(null) / root, axis=0)  # ‖K̃ ỹ‖
    size = np.linalg.norm(root * null, axis=0)  # ‖ỹ‖
    return bool(np.all(force <= MAX_NULL_FORCE * size))


def _displacements_and_defect(K_ρ: RegularisedMatrix) -> tuple[Array, Array]:
    """Return E = R − K_ρ⁻¹ W, (n_i, k), and D = Eᵀ W, (k, k)."""
    W = K_ρ.K.multiply(K_ρ.R)  # W = K R
    E = K_ρ.R - K_ρ.solve(W)  # E = R − K_ρ⁻¹ W
    return E, symmetric_part(E.T @ W)  # D = Eᵀ W


def _is_softened(K: ScaledMatrix, D: Array) -> bool:
    """Return True if stress softens the subdomain with the defect D, (k, k)."""
    is_glued = K.stiffness > 0.0
    if not is_glued.any():
        return False
    lowest = np.linalg.eigvalsh(D).min(initial=0.0)
    return bool(lowest < -MIN_SOFTENING * K.stiffness[is_glued].mean())


def _find_soft_modes(
    K_ρ: RegularisedMatrix, options: SoftModeOptions, *, is_softened: bool
) -> Array:
    """Return orthonormal soft modes that are orthogonal to R, (n_i, k_Y).

    There are none if adaptive columns contain them. They do not if stress softens the subdomain, or
    if a mode is too soft for them, so that random vectors grow much in a solve.

    Args:
        K_ρ: The matrix.
        options: Which soft modes are wanted.
        is_softened: Whether stress softens the subdomain.
    """
    R = K_ρ.R
    if options.allow_omission and not is_softened and K_ρ.factor.is_well_conditioned:
        return np.zeros((len(R), 0))
    modes = soft_modes(K_ρ.solve, K_ρ.K.stiffness, options.max_count, options.threshold)
    return append_orthonormal(R, modes)[:, R.shape[1] :]


def _negative_directions(D: Array, rho: float) -> Array:
    """Return 2 y √−δ for the eigenvalues δ < 0 of D that are not rounding, (k, number of them).

    Along E y, K has the energy δ (1 − δ/ρ) < 0, and Z = 2 (R, Y) y √−δ adds −4 δ (1 − δ/ρ)².
    """
    δ, y = np.linalg.eigh(D)
    is_negative = δ < -DEFECT_RTOL * rho
    return np.asarray(2.0 * y[:, is_negative] * np.sqrt(-δ[is_negative]))
