# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""What belongs to one matrix: weights, S, :math:`K_{II}^{-1}`, :math:`K_ρ^{-1}` and modes.

Both methods begin here. A later matrix has one of its own, or shares half of it (``primal``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from mpi4py import MPI

import numpy as np

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.feti.gluing.jump import weights_of_copies
from dolfinx_feti.feti.pattern import Pattern
from dolfinx_feti.feti.regularity.singularity import require_regular_interior
from dolfinx_feti.feti.subdomain.blocks import on_subdomains
from dolfinx_feti.feti.subdomain.factors.protocol import sum_known
from dolfinx_feti.feti.subdomain.nullspace import interior_kernel
from dolfinx_feti.feti.subdomain.operator import Operator, create_operator
from dolfinx_feti.feti.subdomain.pseudoinverse import PseudoInverse, create_pseudo_inverse
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.matrix import Torn


@dataclass(frozen=True, slots=True)
class Inertia:
    """Negative eigenvalues over all processes; None where a factor does not tell.

    Attributes:
        local: Those of all regularised subdomains K_ρ.
        defect: Those of the defects D of all kernels.
        interior: Those of all interior blocks K_II; None where none is factored, too.
        assembled: Those that the assembled matrix is proved to have (``coarse.space``).
    """

    local: int | None
    defect: int
    interior: int | None
    assembled: int | None

    @property
    def dual(self) -> int | None:
        """Those of all K_ρ and D together; without any, CG is safe on the dual system."""
        return None if self.local is None else self.local + self.defect

    @property
    def definite(self) -> bool:
        """Whether the dual system is known to be positive definite on balanced pairs."""
        return self.dual == 0


@dataclass(frozen=True, slots=True)
class Setup:
    """The parts of one matrix.

    Attributes:
        operator: S, and K_II⁻¹.
        delta: Weight δ of every torn dof, (n,).
        inverse: K_ρ⁻¹, and R, E, D of each subdomain.
        inertia: Negative eigenvalues of K_ρ, D and K_II; those of the assembled matrix are not yet
            known.
    """

    operator: Operator
    delta: Array
    inverse: PseudoInverse
    inertia: Inertia


def set_up(
    pattern: Pattern, matrix: Lifetime, preconditioner: Lifetime, *, rough: bool = False
) -> Setup:
    """Take the present matrix into the parts that both methods share. Collective.

    ``matrix`` owns S, and ``preconditioner`` the inverse, which is in single precision where that
    will do if it is ``rough``.

    Raises:
        SetUpError: A factorisation failed, or the matrix is singular inside of a subdomain.
    """
    torn, options = pattern.torn, pattern.options
    operator = set_up_operator(pattern, matrix)
    with event("FETIGluing"):
        k = torn.stiffness() if options.scaling == "stiffness" else np.ones(torn.n)
        delta = weights_of_copies(torn, k)
    inverse, inertia = _invert(pattern, operator, preconditioner, rough=rough)
    return Setup(operator, delta, inverse, inertia)


def refined(pattern: Pattern, setup: Setup, within: Lifetime) -> Setup:
    """Return the parts with an inverse in double precision, which ``within`` owns. Collective."""
    if not pattern.torn.comm.allreduce(setup.inverse.rough, op=MPI.LOR):
        return setup
    setup.inverse.destroy()
    inverse, inertia = _invert(pattern, setup.operator, within, rough=False)
    return replace(setup, inverse=inverse, inertia=inertia)


def _invert(
    pattern: Pattern, operator: Operator, within: Lifetime, *, rough: bool
) -> tuple[PseudoInverse, Inertia]:
    """Factor all K_ρ, and find the modes; count negative eigenvalues. Collective."""
    torn, options = pattern.torn, pattern.options
    near_kernel = torn.near_kernel()
    with event("FETIFactor"), event("FETIModes"):
        inverse = on_subdomains(
            lambda: create_pseudo_inverse(
                operator,
                pattern.dofs,
                near_kernel,
                soft=options.coarse_modes,
                threshold=options.coarse_threshold,
                rough=rough,
                adaptive=options.coarse_adaptive > 0,
            ),
            torn.comm,
        )
    return within.own(inverse), Inertia(
        local=sum_if_known(inverse.negative, torn.comm),
        defect=torn.comm.allreduce(sum(m.stabilisation.shape[1] for m in inverse.modes)),
        interior=sum_if_known(operator.negative_interior, torn.comm),
        assembled=None,
    )


def set_up_operator(pattern: Pattern, within: Lifetime) -> Operator:
    """Return S of the present matrix, which ``within`` owns. Collective.

    Raises:
        SetUpError: A factorisation failed, or the matrix is singular inside of a subdomain.
    """
    torn, dofs, analysis = pattern.torn, pattern.dofs, pattern.analysis
    require_finite(torn)
    with event("FETIFactor"), event("FETISchur"):
        operator = within.own(
            on_subdomains(lambda: create_operator(torn, dofs, analysis), torn.comm)
        )
    if analysis.eliminated and analysis.interior is not None:
        choice = analysis.interior
        inside = on_subdomains(
            lambda: interior_kernel(torn, dofs, choice, operator.interior_factors), torn.comm
        )
        require_regular_interior(torn, pattern.bodies, inside)
    return operator


def require_finite(torn: Torn) -> None:
    """Refuse NaN and Inf in the matrix. Collective."""
    finite = np.isfinite(torn.K.norm()) and bool(np.isfinite(torn.stiffness()).all())
    if torn.comm.allreduce(not finite, op=MPI.LOR):
        raise SetUpError(
            "The matrix has entries that are NaN or Inf: look at the coefficients of the form and, "
            "in a nonlinear problem, at the last step."
        )


def sum_if_known(count: Callable[[], int | None], comm: MPI.Comm) -> int | None:
    """Add numbers that all processes count; None if one of them is not known. Collective."""
    return sum_known(comm.allgather(on_subdomains(count, comm)))
