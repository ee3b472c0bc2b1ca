# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Scalings: the weights δ of the copies of each dof, in averages and in :math:`B_D`.

.. math:: δ_i = k_i / \sum_j k_j \quad\text{over the copies j of a dof}, \qquad T^⊤ δ\, T = I

with the stiffness k of each copy. To use other numbers k for one matrix, pass them as ``stiffness``
to ``create_torn_matrix``. A new scaling is a function of the torn matrix, with the contract of
:data:`Scaling`, an entry in :data:`SCALINGS`, and a word in docs/options.md.
``tests/feti/interface/test_gluing.py`` checks that its weights sum up to one. Two kinds need more:

* Weights from the Schur complements S need another argument, since a scaling has K alone.
* Averages by matrices, as in deluxe scaling, also need other averages in ``copies`` and other
  entries of B_D in ``gluing``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.torn.matrix import Torn

#: Smallest stiffness of a copy relative to the sum over the copies of its dof. It keeps all weights
#: positive, because adaptive columns divide by them, in :math:`δ^{-1/2} S_i δ^{-1/2}`. A rounding
#: margin: it changes a weight by about 1e-12, far below all tolerances, and so do half and twice of
#: it.
MIN_SHARE = 1e-12

#: A function that returns the weights δ of the copies of a torn matrix, (n,). All have to be
#: positive and to sum up to one over the copies of a dof; :func:`weights_from_stiffness` returns
#: such weights. Collective.
Scaling = Callable[[Torn], Array]


def stiffness_scaling(torn: Torn) -> Array:
    """Return weights δ in proportion to the stiffness of each copy, (n,). Collective.

    The stiffness is the argument ``stiffness`` of ``create_torn_matrix``, by default the diagonal
    of K. Problems with a condensed pressure pass the diagonal without the pressure's part.
    """
    return weights_from_stiffness(torn, torn.stiffness())


def multiplicity_scaling(torn: Torn) -> Array:
    """Return equal weights δ, 1 / (number of copies), (n,). Collective."""
    return weights_from_stiffness(torn, np.ones(torn.n))


#: Scalings by the values of the option ``feti_scaling``.
SCALINGS: dict[str, Scaling] = {
    "stiffness": stiffness_scaling,
    "multiplicity": multiplicity_scaling,
}


def weights_from_stiffness(torn: Torn, k: Array) -> Array:
    """Return positive weights δ in proportion to numbers k. Collective.

    Args:
        torn: The torn matrix.
        k: Stiffness of each copy, or another number k ≥ 0 in proportion to its weight, (n,). If
            all copies of a dof have k = 0, their weights are equal.

    Returns:
        δ, (n,), which sums up to one over the copies of a dof.
    """
    total = torn.tear(torn.assemble(k))  # Σⱼ kⱼ
    k_min = MIN_SHARE * total
    positive_k = np.where(total > 0.0, np.maximum(k, k_min), 1.0)
    return np.asarray(positive_k / torn.tear(torn.assemble(positive_k)))  # δᵢ = kᵢ / Σⱼ kⱼ
