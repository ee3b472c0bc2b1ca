# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""From a torn matrix to factored subdomains, which both formulations share.

torn matrix → gluing → subdomain matrices → generalised inverse (kernels) → preconditioner.

What depends on the pattern only (gluing, symbolic factors) is built once, as a :class:`Pattern`;
what depends on the values is found anew for each matrix, as frozen :class:`Factored`. From there
``dual_form`` and ``primal_form`` go on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.collective import on_all, reason
from dolfinx_feti.errors import SetUpError
from dolfinx_feti.events import event
from dolfinx_feti.feti.coarse.bodies import find_bodies
from dolfinx_feti.feti.coarse.singularity import require_regular_interior
from dolfinx_feti.feti.gluing import Gluing
from dolfinx_feti.feti.inertia import Inertia
from dolfinx_feti.feti.options import FETIOptions
from dolfinx_feti.feti.preconditioner.choice import create_preconditioner
from dolfinx_feti.feti.subdomain.direct import sum_pivots
from dolfinx_feti.feti.subdomain.enrichment import Enrichment
from dolfinx_feti.feti.subdomain.matrices import create_matrices
from dolfinx_feti.feti.subdomain.modes import Modes
from dolfinx_feti.feti.subdomain.pseudoinverse import PseudoInverse
from dolfinx_feti.torn import Torn

__all__ = ["Factored", "Pattern", "factor"]

T = TypeVar("T")
Array = npt.NDArray[np.float64]


class Pattern:
    """What depends on the pattern of a torn matrix alone: gluing, symbolic factors.

    Attributes:
        options: The choices made.
        prefix: Options prefix of the sub-solvers, ``…feti_``.
        torn: Blocks and copies.
        bodies: Its parts that hang together.
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
        self.bodies = find_bodies(self.torn)
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
class Factored:
    """What the factors of one matrix tell.

    Attributes:
        near_kernel: Rigid body modes on the torn dofs, (n, k).
        modes: R, E and D of each subdomain.
        inertia: Negative eigenvalues of K_ρ, D and K_II; those of the assembled matrix are not yet
            known.
    """

    near_kernel: Array
    modes: Modes
    inertia: Inertia

    def semidefinite(self, pattern: Pattern) -> bool:
        """Tell whether all K_i are known to be symmetric positive semi-definite."""
        inside = self.inertia.interior == 0 or not pattern.matrices.condensed
        return pattern.symmetric and self.inertia.definite and inside


def factor(pattern: Pattern, earlier: Modes | None = None, *, single: bool = False) -> Factored:
    """Take the present matrix into the weights and factors of its pattern.

    Args:
        pattern: What depends on the pattern; its numbers are those of the present matrix then.
        earlier: Modes of an earlier matrix. If they are given, they stay, and so do its weights and
            K_ρ; S and K_II alone become those of the present one.
        single: Whether the factors of K_ρ are stored in single precision, where that does.

    Raises:
        SetUpError: A factorisation failed, a kernel is larger than its candidates, or the options
            forbid negative eigenvalues.

    Note:
        Collective.
    """
    torn = pattern.torn
    require_finite(torn)
    if earlier is None:
        with event("FETIGluing"):
            if pattern.options.scaling == "stiffness":
                pattern.gluing.update(torn.stiffness())
            pattern.preconditioner.weigh()
    with event("FETIFactor"):
        with event("FETISchur"):
            _on_all(lambda: pattern.matrices.update(keep_factors=earlier is not None), torn.comm)
        near_kernel = torn.near_kernel()
        require_regular_interior(torn, pattern.bodies, near_kernel, pattern.matrices)
        with event("FETIModes"):
            modes = earlier or _on_all(
                lambda: pattern.inverse.update(near_kernel, single=single), torn.comm
            )
        _on_all(lambda: pattern.preconditioner.update(modes.props), torn.comm)
    return Factored(near_kernel, modes, _inertia(pattern, modes))


def _on_all(work: Callable[[], T], comm: MPI.Comm) -> T:
    """Do work on the subdomains of each process; an error on one is one on all.

    Raises:
        SetUpError: With the error of the first process that met one.
    """
    try:
        return on_all(work, comm)
    except Exception as error:
        raise SetUpError(
            f"A local factorisation failed ({reason(error)}): look for a process that is out of "
            "memory."
        ) from error


def _inertia(pattern: Pattern, modes: Modes) -> Inertia:
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
    return inertia


def _negative_interior(pattern: Pattern) -> int | None:
    """Count the negative eigenvalues of all K_II of this process; None if not known."""
    known, K_II = pattern.matrices.interior_inertia(), pattern.preconditioner.factors
    if known is None and K_II is not None:
        return sum_pivots(K_II.pivots(i) for i in range(len(K_II.rows))).negative
    return None if known is None else known[0]


def _total(comm: MPI.Comm, count: int | None) -> int | None:
    """Add numbers of all processes; None if one of them is not known."""
    counts = comm.allgather(count)
    return None if None in counts else sum(counts)


def _check_symmetry(symmetric: bool, options: FETIOptions, prefix: str) -> None:
    """Refuse options that only serve symmetric matrices."""
    if not symmetric and options.interior == "eliminate":
        raise SetUpError(
            f"The matrix is not symmetric, but -{prefix}interior is eliminate, which takes it to "
            "be: let it be keep or auto."
        )
    if not symmetric and options.recycle:
        raise SetUpError(
            f"The matrix is not symmetric, but -{prefix}recycle is {options.recycle}, "
            "and only directions of a symmetric one can be recycled: leave it out."
        )


def require_finite(torn: Torn) -> None:
    """Look for NaN and Inf in the matrix.

    Raises:
        SetUpError: There are some.

    Note:
        Collective.
    """
    finite = np.isfinite(torn.K.norm()) and bool(np.isfinite(torn.stiffness()).all())
    if torn.comm.allreduce(not finite, op=MPI.LOR):
        raise SetUpError(
            "The matrix has entries that are NaN or Inf: look at the coefficients of the form and, "
            "in a nonlinear problem, at the last step."
        )
