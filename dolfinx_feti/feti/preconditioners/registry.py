# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The preconditioners of the dual formulation by name.

A new one is a file in this folder, an entry here, and a name in the order of ``__init__``. Its name
here becomes a value of ``feti_pc_type``, and choosing it selects the dual formulation, unless it is
the default (``FETIOptions.pc_type``).
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
