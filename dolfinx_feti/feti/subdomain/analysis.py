# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Whether the interior of the subdomains is eliminated; symbolic factors of their matrices.

If the interior is *kept*, S and :math:`K_ρ^{-1}` are applied by sparse factors of :math:`K_{II}`
and :math:`K_ρ`. If it is *eliminated*, a dense :math:`S_i` of the size of Γ is formed for each
subdomain, and :math:`S_ρ` is factored. The option ``feti_interior auto`` eliminates in two cases:
if all :math:`S_i` need about as much memory as the sparse factors (:data:`MAX_MEMORY_RATIO`), or if
a pressure is condensed. In the second case the iterations depend on adaptive columns, which are
exact only if :math:`S_i` is formed (docs/theory.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from mpi4py import MPI

import numpy as np

from dolfinx_feti.feti.subdomain.factors.create import analyse_blocks
from dolfinx_feti.feti.subdomain.factors.petsc_solver import FactorOptions
from dolfinx_feti.feti.subdomain.factors.protocol import SymbolicFactor
from dolfinx_feti.feti.subdomain.subdomain import Subdomain
from dolfinx_feti.feti.subsolver_options import SubsolverOptions
from dolfinx_feti.torn.matrix import Torn

#: All :math:`S_i` are formed if together they have at most this many entries for each unit of the
#: sum of :math:`n_i^{4/3}`. A sparse factor in three dimensions has about 30 :math:`n_i^{4/3}`
#: entries: at this ratio both take about the same memory.
MAX_MEMORY_RATIO = 30.0

#: S is formed only if no subdomain has a larger interface [dofs]. A memory bound: 2048² doubles are
#: 32 MiB.
MAX_INTERFACE = 2048

#: Right-hand sides of K_ρ, which are modes, that MUMPS solves for at once. A memory bound: 32
#: columns of 10⁴ dofs are 2.4 MiB.
RIGHT_HAND_SIDES = 32

#: The same for K_II if S is formed by solves, with one right-hand side for each dof of Γ. A memory
#: bound: 256 columns of 10⁴ dofs are 20 MiB.
RIGHT_HAND_SIDES_FOR_S = 256


@dataclass(frozen=True, slots=True)
class SubdomainAnalysis:
    """One subdomain with its symbolic factors.

    Attributes:
        subdomain: The subdomain.
        local_symbolic: Symbolic factor of K_i, by which K_ρ = K_i + ρ R Rᵀ is factored. None if
            PETSc factors it, or if S_i is factored instead, because the interior is eliminated.
        interior_symbolic: Symbolic factor that eliminates the interior: it factors K_II, and forms
            S_i as well if S is formed. None if PETSc factors K_II, or if K_II is not factored.
    """

    subdomain: Subdomain
    local_symbolic: SymbolicFactor | None
    interior_symbolic: SymbolicFactor | None


@dataclass(frozen=True, slots=True)
class Analysis:
    """How the matrices of all subdomains of this process are factored.

    Attributes:
        is_interior_eliminated: Whether the interior is eliminated, and S is formed.
        has_interior_factors: Whether K_II is factored, as it always is if the interior is
            eliminated.
        local_options: How PETSc factors K_ρ = K_i + ρ R Rᵀ, if it does.
        interior_options: How PETSc factors K_II, if it does.
        by_subdomain: The subdomains of this process with their symbolic factors.
    """

    is_interior_eliminated: bool
    has_interior_factors: bool
    local_options: FactorOptions
    interior_options: FactorOptions
    by_subdomain: list[SubdomainAnalysis]

    @property
    def subdomains(self) -> list[Subdomain]:
        """The subdomains of this process."""
        return [analysed.subdomain for analysed in self.by_subdomain]


def analyse(
    torn: Torn,
    subdomains: list[Subdomain],
    interior: Literal["auto", "keep", "eliminate"],
    *,
    is_symmetric: bool,
    needs_interior_factors: bool,
    subsolvers: SubsolverOptions,
) -> Analysis:
    """Choose whether to eliminate the interior, and create the symbolic factors. Collective.

    Args:
        torn: The torn matrix.
        subdomains: The subdomains of this process.
        interior: The option ``feti_interior``; not ``eliminate`` for an unsymmetric K.
        is_symmetric: Whether K is symmetric.
        needs_interior_factors: Whether K_II is factored even if the interior is kept.
        subsolvers: Options of the factors.

    Raises:
        SetUpError: The analysis of a block failed; on all processes.
    """
    is_interior_eliminated = interior == "eliminate"
    if interior == "auto":
        is_interior_eliminated = is_symmetric and is_worth_eliminating(torn, subdomains)
    interior_columns = RIGHT_HAND_SIDES_FOR_S if is_interior_eliminated else RIGHT_HAND_SIDES
    local_options = FactorOptions(subsolvers.local, is_symmetric, RIGHT_HAND_SIDES)
    interior_options = FactorOptions(subsolvers.dirichlet, is_symmetric, interior_columns)
    free_dofs = [s.free_dofs for s in subdomains]
    no_interfaces = [np.zeros(0, dtype=np.int32) for _ in subdomains]
    local_symbolic: Sequence[SymbolicFactor | None] = [None] * len(subdomains)
    interior_symbolic: Sequence[SymbolicFactor | None] = [None] * len(subdomains)
    if is_interior_eliminated:
        interfaces = [np.flatnonzero(s.is_on_interface).astype(np.int32) for s in subdomains]
        interior_symbolic = analyse_blocks(torn, free_dofs, interfaces, interior_options)
    else:
        local_symbolic = analyse_blocks(torn, free_dofs, no_interfaces, local_options)
        if needs_interior_factors:
            interiors = [s.interior for s in subdomains]
            interior_symbolic = analyse_blocks(torn, interiors, no_interfaces, interior_options)
    return Analysis(
        is_interior_eliminated=is_interior_eliminated,
        has_interior_factors=is_interior_eliminated or needs_interior_factors,
        local_options=local_options,
        interior_options=interior_options,
        by_subdomain=[
            SubdomainAnalysis(s, of_K_i, of_interior)
            for s, of_K_i, of_interior in zip(
                subdomains, local_symbolic, interior_symbolic, strict=True
            )
        ],
    )


def is_worth_eliminating(torn: Torn, subdomains: Sequence[Subdomain]) -> bool:
    """Return True if ``feti_interior auto`` eliminates the interior. Collective.

    Two conditions: no interface is large (:data:`MAX_INTERFACE`); and either all S_i need about as
    much memory as sparse factors (:data:`MAX_MEMORY_RATIO`), or a pressure is condensed.
    """
    dofs = np.array([len(s.free_dofs) for s in subdomains], dtype=np.float64)
    on_interface = np.array([len(s.interface) for s in subdomains], dtype=np.float64)
    dense, sparse = torn.comm.allreduce(
        np.array([(on_interface**2).sum(), (dofs ** (4 / 3)).sum()])
    )
    largest = torn.comm.allreduce(on_interface.max(initial=0.0), op=MPI.MAX)
    # This is the same on all processes: if a pressure is condensed, the number is set on each of
    # them, to 0 on a process without cells.
    has_condensed_pressure = torn.n_condensed_pressures is not None
    is_worth_it = dense <= MAX_MEMORY_RATIO * sparse or has_condensed_pressure
    return bool(is_worth_it and largest <= MAX_INTERFACE)
