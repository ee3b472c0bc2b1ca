# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What depends on the pattern of a torn matrix alone: subdomains, gluing, orders of elimination.

The symmetry of the values counts as part of the pattern: symbolic factors depend on it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.feti.interface.gluing import Gluing
from dolfinx_feti.feti.options import PRIMAL_PC_TYPE, FETIOptions, excludes_primal
from dolfinx_feti.feti.preconditioners.registry import PRECONDITIONERS
from dolfinx_feti.feti.regularity.bodies import Bodies, find_bodies
from dolfinx_feti.feti.subdomain.analysis import Analysis, analyse
from dolfinx_feti.feti.subdomain.subdomain import Subdomain, create_subdomains
from dolfinx_feti.feti.subsolver_options import SubsolverOptions
from dolfinx_feti.runtime.arrays import Mask
from dolfinx_feti.runtime.collective import DeferredErrors
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.connectivity import has_repeated_dofs
from dolfinx_feti.torn.matrix import Torn


@dataclass(frozen=True, slots=True)
class Pattern:
    """The symbolic part of the method. It serves all matrices with this pattern and symmetry.

    Two attributes are more than symbolic: ``torn`` has the values of the present matrix, and
    ``errors`` those of the present set-up or solve.

    Attributes:
        options: Options of the solver, with which all other parts are set up.
        subsolvers: Options of its sub-solvers.
        torn: Subdomains and copies. Its products use the present values of the matrix.
        is_symmetric: Whether the values of K are symmetric, which the factors rely on; the cache
            creates another pattern if a later matrix differs in it.
        bodies: The connected components of the assembled problem.
        gluing: The jumps B.
        is_fixed: Mask of the torn dofs that are fixed in the local matrices, (n,): Dirichlet dofs
            in classical FETI, none in all-floating FETI.
        analysis: The subdomains, and how their blocks are factored.
        symmetric_part_analysis: The same for ½ (K + Kᵀ), if K is not symmetric.
        errors: Store for the errors of local work in iterations with matrices of this pattern. S,
            K⁺, the copies and the coarse solvers put them there; the outer loop raises them.
    """

    options: FETIOptions
    subsolvers: SubsolverOptions
    torn: Torn
    is_symmetric: bool
    bodies: Bodies
    gluing: Gluing
    is_fixed: Mask
    analysis: Analysis
    symmetric_part_analysis: Analysis | None
    errors: DeferredErrors

    @property
    def subdomains(self) -> list[Subdomain]:
        """The subdomains of this process."""
        return self.analysis.subdomains


def create_pattern(
    A: PETSc.Mat, options: FETIOptions, subsolvers: SubsolverOptions, pattern_objects: Lifetime
) -> Pattern:
    """Create all that depends on the pattern of A only. Collective.

    Args:
        A: The torn matrix, (N, N).
        options: The options of the solver.
        subsolvers: Options of its sub-solvers.
        pattern_objects: Owner of the torn matrix and of B, which destroys them.

    Raises:
        SetUpError: A subdomain has two copies of a dof, no subdomain has an entry for a dof, or K
            is not symmetric and the options need a symmetric K.
    """
    torn = pattern_objects.own(Torn(A))
    if has_repeated_dofs(A, torn.subdomains):
        raise SetUpError(
            "A subdomain has two copies of a dof: the local matrix couples subdomains that "
            "share it. Remove these entries, or tear the mesh so that they are one subdomain."
        )
    _require_entries(torn)
    is_symmetric = torn.is_symmetric()
    if not is_symmetric:
        _require_primal(options, subsolvers)
    with event("FETIGluing"):
        gluing = pattern_objects.own(Gluing(torn, all_floating=options.all_floating))
    is_fixed = np.zeros(torn.n, dtype=bool) if options.all_floating else torn.is_dirichlet_copy
    subdomains = create_subdomains(torn, gluing.interface_dofs, is_fixed)

    symmetric_part_analysis: Analysis | None = None
    with event("FETIFactor"):
        analysis = _analyse(torn, subdomains, options, subsolvers, is_symmetric=is_symmetric)
        if not is_symmetric:
            with torn_symmetric_part(torn) as part:
                symmetric_part_analysis = _analyse(
                    part, subdomains, options, subsolvers, is_symmetric=True
                )
    return Pattern(
        options=options,
        subsolvers=subsolvers,
        torn=torn,
        is_symmetric=is_symmetric,
        bodies=find_bodies(torn),
        gluing=gluing,
        is_fixed=is_fixed,
        analysis=analysis,
        symmetric_part_analysis=symmetric_part_analysis,
        errors=DeferredErrors(),
    )


