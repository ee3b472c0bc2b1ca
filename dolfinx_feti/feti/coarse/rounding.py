# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Rounding errors of energies, with which a negative energy has to be compared.

.. math:: |\mathrm{fl}(v^⊤ A\, v) - v^⊤ A\, v| \;\lesssim\; ε \sum_i \|S_i\|_F\, \|(T v)_i\|^2

with the rounding unit ε, for a vector v on the assembled interface. A negative computed energy
proves that A is indefinite only if it is below :data:`NEGATIVE_ENERGY_MARGIN` times this bound.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfinx_feti.feti.coarse.basis import SubdomainColumns
from dolfinx_feti.feti.interface.copies import Copies
from dolfinx_feti.feti.subdomain.failures import on_subdomains
from dolfinx_feti.feti.subdomain.schur import SchurComplement
from dolfinx_feti.feti.subdomain.schur_operator import SchurOperator
from dolfinx_feti.runtime.arrays import Array, concatenate
from dolfinx_feti.runtime.collective import total_of
from dolfinx_feti.torn.rounding import EPS

#: Multiple of the bound below which an energy counts as negative. The norms in the bound come from
#: one random vector each, and may be too small by a factor of a few. Half and twice of it change no
#: iteration of a tube, nor of blocks with jumps of 1e3 and 1e8.
NEGATIVE_ENERGY_MARGIN = 10.0


def proves_indefinite(copies: Copies, S: SchurOperator, v: Array, energy: float) -> bool:
    """Return True if a computed energy vᵀ A v is negative beyond rounding. Collective.

    It costs a product with each S_i, and is meant for the few v with a negative energy.

    Args:
        copies: Copies of the interface dofs.
        S: Schur complements of the subdomains of this process.
        v: Assembled vector by its copies, (n_Γ,).
        energy: Its computed energy.
    """

    def sum_over_subdomains() -> float:
        total = 0.0
        for S_i in S.by_subdomain:
            v_i = v[S_i.subdomain.interface_rows]
            total += _estimated_norm(S_i) * float(v_i @ v_i)  # ‖S_i‖_F ‖(T v)_i‖²
        return total

    local_sum = on_subdomains(sum_over_subdomains, copies.comm)
    bound = EPS * total_of(local_sum, copies.comm)
    return energy < -NEGATIVE_ENERGY_MARGIN * bound


def column_energy_rounding(S: SchurOperator, by_subdomain: Sequence[SubdomainColumns]) -> Array:
    """Return each subdomain's part of the bound for its columns, ε ‖S_i‖_F ‖W_i e_j‖². Collective.

    Args:
        S: Schur complements of the subdomains of this process.
        by_subdomain: Columns of the same subdomains.

    Returns:
        The bounds, a torn coarse vector, (c,).
    """

    def compute() -> Array:
        subdomains = zip(S.by_subdomain, by_subdomain, strict=True)
        return concatenate(
            [EPS * _estimated_norm(S_i) * columns.W.squares() for S_i, columns in subdomains]
        )

    return on_subdomains(compute, S.torn.comm)


def _estimated_norm(S_i: SchurComplement) -> float:
    """Return an estimate of ‖S_i‖_F: the norm of S_i ω for a vector ω of normal random numbers.

    E ‖S_i ω‖² = ‖S_i‖_F². The seed makes ω the same in each run, for any distribution of the
    subdomains over processes.
    """
    n_Γ = len(S_i.subdomain.interface)
    ω = np.random.default_rng(n_Γ).standard_normal((n_Γ, 1))
    return float(np.linalg.norm(S_i.multiply(ω)))
