# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""From a torn matrix to a dual system, in the order of the method.

torn matrix → gluing → matrices of the subdomains → generalised inverse (modes) → preconditioner →
coarse problem → dual system.

What depends on the pattern only (jumps, symbolic factors) is built once; what depends on the values
is made from the present matrix alone whenever it changes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.collective import on_all
from dolfinx_feti.errors import SetUpError
from dolfinx_feti.events import event
from dolfinx_feti.feti.coarse.bodies import find_bodies
from dolfinx_feti.feti.coarse.coarse import Coarse
from dolfinx_feti.feti.coarse.singularity import require_regular, require_regular_interior
from dolfinx_feti.feti.coarse.stability import negative_eigenvalues
from dolfinx_feti.feti.gluing import Gluing
from dolfinx_feti.feti.krylov.dual import ConstraintPreconditioner, DualOperator, DualVector
from dolfinx_feti.feti.krylov.method import Krylov
from dolfinx_feti.feti.krylov.recycling import Recycling
from dolfinx_feti.feti.options import FETIOptions
from dolfinx_feti.feti.preconditioner.preconditioner import create_preconditioner
from dolfinx_feti.feti.subdomain.direct import sum_pivots
from dolfinx_feti.feti.subdomain.enrichment import Enrichment
from dolfinx_feti.feti.subdomain.matrices import create_matrices
from dolfinx_feti.feti.subdomain.pseudoinverse import Modes, PseudoInverse
from dolfinx_feti.torn import Torn

__all__ = ["Parts"]

T = TypeVar("T")
Array = npt.NDArray[np.float64]

#: Krylov methods for symmetric systems.
SYMMETRIC_METHODS = ("cg", "fcg", "pipecg", "minres", "symmlq")


class _Destroyable(Protocol):
    def destroy(self) -> None: ...


