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

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import TypeVar

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.collective import on_all
from dolfinx_feti.errors import SetUpError, SingularError
from dolfinx_feti.events import event
from dolfinx_feti.feti.coarse.coarse import Coarse
from dolfinx_feti.feti.coarse.stability import negative_eigenvalues
from dolfinx_feti.feti.gluing import Gluing
from dolfinx_feti.feti.inertia import Inertia
from dolfinx_feti.feti.krylov.dual import DualSystem
from dolfinx_feti.feti.krylov.method import Method, choose_method
from dolfinx_feti.feti.options import FETIOptions
from dolfinx_feti.feti.preconditioner.base import Preconditioner
from dolfinx_feti.feti.preconditioner.choice import create_preconditioner
from dolfinx_feti.feti.subdomain.direct import sum_pivots
from dolfinx_feti.feti.subdomain.enrichment import Enrichment
from dolfinx_feti.feti.subdomain.matrices import SubdomainMatrices, create_matrices
from dolfinx_feti.feti.subdomain.pseudoinverse import Modes, PseudoInverse
from dolfinx_feti.torn import Torn

__all__ = ["Parts", "Pattern", "set_up"]

T = TypeVar("T")

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
        gluing: B, and B_D with the weights of the last matrix.
        matrices: The matrix of each subdomain, K or S, of the last matrix.
        inverse: K⁺ of the last matrix.
        preconditioner: M of the last matrix.
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
            self.gluing = Gluing(
                self.torn, all_floating=floating, redundant=options.gluing == "full"
            )
        fixed = self.torn.dirichlet & (not floating)
        self.matrices = create_matrices(
            options.interior,
            self.torn,
            [rows[~fixed[rows]] for rows in self.torn.subdomains],
            self.gluing.glued,
            symmetric=self.symmetric,
            prefix=self.prefix,
        )
        self.inverse = PseudoInverse(
            self.torn,
            self.matrices,
            fixed,
            self.gluing.glued,
            symmetric=self.symmetric,
            enrichment=Enrichment(
                buckling=options.indefinite == "enrich" and self.symmetric,
                soft=options.coarse_modes,
                threshold=options.coarse_threshold,
            ),
        )
        self.preconditioner = create_preconditioner(
            options.pc_type,
            self.torn,
            self.gluing,
            self.matrices,
            symmetric=self.symmetric,
            prefix=self.prefix + "dirichlet_",
        )

    def destroy(self) -> None:
        """Free everything, in reverse order."""
        for part in (self.preconditioner, self.matrices, self.gluing, self.torn):
            part.destroy()


@dataclass(frozen=True, slots=True)
class Parts:
    """What one torn matrix is turned into, with the parts of its pattern.

    Attributes:
        options: The choices made.
        torn: Blocks and copies.
        symmetric: Whether K is symmetric.
        gluing: B and B_D.
        matrices: The matrix of each subdomain, K or S.
        inverse: K⁺.
        modes: R, E and D of each subdomain.
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
    matrices: SubdomainMatrices
    inverse: PseudoInverse
    modes: Modes
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
    with event("FETIGluing"):
        if options.scaling == "stiffness":
            gluing.update(torn.stiffness())
        pattern.preconditioner.weigh()
    with event("FETIFactor"):
        modes = _factor(pattern)
    with ExitStack() as owned:
        with event("FETICoarse"):
            coarse = Coarse(
                torn,
                gluing,
                modes,
                pattern.preconditioner,
                q=options.coarse_q,
                symmetric=pattern.symmetric,
                prefix=pattern.prefix + "coarse_",
            )
            owned.callback(coarse.destroy)
            _check_coarse(coarse)
        inertia = _inertia(pattern, modes, coarse)
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
        matrices=pattern.matrices,
        inverse=pattern.inverse,
        modes=modes,
        preconditioner=pattern.preconditioner,
        coarse=coarse,
        inertia=inertia,
        method=method,
        dual=dual,
    )


def _factor(pattern: Pattern) -> Modes:
    """Factor K_ρ and K_II, and return the modes of all subdomains."""
    torn = pattern.torn
    _on_all(pattern.matrices.update, torn.comm)
    inside = torn.comm.allreduce(pattern.matrices.interior_kernel().shape[1])
    if inside:
        raise SingularError(SINGULAR.format(inside))
    near_kernel = torn.near_kernel()
    modes = _on_all(lambda: pattern.inverse.update(near_kernel), torn.comm)
    _on_all(lambda: pattern.preconditioner.update(modes.props), torn.comm)
    return modes


def _on_all(work: Callable[[], T], comm: MPI.Comm) -> T:
    """Do work on the subdomains of each process; an error on one is one on all.

    Raises:
        SetUpError: With the error of the first process that met one.
    """
    try:
        return on_all(work, comm)
    except RuntimeError as error:
        raise SetUpError(
            f"A local factorisation failed ({error}): look for a process that is out of memory."
        ) from error


def _inertia(pattern: Pattern, modes: Modes, coarse: Coarse) -> Inertia:
    """Count negative eigenvalues over all processes.

    Raises:
        SetUpError: There are some although the options forbid them.
    """
    comm = pattern.torn.comm
    local = _total(comm, pattern.inverse.negative())
    defect = comm.allreduce(modes.negative_defects)
    inertia = Inertia(local, defect, _total(comm, _negative_interior(pattern)), None)
    if not inertia.definite and pattern.symmetric and pattern.options.indefinite == "error":
        raise SetUpError(
            f"{inertia.dual or 'An unknown number of'} local eigenvalues are negative and "
            f"-{pattern.prefix}indefinite is error: let it be enrich or gmres."
        )
    if not pattern.symmetric:
        return inertia
    return replace(inertia, assembled=_negative_assembled(pattern, modes, coarse, inertia))


def _negative_interior(pattern: Pattern) -> int | None:
    """Count the negative eigenvalues of all K_II of this process; None if not known."""
    known, K_II = pattern.matrices.interior_inertia(), pattern.preconditioner.factors
    if known is None and K_II is not None:
        return sum_pivots(K_II.pivots(i) for i in range(len(K_II.rows))).negative
    return None if known is None else known[0]


def _negative_assembled(
    pattern: Pattern, modes: Modes, coarse: Coarse, inertia: Inertia
) -> int | None:
    """Count the negative eigenvalues of the assembled matrix that can be proved."""
    inside, proved = inertia.interior or 0, 0
    if not inertia.definite:  # otherwise all K_i are positive semi-definite
        found = negative_eigenvalues(
            pattern.torn,
            pattern.gluing,
            modes,
            pattern.preconditioner,
            coarse,
            prefix=pattern.prefix + "coarse_",
        )
        if found is None:
            return inside or None
        proved = found
    if pattern.options.pc_type == "dirichlet" and pattern.matrices.condensed:
        return inside + proved  # the coarse fields are K-orthogonal to those inside
    return max(inside, proved)


def _total(comm: MPI.Comm, count: int | None) -> int | None:
    """Add numbers of all processes; None if one of them is not known."""
    counts = comm.allgather(count)
    return None if None in counts else sum(counts)


def _check_coarse(coarse: Coarse) -> None:
    zero = coarse.solver.pivots().zero
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
