# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The primal form: the assembled interface problem set up for a matrix, and solved for a load.

.. math:: A\, x = T^⊤ \hat f_Γ, \qquad A = T^⊤ S\, T, \qquad
          \hat f_Γ = f_Γ - K_{ΓI} K_{II}^{-1} f_I, \qquad f = δ\, T r - K u_D,

by conjugate gradients with the preconditioner of ``primal``; then :math:`u_Γ = T x` and
:math:`u_I = K_{II}^{-1} (f_I - K_{IΓ} u_Γ)`. The coarse space holds the averaged motions E of the
subdomains and columns that bound what averages cost (``adaptive``).

It is the form for matrices whose dual system is indefinite although they are not: those of a body
under load, in which subdomains would buckle alone.

:math:`K_ρ^{-1}`, the columns of V and the weights δ make a preconditioner of A whatever matrix they
belong to. So they may last: :func:`create_lagged_form` takes those of an earlier matrix, and S,
A V and A₀ of the present one. In the same way Ritz vectors of solves with earlier matrices join V
(``deflation``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.events import event
from dolfinx_feti.feti.coarse.adaptive import adaptive_columns
from dolfinx_feti.feti.coarse.averaged import AveragedColumns, AveragedSpace
from dolfinx_feti.feti.coarse.singularity import require_held
from dolfinx_feti.feti.copies import Copies
from dolfinx_feti.feti.gluing import Gluing
from dolfinx_feti.feti.inertia import Inertia
from dolfinx_feti.feti.krylov.deflation import DeflatedSpace, RitzVectors
from dolfinx_feti.feti.krylov.method import Method, Solution
from dolfinx_feti.feti.krylov.primal import PrimalSystem, conjugate_gradients
from dolfinx_feti.feti.krylov.recycling import Directions
from dolfinx_feti.feti.krylov.stopping import Monitor
from dolfinx_feti.feti.options import FETIOptions
from dolfinx_feti.feti.preconditioner.dirichlet import Dirichlet
from dolfinx_feti.feti.setup import Factored, Pattern
from dolfinx_feti.feti.subdomain.matrices import SubdomainMatrices
from dolfinx_feti.feti.subdomain.modes import Modes
from dolfinx_feti.feti.subdomain.pseudoinverse import PseudoInverse
from dolfinx_feti.torn import Torn

__all__ = ["PrimalForm", "create_lagged_form", "create_primal_form", "solve_on_interface"]

Array = npt.NDArray[np.float64]
Reason = PETSc.KSP.ConvergedReason

#: Iterations that are kept for each of the Ritz vectors that may come of them.
TRACED = 4


@dataclass(frozen=True, slots=True)
class PrimalForm:
    """The primal form of one matrix, with the parts of its pattern.

    Attributes:
        options: The choices made.
        torn: Blocks and copies.
        gluing: Weights δ.
        matrices: The matrix of each subdomain, K or S.
        inverse: K⁺.
        near_kernel: Rigid body modes on the torn dofs, (n, k).
        modes: E of each subdomain.
        preconditioner: Applies S.
        copies: Copies of the interface dofs.
        space: The averaged coarse space V.
        inertia: Negative eigenvalues.
        system: A and its preconditioner.
        deflation: V, and Ritz vectors of earlier solves beside it.
        most: Ritz vectors that a solve leaves to those of later matrices, at most.
        singles: Subdomains whose factors of K_ρ are stored in single precision.
        age: Matrices since the one that K_ρ, E and δ belong to.
    """

    options: FETIOptions
    torn: Torn
    gluing: Gluing
    matrices: SubdomainMatrices
    inverse: PseudoInverse
    near_kernel: Array
    modes: Modes
    preconditioner: Dirichlet
    copies: Copies
    space: AveragedSpace
    inertia: Inertia
    system: PrimalSystem
    deflation: DeflatedSpace
    most: int
    singles: int = 0
    age: int = 0

    def solve(
        self, r: PETSc.Vec, u_D: Array, *, target: float, max_it: int, monitor: Monitor
    ) -> tuple[Array, Solution]:
        """Solve for an assembled right-hand side.

        Args:
            r: Assembled right-hand side, (N,).
            u_D: Prescribed values on the torn Dirichlet dofs, (n,).
            target: Wanted norm of the residual of the assembled system.
            max_it: Most iterations.
            monitor: Called with (iteration, norm of the residual of the assembled system).

        Returns:
            u with single-valued copies, (n,), and how conjugate gradients ended; its ``x`` are
            copies of the interface dofs.

        Note:
            Collective.
        """
        torn, Γ = self.torn, self.copies.dofs
        f = self.gluing.delta * torn.tear(r) - torn.multiply(u_D)
        f[torn.dirichlet] = 0.0  # f = δ T r − K u_D
        with event("FETIIterations"):
            found = conjugate_gradients(
                self.system,
                self.preconditioner.condense(f)[Γ],
                target=target,
                max_it=max_it,
                stagnation=self.options.stagnation,
                monitor=monitor,
                traced=TRACED * self.most,
            )
        with event("FETIRecycling"):
            left = self.deflation.ritz_vectors(found.trace, most=self.most)
        u = np.zeros(torn.n)
        u[Γ] = found.x
        ends = found.eigenvalues[[0, -1]] if len(found.eigenvalues) else (np.nan, np.nan)
        reason = found.reason
        if reason == Reason.DIVERGED_INDEFINITE_PC and self.inertia.local == 0:
            reason = Reason.CONVERGED_ITS  # rounding: a fresh start on what is left
        spectrum = (float(ends[0]), float(ends[1]))
        solution = Solution(found.x, reason, found.iterations, spectrum, left)
        return self.preconditioner.complete(u, f) + u_D, solution

    @property
    def method(self) -> Method:
        """Conjugate gradients."""
        return Method("cg", "", self.options.stagnation, users_test=False)

    @property
    def users_test(self) -> bool:
        """Whether the user's own tolerance of the Krylov method decides."""
        return False

    def deflated(self, _directions: Directions | None) -> PrimalForm:
        """Return the form itself: it has been set up with its Ritz vectors."""
        return self

    @property
    def recycled(self) -> int:
        """Number of Ritz vectors of earlier solves."""
        return self.deflation.count

    def directions(self) -> Directions | None:
        """Return None: a solve tells itself what it leaves to later ones."""
        return None

    def destroy(self) -> None:
        """Free what depends on the matrix; the parts of the pattern stay."""
        self.space.destroy()
        self.space.V.destroy()
        self.copies.destroy()


def create_primal_form(
    pattern: Pattern, factored: Factored, vectors: RitzVectors | None = None, *, most: int = 0
) -> PrimalForm:
    """Build the coarse space of the present matrix.

    Args:
        pattern: What depends on the pattern, with the factors of the present matrix.
        factored: What these tell.
        vectors: What solves with earlier matrices have left.
        most: Ritz vectors that a solve leaves to those of later matrices, at most.

    Returns:
        The form; the caller destroys it before the pattern.

    Raises:
        SetUpError: The matrix is not symmetric, S is not there, or a body is not held.

    Note:
        Collective.
    """
    S, options = pattern.preconditioner, pattern.options
    if not pattern.symmetric or not isinstance(S, Dirichlet):
        raise SetUpError(
            f"-{pattern.prefix}formulation is primal, which takes a symmetric matrix and "
            f"-{pattern.prefix}pc_type dirichlet: let it be dual or auto."
        )
    torn, modes, inverse = pattern.torn, factored.modes, pattern.inverse
    with event("FETICoarse"):
        require_held(torn, pattern.bodies, factored.near_kernel, definite=False)
        copies = Copies(torn, S.interface, pattern.gluing.delta)

        adaptive = adaptive_columns(
            copies,
            S.multiply_many,
            partial(solve_on_interface, S, inverse),
            most=options.coarse_adaptive,
            threshold=options.coarse_bound,
        )
        pairs = zip(modes.E, S.on_interface, adaptive, strict=True)
        U = [np.hstack([E[on], more]) for E, on, more in pairs]
        space = AveragedSpace(AveragedColumns(copies, U), S, prefix=pattern.prefix + "coarse_")
    deflation = DeflatedSpace(space, copies, S.multiply_many, vectors)
    return PrimalForm(
        options=options,
        torn=torn,
        gluing=pattern.gluing,
        matrices=pattern.matrices,
        inverse=inverse,
        near_kernel=factored.near_kernel,
        modes=modes,
        preconditioner=S,
        copies=copies,
        space=space,
        inertia=_with_proof(factored.inertia, space),
        system=_system(copies, deflation, S, inverse),
        deflation=deflation,
        most=most,
        singles=torn.comm.allreduce(pattern.matrices.singles()),
    )


def solve_on_interface(S: Dirichlet, inverse: PseudoInverse, i: int, F: Array) -> Array:
    """Return S_ρ⁻¹ F for forces on the interface of subdomain i, (n_Γ, k): K_ρ⁻¹ F, there."""
    on = S.on_interface[i]
    Y = np.zeros((len(on), F.shape[1]))
    Y[on] = F
    return inverse.solve_many(i, Y)[on]


def create_lagged_form(
    pattern: Pattern,
    factored: Factored,
    earlier: PrimalForm,
    vectors: RitzVectors | None = None,
) -> PrimalForm:
    """Build the form of the present matrix with :math:`K_ρ^{-1}`, V and δ of an earlier one.

    Args:
        pattern: What depends on the pattern, with S and K_II of the present matrix.
        factored: What these tell, with the modes of the earlier matrix.
        earlier: The form of the matrix before, which is used up: what lasts passes into the new
            one, and the rest is freed.
        vectors: What solves with earlier matrices have left.

    Raises:
        SetUpError: A body is not held.

    Note:
        Collective.
    """
    S, copies, prefix = earlier.preconditioner, earlier.copies, pattern.prefix + "coarse_"
    V, combinations = earlier.space.V, earlier.space.combinations
    earlier.space.destroy()
    with event("FETICoarse"):
        try:
            require_held(pattern.torn, pattern.bodies, factored.near_kernel, definite=False)
            space = AveragedSpace(V, S, prefix=prefix, combinations=combinations)
        except SetUpError:
            V.destroy()
            copies.destroy()
            raise
    deflation = DeflatedSpace(space, copies, S.multiply_many, vectors)
    return replace(
        earlier,
        near_kernel=factored.near_kernel,
        space=space,
        inertia=_with_proof(factored.inertia, space),
        system=_system(copies, deflation, S, pattern.inverse),
        deflation=deflation,
        age=earlier.age + 1,
    )


def _system(
    copies: Copies, space: DeflatedSpace, S: Dirichlet, inverse: PseudoInverse
) -> PrimalSystem:
    """Let S and K_ρ⁻¹ of all subdomains act on copies of the interface dofs.

    Soft modes are among the columns of V, so that the projection makes up for any share of them.
    """

    def to_torn(t: Array) -> Array:
        u = np.zeros(S.torn.n)
        u[copies.dofs] = t
        return u

    return PrimalSystem(
        copies,
        space,
        multiply=lambda t: S.multiply(to_torn(t))[copies.dofs],
        solve=lambda t: inverse.solve(to_torn(t), up_to_soft_modes=True)[copies.dofs],
    )


def _with_proof(inertia: Inertia, space: AveragedSpace) -> Inertia:
    """Add what A₀ and K_II prove of the assembled matrix."""
    negative, inside = space.negative(), inertia.interior
    proved = None if negative is None or inside is None else negative + inside
    return replace(inertia, assembled=proved)