class Parts:
    """All that one torn matrix is turned into.

    Attributes:
        torn: Blocks and copies.
        symmetric: Whether K is symmetric.
        gluing: B and B_D.
        matrices: The matrices of the subdomains, K or S.
        inverse: K⁺.
        modes: R, E and D; after :meth:`update`.
        preconditioner: M.
        recycling: What solves leave to later ones.
        negative: Negative eigenvalues of K_ρ and D over all subdomains; CG is safe without any.
        negative_interior: Negative eigenvalues of all K_II that have been factored; below zero if
            they are not known.
        negative_assembled: Negative eigenvalues that the assembled matrix has at least (see
            ``stability``); −1 if not known.
        coarse: G and N; after :meth:`update`.
        operator: The dual system; after :meth:`update`.
        constraint: Its constraint preconditioner; after :meth:`update`.
        krylov: Its Krylov method; after :meth:`update`.
    """

    negative: int
    negative_interior: int
    negative_assembled: int
    modes: Modes
    coarse: Coarse
    operator: DualOperator
    constraint: ConstraintPreconditioner
    krylov: Krylov

    def __init__(self, A: PETSc.Mat, options: FETIOptions, prefix: str) -> None:
        """Build what depends on the pattern.

        Args:
            A: Torn matrix.
            options: Choices.
            prefix: Prefix of the KSP, to which ``feti_`` and the sub-solver's name are added.

        Note:
            Collective.
        """
        self.options = options
        self.prefix = prefix + "feti_"
        self.torn = Torn(A)
        require_finite(self.torn)
        self._bodies = find_bodies(self.torn)
        self.symmetric = self.torn.is_symmetric()
        floating = options.all_floating
        with event("FETIGluing"):
            self.gluing = Gluing(
                self.torn, all_floating=floating, redundant=options.gluing == "full"
            )
        fixed = self.torn.dirichlet & (not floating)
        if options.interior == "eliminate" and not self.symmetric:
            raise SetUpError(
                f"The matrix is not symmetric, but -{self.prefix}interior is eliminate, which "
                "takes it to be: let it be keep or auto."
            )
        if options.dual_recycle and not self.symmetric:
            raise SetUpError(
                f"The matrix is not symmetric, but -{self.prefix}dual_recycle is "
                f"{options.dual_recycle}, and directions are only recycled of a symmetric one: "
                "leave it out."
            )
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
        self.recycling = Recycling(options.dual_recycle)
        self._dual: list[
            Coarse | DualVector | DualOperator | ConstraintPreconditioner | Krylov
        ] = []

    def update(self) -> None:
        """Refresh what depends on the values.

        Raises:
            SetUpError: A factorisation failed, a kernel is larger than its candidates, or the
                assembled problem is singular.

        Note:
            Collective.
        """
        require_finite(self.torn)
        with event("FETIGluing"):
            if self.options.scaling == "stiffness":
                self.gluing.update(self.torn.stiffness())
            self.preconditioner.weigh()
        near_kernel = self.torn.near_kernel()
        with event("FETIFactor"):
            self._factor(near_kernel)
        with event("FETICoarse"):
            self._destroy_dual()
            self.coarse = Coarse(
                self.torn,
                self.gluing,
                self.modes,
                self.preconditioner,
                q=self.options.coarse_q,
                symmetric=self.symmetric,
                prefix=self.prefix + "coarse_",
            )
            self._dual.append(self.coarse)
        local = self.inverse.negative()
        local = 1 if local is None else local  # not known counts as negative
        self.negative = self.torn.comm.allreduce(local + self.modes.negative_defects)
        with event("FETICoarse"):
            require_regular(
                self.torn,
                self._bodies,
                near_kernel,
                self.gluing,
                self.matrices,
                self.coarse,
                symmetric=self.symmetric,
                definite=self.symmetric and self.negative == 0 and self._interior_is_definite(),
                prefix=self.prefix + "coarse_",
            )
        self.negative_interior = self._negative_interior()
        if self.negative and self.symmetric and self.options.indefinite == "error":
            raise SetUpError(
                f"{self.negative} local eigenvalues are negative and -{self.prefix}indefinite is "
                "error: let it be enrich or gmres."
            )
        self.negative_assembled = self._negative_assembled()
        vector = DualVector(self.gluing, self.coarse)
        self.constraint = ConstraintPreconditioner(
            self.preconditioner,
            self.coarse,
            vector,
            q_has_m=self.options.coarse_q == "preconditioner",
        )
        self.operator = DualOperator(self.gluing, self.inverse, self.coarse, vector)
        self.recycling.attach(self.operator, self.constraint)
        self.krylov = Krylov(
            self.recycling,
            self.constraint,
            vector,
            definite=self.symmetric and self.negative == 0,
            prefix=self.prefix + "dual_",
            stagnation=self.options.stagnation,
            reorthogonalize=self.options.dual_reorthogonalize,
        )
        self._dual += [vector, self.constraint, self.operator, self.krylov]
        self._check_method()

    def _factor(self, near_kernel: Array) -> None:
        """Factor K_ρ and K_II; a failure on one process is a failure on all."""
        self._on_all(self.matrices.update)
        require_regular_interior(self.torn, self._bodies, near_kernel, self.matrices)
        self.modes = self._on_all(lambda: self.inverse.update(near_kernel))
        self._on_all(lambda: self.preconditioner.update(self.modes.props))

    def _on_all(self, work: Callable[[], T]) -> T:
        """Do work on the subdomains of each process; an error on one is one on all.

        Raises:
            SetUpError: With the error of the first process that met one.
        """
        try:
            return on_all(work, self.torn.comm)
        except RuntimeError as error:
            raise SetUpError(
                f"A local factorisation failed ({error}): look for a process that is out of memory."
            ) from error

    def _interior_is_definite(self) -> bool:
        """Tell whether what the matrices of the subdomains leave out has no negative eigenvalue."""
        inertia = self.matrices.interior_inertia()
        bad = self.matrices.condensed and (inertia is None or inertia[0] > 0)
        return not self.torn.comm.allreduce(bad, op=MPI.LOR)

    def _negative_interior(self) -> int:
        """Count the negative eigenvalues of all K_II; −1 if they are not known."""
        known, K_II = self.matrices.interior_inertia(), self.preconditioner.factors
        negative = None if known is None else known[0]
        if known is None and K_II is not None:
            negative = sum_pivots(K_II.pivots(i) for i in range(len(K_II.rows))).negative
        counts = self.torn.comm.allgather(negative)
        return -1 if None in counts else sum(counts)

    def _negative_assembled(self) -> int:
        """Count the negative eigenvalues of the assembled matrix that can be proved."""
        if not self.symmetric:
            return -1
        inside, coarse = max(self.negative_interior, 0), 0
        if self.negative:  # otherwise all K_i are positive semi-definite
            counted = negative_eigenvalues(
                self.torn,
                self.gluing,
                self.modes,
                self.preconditioner,
                self.coarse,
                prefix=self.prefix + "coarse_",
            )
            coarse = -1 if counted is None else counted
        harmonic = self.options.pc_type == "dirichlet" and self.matrices.condensed
        if coarse > 0 and harmonic:
            return inside + coarse  # the coarse fields are K-orthogonal to those inside
        return max(inside, coarse) if inside else coarse

    def _check_method(self) -> None:
        method = self.krylov.ksp.getType()
        if not self.symmetric and method in SYMMETRIC_METHODS:
            raise SetUpError(
                f"The matrix is not symmetric, but -{self.prefix}dual_ksp_type is {method}, which "
                f"takes it to be: use -{self.prefix}dual_ksp_type gmres."
            )

    def _destroy_dual(self) -> None:
        for part in reversed(self._dual):
            part.destroy()
        self._dual = []

    def destroy(self) -> None:
        """Free everything, in reverse order."""
        self._destroy_dual()
        for part in (self.preconditioner, self.matrices, self.gluing, self.torn):
            part.destroy()


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
