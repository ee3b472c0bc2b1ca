# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""What the pattern tells of the factors: whether the interior is eliminated, and in what order.

If the interior is *kept*, :math:`K_ρ^{-1}` and S are applied by sparse factors; if it is
*eliminated*, S is formed, a dense block of the size of Γ. ``auto`` does so if that takes about the
memory of the factors (:data:`DENSITY`), or a pressure is condensed, as adaptive columns need S.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx_feti.feti.gluing.jump import Dofs
from dolfinx_feti.feti.subdomain.blocks import on_subdomains
from dolfinx_feti.feti.subdomain.factors.direct import Choice
from dolfinx_feti.feti.subdomain.factors.multifrontal import Fronts, create_fronts, load_fronts_for
from dolfinx_feti.runtime.arrays import Indices
from dolfinx_feti.runtime.petsc_library import reads_in_place
from dolfinx_feti.torn.matrix import Torn

#: Entries of S for each :math:`n^{4/3}`, which is how a sparse factor in three dimensions grows.
DENSITY = 30.0

#: Largest interface of a subdomain whose interior is eliminated: 32 MiB.
LARGEST = 2048

#: Right-hand sides that MUMPS treats at once: for K_ρ, and for K_II whose interior is eliminated.
RIGHT_HAND_SIDES = 32, 256


@dataclass(frozen=True, slots=True)
class Analysis:
    """How the blocks of the subdomains are factored.

    Attributes:
        eliminated: Whether the interior is eliminated, and S is formed.
        local: How K_ρ is factored with pivots.
        interior: How K_II is factored with pivots; None if no K_II is.
        local_fronts: The fronts of K_ρ; None if it has pivots from the start.
        interior_fronts: The fronts of K_II, with Γ as what remains where S is formed; likewise.
    """

    eliminated: bool
    local: Choice
    interior: Choice | None
    local_fronts: list[Fronts] | None
    interior_fronts: list[Fronts] | None


def analyse(
    torn: Torn, dofs: Dofs, choice: str, *, symmetric: bool, with_interior: bool, prefix: str
) -> Analysis:
    """Choose how to factor, and order the eliminations. Collective.

    ``choice`` is the option of the interior; ``with_interior`` tells whether K_II is factored where
    the interior is kept. ``local_`` (K_ρ) or ``dirichlet_`` (K_II) is added to the prefix.
    """
    eliminated = choice == "eliminate"
    if choice == "auto":
        eliminated = symmetric and worth_eliminating(torn, dofs)
    local = Choice(prefix + "local_", symmetric, RIGHT_HAND_SIDES[0])
    interior = Choice(prefix + "dirichlet_", symmetric, RIGHT_HAND_SIDES[eliminated])
    none = [np.zeros(0, dtype=np.int32)] * len(dofs.free)
    if eliminated:
        borders = [np.flatnonzero(on).astype(np.int32) for on in dofs.on_interface]
        fronts = _find_fronts(torn, dofs.free, borders, interior)
        return Analysis(True, local, interior, None, fronts)
    local_fronts = _find_fronts(torn, dofs.free, none, local)
    if not with_interior:
        return Analysis(False, local, None, local_fronts, None)
    fronts = _find_fronts(torn, dofs.interior, none, interior)
    return Analysis(False, local, interior, local_fronts, fronts)


def _find_fronts(
    torn: Torn, blocks: Sequence[Indices], interfaces: Sequence[Indices], choice: Choice
) -> list[Fronts] | None:
    """Find the fronts of disjoint blocks, whose interfaces are not eliminated. Collective.

    There are none for unsymmetric matrices, where the options name a solver, and with indices of
    64 bits in PETSc: rows would have to be copied for every factor.
    """
    code = load_fronts_for(choice.prefix, torn.comm)
    if code is None or not choice.symmetric or not reads_in_place():
        return None

    def find() -> list[Fronts]:
        number = np.full(torn.n, -1, dtype=np.int32)
        for rows in blocks:
            number[rows] = np.arange(len(rows))
        bs, pairs = torn.K.getBlockSize(), zip(blocks, interfaces, strict=True)
        return [create_fronts(code, torn.graph, rows, number, bs, on) for rows, on in pairs]

    return on_subdomains(find, torn.comm)


def worth_eliminating(torn: Torn, dofs: Dofs) -> bool:
    """Tell whether S of every subdomain is wanted, and small. Collective.

    It is wanted where it takes about the memory of sparse factors, or a pressure is condensed.
    """
    n = np.array([len(rows) for rows in dofs.free], dtype=np.float64)
    glued = np.array([len(rows) for rows in dofs.interface], dtype=np.float64)
    dense, sparse = torn.comm.allreduce(np.array([(glued**2).sum(), (n ** (4 / 3)).sum()]))
    largest = torn.comm.allreduce(glued.max(initial=0.0), op=MPI.MAX)
    wanted = dense <= DENSITY * sparse or torn.pressures is not None
    return bool(wanted and largest <= LARGEST)
