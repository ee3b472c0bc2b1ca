# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The modes of all subdomains of a process, attribute by attribute."""

from __future__ import annotations

from collections.abc import Iterable
from types import SimpleNamespace

import numpy as np
import scipy.linalg
from collective import COMM, Array

from dolfinx_feti.feti.dual.form import DualForm
from dolfinx_feti.feti.primal.form import PrimalForm

NAMES = ("R", "E", "D", "stabilisation", "exact", "rho", "kernel")


def on_torn_dofs(system: DualForm | PrimalForm, blocks: Iterable[Array]) -> Array:
    """Bring columns of each subdomain, (n_i, k_i), to all processes, on all torn dofs."""
    own = [np.zeros((system.operator.torn.n, 0))]
    for dofs, X in zip(system.operator.dofs, blocks, strict=True):
        own.append(np.zeros((len(own[0]), X.shape[1])))
        own[-1][dofs] = X
    return scipy.linalg.block_diag(*COMM.allgather(np.hstack(own)))


def modes_of(system: DualForm) -> SimpleNamespace:
    """Return lists of the attributes of ``SubdomainModes``, and the numbers of modes."""
    lists = {name: [getattr(modes, name) for modes in system.modes] for name in NAMES}
    dimensions = np.array([R.shape[1] for R in lists["R"]], dtype=np.int64)
    negative = sum(Z.shape[1] for Z in lists["stabilisation"])
    return SimpleNamespace(**lists, dimensions=dimensions, negative_defects=negative)
