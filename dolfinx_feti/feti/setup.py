# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""From a torn matrix to a dual system, in the order of the method.

torn matrix → gluing → subdomain matrices → generalised inverse (kernels) → preconditioner → coarse
problem → dual system.

What depends on the pattern only (gluing, symbolic factors) is built once, as a :class:`Pattern`;
what depends on the values is built for each matrix, as frozen :class:`Parts`.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.errors import FactorError, SetUpError, SingularError
from dolfinx_feti.events import event
from dolfinx_feti.feti.coarse.coarse import Coarse
from dolfinx_feti.feti.coarse.stability import negative_eigenvalues
from dolfinx_feti.feti.gluing import Gluing, create_gluing
from dolfinx_feti.feti.inertia import Inertia
from dolfinx_feti.feti.krylov.dual import DualSystem
from dolfinx_feti.feti.krylov.method import Method, choose_method
from dolfinx_feti.feti.options import FETIOptions
from dolfinx_feti.feti.preconditioner.base import Preconditioner
from dolfinx_feti.feti.preconditioner.choice import create_preconditioner
from dolfinx_feti.feti.subdomain.dense import DenseFactors
from dolfinx_feti.feti.subdomain.factors import BlockFactors
from dolfinx_feti.feti.subdomain.matrices import Interior, create_interior
from dolfinx_feti.feti.subdomain.pseudoinverse import PseudoInverse
from dolfinx_feti.torn import Torn

__all__ = ["Parts", "Pattern", "set_up"]

SINGULAR = (
    "The assembled problem is singular, with a kernel of dimension {}: the Dirichlet conditions "
    "leave rigid body motions (or constants) free, in all of the body or in a part that is not "
    "connected to the rest. Add Dirichlet conditions."
)


class Pattern:
    """What depends on the pattern of a torn matrix alone: gluing, symbolic factors.

    Attributes:
        options: The choices made.
        prefix: Options prefix of the sub-solvers, ``…feti_``.
        torn: Blocks and copies.
        symmetric: Whether K is symmetric.
        gluing: B and B_D.
        interior: The matrix of each subdomain, K or S.
        inverse: K⁺, E and D; of the present matrix after :func:`set_up`.
        preconditioner: M; likewise.
    """

    def __init__(self, A: PETSc.Mat, options: FETIOptions, prefix: str) -> None:
        """Build what depends on the pattern.

        Args:
            A: Torn matrix.
            options: Choices.
            prefix: Prefix of the KSP, to which ``feti_`` and the sub-solver's name are added.

        Raises:
            SetUpError: The matrix has entries that are not finite, or options that only serve
                symmetric matrices meet another one.

        Note:
            Collective.
        """
        self.options = options
        self.prefix = prefix + "feti_"
        self.torn = Torn(A)
        require_finite(self.torn)
        self.symmetric = self.torn.is_symmetric()
        _check_symmetry(self.symmetric, options, self.prefix)
        floating = options.all_floating
        with event("FETIGluing"):
            self.gluing = create_gluing(
                self.torn,
                all_floating=floating,
                redundant=options.gluing == "full",
                stiffness=self.torn.stiffness() if options.scaling == "stiffness" else None,
            )
        glued_stiffness = np.zeros(self.torn.n)
        glued_stiffness[self.gluing.glued] = np.abs(self.torn.stiffness()[self.gluing.glued])
        fixed = self.torn.dirichlet & (not floating)
        self.interior = create_interior(
            options.interior,
            self.torn,
            [rows[~fixed[rows]] for rows in self.torn.subdomains],
            self.gluing.glued,
            symmetric=self.symmetric,
            prefix=self.prefix,
        )
        self.inverse = PseudoInverse(
            self.torn,
            self.interior,
            fixed,
            symmetric=self.symmetric,
            buckling=options.indefinite == "enrich",
            soft=options.coarse_modes,
            threshold=options.coarse_threshold,
            weight=glued_stiffness,
        )
        self.preconditioner = create_preconditioner(
            options.pc_type,
            self.torn,
            self.gluing,
            self.interior,
            symmetric=self.symmetric,
            prefix=self.prefix + "dirichlet_",
        )

    def destroy(self) -> None:
        """Free everything, in reverse order."""
        for part in (self.preconditioner, self.interior, self.gluing, self.torn):
            part.destroy()


