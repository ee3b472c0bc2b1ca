# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The preconditioners of the dual formulation by name.

A new one is a file in this folder, an entry here, a name in the order of ``__init__``, and a word
in docs/options.md. Its name here becomes a value of ``feti_pc_type``, and choosing it selects the
dual formulation, unless it is the default (``FETIOptions.pc_type``). The tests run each entry:
``dense_weight`` in ``tests/feti/preconditioners/test_preconditioners.py`` has to define its Y.
"""

from __future__ import annotations

from dolfinx_feti.feti.preconditioners.base import Preconditioner
from dolfinx_feti.feti.preconditioners.dirichlet import Dirichlet
from dolfinx_feti.feti.preconditioners.identity import Identity
from dolfinx_feti.feti.preconditioners.lumped import Lumped

#: The preconditioners by the values of the option ``feti_pc_type``.
PRECONDITIONERS: dict[str, type[Preconditioner]] = {
    "dirichlet": Dirichlet,
    "lumped": Lumped,
    "identity": Identity,
}
