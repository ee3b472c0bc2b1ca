# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The modes of all subdomains of a process, attribute by attribute."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from dolfinx_feti.feti.dual.form import DualForm

NAMES = ("R", "E", "D", "stabilisation", "exact", "rho", "kernel")


def modes_of(system: DualForm) -> SimpleNamespace:
    """Return lists of the attributes of ``SubdomainModes``, and the numbers of modes."""
    lists = {name: [getattr(modes, name) for modes in system.modes] for name in NAMES}
    dimensions = np.array([R.shape[1] for R in lists["R"]], dtype=np.int64)
    negative = sum(Z.shape[1] for Z in lists["stabilisation"])
    return SimpleNamespace(**lists, dimensions=dimensions, negative_defects=negative)