@dataclass(frozen=True, slots=True)
class Parts:
    """What one torn matrix is turned into, with the parts of its pattern.

    Attributes:
        options: The choices made.
        torn: Blocks and copies.
        symmetric: Whether K is symmetric.
        gluing: B and B_D.
        interior: The matrix of each subdomain, K or S.
        inverse: K⁺, E and D.
        preconditioner: M.
        coarse: G and N.
        inertia: Negative eigenvalues.
        method: The Krylov method.
        dual: The dual system with its constraint preconditioner.
    """

    options: FETIOptions
    torn: Torn
    symmetric: bool
    gluing: Gluing
    interior: Interior
    inverse: PseudoInverse
    preconditioner: Preconditioner
    coarse: Coarse
    inertia: Inertia
    method: Method
    dual: DualSystem

    def destroy(self) -> None:
        """Free what depends on the matrix; the parts of the pattern stay."""
        self.dual.destroy()
        self.coarse.destroy()


def set_up(pattern: Pattern) -> Parts:
    """Build what depends on the values of the present matrix.

    Args:
        pattern: What depends on its pattern.

    Returns:
        All parts; the caller destroys them before the pattern.

    Raises:
        SetUpError: A factorisation failed, a kernel is larger than its candidates, the assembled
            problem is singular, or the options do not fit the matrix.

    Note:
        Collective.
    """
    options, torn, gluing = pattern.options, pattern.torn, pattern.gluing
    require_finite(torn)
    with event("FETIFactor"):
        _factor(pattern)
    with ExitStack() as owned:
        with event("FETICoarse"):
            coarse = Coarse(
                torn,
                gluing,
                pattern.inverse,
                pattern.preconditioner,
                q=options.coarse_q,
                symmetric=pattern.symmetric,
                prefix=pattern.prefix + "coarse_",
            )
            owned.callback(coarse.destroy)
            _check_coarse(coarse)
        inertia = _inertia(pattern, coarse)
        method = choose_method(
            torn.comm,
            definite=pattern.symmetric and inertia.definite,
            prefix=pattern.prefix + "dual_",
            stagnation=options.stagnation,
        )
        _check_method(method, pattern)
        dual = DualSystem(
            gluing,
            pattern.inverse,
            pattern.preconditioner,
            coarse,
            frozen=coarse.exact and method.is_cg,
        )
        owned.pop_all()
    return Parts(
        options=options,
        torn=torn,
        symmetric=pattern.symmetric,
        gluing=gluing,
        interior=pattern.interior,
        inverse=pattern.inverse,
        preconditioner=pattern.preconditioner,
        coarse=coarse,
        inertia=inertia,
        method=method,
        dual=dual,
    )


def _factor(pattern: Pattern) -> None:
    """Factor K_ρ and K_II; a failure on one process is a failure on all."""
    torn, inverse = pattern.torn, pattern.inverse
    cause, zero = "", 0
    try:
        inverse.update()
        pattern.preconditioner.update(inverse.props)
        zero = int(inverse.factors.inertia()[:, 1].clip(min=0).sum())
    except (FactorError, PETSc.Error) as error:
        cause = str(error)
    cause = next((text for text in torn.comm.allgather(cause) if text), "")
    if cause:
        raise SetUpError(
            f"A local factorisation failed ({cause}): look for a process that is out of memory."
        )
    zero = torn.comm.allreduce(zero)
    if zero:
        raise SingularError(
            f"{zero} zero pivots are left in the regularised subdomains: their kernel is "
            "larger than the near kernel of the matrix. Take fewer, larger subdomains (some P2 "
            "cells with a constant pressure move without energy in more than rigid ways), "
            "or attach all rigid body modes with dolfinx_feti.set_near_kernel."
        )
    inside = torn.comm.allreduce(pattern.interior.zero_inside())
    if inside:
        raise SingularError(SINGULAR.format(inside))