def _analyse(
    torn: Torn,
    subdomains: list[Subdomain],
    options: FETIOptions,
    subsolvers: SubsolverOptions,
    *,
    is_symmetric: bool,
) -> Analysis:
    """Choose whether to eliminate the interior, and create the symbolic factors. Collective.

    Factors of K_II are prepared if the preconditioner ``pc_type`` needs them. That of the primal
    form, :data:`PRIMAL_PC_TYPE`, does.

    Args:
        torn: The torn matrix, or its symmetric part.
        subdomains: The subdomains of this process.
        options: Options of the solver.
        subsolvers: Options of its sub-solvers.
        is_symmetric: Whether the local matrix of ``torn`` is symmetric.
    """
    return analyse(
        torn,
        subdomains,
        options.interior,
        is_symmetric=is_symmetric,
        needs_interior_factors=PRECONDITIONERS[options.pc_type].needs_interior_factors,
        subsolvers=subsolvers,
    )


def _require_entries(torn: Torn) -> None:
    """Raise a SetUpError if the row of a dof without a prescribed value is empty. Collective."""
    copy_has_entries = np.repeat(np.diff(torn.graph.indptr) > 0, torn.K.getBlockSize())
    has_entries = torn.assemble(copy_has_entries.astype(np.float64)) > 0.0
    empty = np.flatnonzero(~has_entries & ~torn.is_dirichlet) + torn.A.getOwnershipRange()[0]
    total = torn.A.getSize()[0]
    count = torn.comm.allreduce(len(empty))
    first = torn.comm.allreduce(int(empty.min(initial=total)), op=MPI.MIN)
    if count:
        raise SetUpError(
            f"No subdomain has an entry for {count} of the {total} dofs, the first of which is "
            f"{first}: their rows of A are empty, and A is singular. Leave them out of the "
            "numbering, or prescribe their values (dirichlet= of create_torn_matrix)."
        )


def _require_primal(options: FETIOptions, subsolvers: SubsolverOptions) -> None:
    """Raise a SetUpError if the options rule out the method for an unsymmetric matrix."""
    needed = {}
    if excludes_primal(options, subsolvers):
        needed["formulation"] = "primal"
    if options.pc_type != PRIMAL_PC_TYPE:
        needed["pc_type"] = PRIMAL_PC_TYPE
    if options.interior == "eliminate":
        needed["interior"] = "keep"
    if needed:
        use = " ".join(f"-{subsolvers.prefix}{name} {value}" for name, value in needed.items())
        raise SetUpError(
            "The matrix is not symmetric: only GMRES in the primal form, with the interior kept, "
            f"solves with it. Use {use}."
        )


@contextmanager
def torn_symmetric_part(torn: Torn) -> Iterator[Torn]:
    """Return a context with a torn matrix in which ½ (K + Kᵀ) replaces K. Collective.

    The torn matrix is valid only within the context. Its subdomains are the same, as ½ (K + Kᵀ)
    couples the dofs that K couples.
    """
    K = torn.K.copy()
    transposed = torn.K.transpose(PETSc.Mat())
    K.axpy(1.0, transposed, structure=PETSc.Mat.Structure.UNKNOWN_NONZERO_PATTERN)
    K.scale(0.5)
    transposed.destroy()
    try:
        yield torn.with_local_matrix(K)
    finally:
        K.destroy()
