# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Rounding errors of Newton's residual, the floor that no step can get below (docs/theory.md).

.. math:: ε\, \Bigl\| \Bigl(\sum_j k_{ij}^2 (u_j^2 + \hat h_j^2)\Bigr)^{1/2} \Bigr\|

k_ij are the entries of the torn tangent. In F = I + c Grad u (``deformation_gradient``) the entries
1 of I are rounded by ε. This has the effect of rounding a displacement of the size ĥ = h/c, with
the size h of a cell.
"""

from __future__ import annotations

import numpy as np

from dolfinx_feti.problems.equations.system import System
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.torn.rounding import EPS


def residual_rounding(system: System) -> float:
    """Return the norm of the rounding errors of r on the free dofs, with contacts. Collective.

    The entries are those of the tangent that the matrix holds, of the present state or of the one
    before it: the errors are known to an order of magnitude only.
    """
    squares = system.tangent.product_rounding_squares(_rounded_lengths(system))
    contacts = sum(contact.force_rounding() for contact in system.forms.contacts)
    return _root_of_sum(system, squares) + contacts


def diagonal_rounding(system: System) -> float:
    r"""Return :math:`ε \|k_{ii} (u_i^2 + \hat h_i^2)^{1/2}\|`, k before condensation. Collective.

    It is a lower bound of :func:`residual_rounding`: a first residual below it contains no load.
    """
    return _root_of_sum(system, (EPS * system.tangent.diagonal * _rounded_lengths(system)) ** 2)


def _rounded_lengths(system: System) -> Array:
    """Return (u² + ĥ²)^½ at the torn dofs, (n,)."""
    u = system.forms.u.x.array[system.torn_dofs.local]
    return np.asarray(np.hypot(u, system.lengths))


def _root_of_sum(system: System, squares: Array) -> float:
    """Return the root of the sum of squares, (n,), over the copies of all free dofs. Collective."""
    on_free_dofs = system.conditions.free(system.torn_dofs.assemble(squares))
    return float(np.sqrt(system.comm.allreduce(on_free_dofs.sum())))