def _inertia(pattern: Pattern, coarse: Coarse) -> Inertia:
    """Count negative eigenvalues over all processes.

    Raises:
        SetUpError: There are some although the options forbid them.
    """
    torn, inverse = pattern.torn, pattern.inverse
    local = _total(torn.comm, inverse.negative_local())
    defect = torn.comm.allreduce(inverse.negative_defects())
    factored = pattern.preconditioner.factors or pattern.interior.eliminated
    interior = _total(torn.comm, _count(factored))
    inertia = Inertia(local, defect, interior, None)
    if not inertia.definite and pattern.symmetric and pattern.options.indefinite == "error":
        raise SetUpError(
            f"{inertia.dual or 'An unknown number of'} local eigenvalues are negative and "
            f"-{pattern.prefix}indefinite is error: let it be enrich or gmres."
        )
    if not pattern.symmetric:
        return inertia
    return replace(inertia, assembled=_negative_assembled(pattern, coarse, inertia))


def _negative_assembled(pattern: Pattern, coarse: Coarse, inertia: Inertia) -> int | None:
    """Count the negative eigenvalues of the assembled matrix that can be proved."""
    inside, proved = inertia.interior or 0, 0
    if not inertia.definite:  # otherwise all K_i are positive semi-definite
        found = negative_eigenvalues(
            pattern.torn,
            pattern.gluing,
            pattern.inverse,
            pattern.preconditioner,
            coarse,
            prefix=pattern.prefix + "coarse_",
        )
        if found is None:
            return inside or None
        proved = found
    harmonic = pattern.options.pc_type == "dirichlet" and pattern.interior.eliminated is not None
    if harmonic:
        return inside + proved  # the coarse fields are K-orthogonal to those inside
    return max(inside, proved)


def _count(factors: BlockFactors | DenseFactors | None) -> int | None:
    """Return the negative eigenvalues of factored blocks; None without factors or if not known."""
    if factors is None:
        return None
    counts = factors.inertia()[:, 0]
    return None if np.any(counts < 0) else int(counts.sum())


def _total(comm: MPI.Comm, count: int | None) -> int | None:
    """Add numbers of all processes; None if one of them is not known."""
    counts = comm.allgather(count)
    return None if None in counts else sum(counts)


def _check_coarse(coarse: Coarse) -> None:
    _, zero = coarse.solver.inertia()
    if zero:
        raise SingularError(SINGULAR.format(zero))


def _check_symmetry(symmetric: bool, options: FETIOptions, prefix: str) -> None:
    """Refuse options that only serve symmetric matrices."""
    if not symmetric and options.interior == "eliminate":
        raise SetUpError(
            f"The matrix is not symmetric, but -{prefix}interior is eliminate, which takes it to "
            "be: let it be keep or auto."
        )
    if not symmetric and options.dual_recycle:
        raise SetUpError(
            f"The matrix is not symmetric, but -{prefix}dual_recycle is {options.dual_recycle}, "
            "and only directions of a symmetric one can be recycled: leave it out."
        )


def _check_method(method: Method, pattern: Pattern) -> None:
    """Refuse a Krylov method for symmetric systems if the matrix is not."""
    if not pattern.symmetric and method.is_symmetric:
        raise SetUpError(
            f"The matrix is not symmetric, but -{pattern.prefix}dual_ksp_type is {method.type}, "
            f"which takes it to be: use -{pattern.prefix}dual_ksp_type gmres."
        )


def require_finite(torn: Torn) -> None:
    """Look for NaN and Inf in the matrix.

    Raises:
        SetUpError: There are some.

    Note:
        Collective.
    """
    if torn.comm.allreduce(not np.isfinite(torn.K.norm()), op=MPI.LOR):
        raise SetUpError(
            "The matrix has entries that are NaN or Inf: look at the coefficients of the form and, "
            "in a nonlinear problem, at the last step."
        )
