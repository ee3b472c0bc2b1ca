# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Modes and factors of all subdomains: attributes of ``SubdomainModes`` as lists, dense columns."""

from __future__ import annotations

from collections.abc import Iterable
from types import SimpleNamespace

import numpy as np
import scipy.linalg
from collective import COMM, Array

from dolfinx_feti.feti.dual.formulation import DualFormulation
from dolfinx_feti.feti.primal.formulation import PrimalFormulation
from dolfinx_feti.feti.subdomain.factors.protocol import Factor

NAMES = ("R", "E", "D", "stabilisation", "is_exact", "rho", "n_rigid", "n_null")


def on_torn_dofs(system: DualFormulation | PrimalFormulation, blocks: Iterable[Array]) -> Array:
    """Return the columns of all subdomains, (n_i, k_i) each, on all torn dofs and all processes."""
    is_dual = isinstance(system, DualFormulation)
    inverse = system.inverse if is_dual else system.preconditioner.inverse
    own = [np.zeros((system.operator.torn.n, 0))]
    for K_i, X in zip(inverse.by_subdomain, blocks, strict=True):
        own.append(np.zeros((len(own[0]), X.shape[1])))
        own[-1][K_i.dofs] = X
    return scipy.linalg.block_diag(*COMM.allgather(np.hstack(own)))


def modes_of(system: DualFormulation) -> SimpleNamespace:
    """Return lists of the attributes of ``SubdomainModes``, and the numbers of modes."""
    lists = {name: [getattr(modes, name) for modes in system.modes] for name in NAMES}
    dimensions = np.array([E.shape[1] for E in lists["E"]], dtype=np.int64)
    negative = sum(Z.shape[1] for Z in lists["stabilisation"])
    return SimpleNamespace(**lists, dimensions=dimensions, negative_defects=negative)


def factors_of(system: DualFormulation) -> list[Factor]:
    """Return the factor of K_ρ of each subdomain."""
    return [K_i.factor for K_i in system.inverse.by_subdomain]
