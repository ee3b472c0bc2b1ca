# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The modulus κ of condensed fields without a term in their own equation.

Such a field is given a term (``unknowns.compression``):

.. math:: F_p = c\, g(u)\, q \quad→\quad c\, g(u)\, q - \frac{c}{κ}\, p\, q

with the constraint g, such as J − 1 or div u. A user may write it with any factor c: the force of p
on u is K_up, and K_pu = c K_upᵀ. A penalty leaves g = p/κ; multipliers replace p in the new term,
so that g = 0, and κ only affects speed. If the user gives no κ, it is chosen by the stiffness:

.. math:: c = \frac{K_{up}^⊤ : K_{pu}}{K_{up} : K_{up}}, \qquad
          κ = 30\, \frac{\operatorname{tr} K_{uu}}{\operatorname{tr} K_{up} M^{-1} K_{up}^⊤}
            = 30\, c\, \frac{\operatorname{tr} K_{uu}}{\operatorname{tr} K_{up} M^{-1} K_{pu}}

with the mass matrix M of p. With more such fields the products and traces are summed.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfinx_feti.fem.condensation.condensation import Condensation
from dolfinx_feti.problems.equations.system import System
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import logger, on_all, total_of

#: Stiffness of the penalty κ g² over that of the forms, K_uu. With a larger κ multipliers converge
#: in fewer solves, but each solve takes more Krylov iterations.
STIFFNESS_RATIO = 30.0


@dataclass(frozen=True, slots=True)
class Modulus:
    """The modulus of incompressible fields, one for all of them.

    Attributes:
        kappa: κ, in the unit of the stress.
        scale: c, the factor of the constraint in the user's forms.
    """

    kappa: float
    scale: float


def check_kappa(kappa: float | None, *, has_incompressible_field: bool) -> None:
    """Check the modulus of incompressible fields.

    Raises:
        ValueError: It is given, but not positive, or no field needs it.
    """
    if kappa is None:
        return
    if not 0.0 < kappa < np.inf:
        raise ValueError(f"kappa is {kappa}: give a positive modulus, in the unit of the stress.")
    if not has_incompressible_field:
        raise ValueError(
            f"kappa is {kappa}, but no condensed field is without a term of its own: leave kappa "
            "out, and change the modulus in the forms."
        )


def multiplier_tolerance(
    kappa: float | None,
    volume_tolerance: float | None,
    default_tolerance: float,
    *,
    has_incompressible_field: bool,
) -> float | None:
    """Return the tolerance of multipliers of the volume; None if there are none.

    ===============  ================  ==================================
    ``kappa``        tolerance         an incompressible field
    ===============  ================  ==================================
    not given        not given         multipliers, default tolerance
    not given        given             multipliers
    given            given             multipliers with the modulus kappa
    given            not given         penalty with the modulus kappa
    ===============  ================  ==================================

    Fields with a term of their own have multipliers if the tolerance is given.

    Args:
        kappa: The user's κ, or None.
        volume_tolerance: The user's tolerance, or None.
        default_tolerance: Tolerance of an incompressible field without one.
        has_incompressible_field: Whether a condensed field has no term in its own equation.
    """
    is_penalty = kappa is not None
    if volume_tolerance is None and has_incompressible_field and not is_penalty:
        return default_tolerance
    return volume_tolerance


def set_modulus(system: System, kappa: float | None, tolerance: float | None) -> list[float] | None:
    """Choose the modulus of incompressible fields, set it in the forms, and log it. Collective.

    Nothing happens if no field is incompressible. Else the matrix holds the tangent of the present
    state afterwards.

    Args:
        system: The equations, at the state where the first solve begins.
        kappa: The user's κ; None to choose it by the stiffness at this state.
        tolerance: Tolerance of multipliers, for the log; None for a penalty.

    Returns:
        The size |c| of the constraint of each condensed field, 1 for a field that is not
        incompressible; None if no field is.

    Raises:
        ValueError: The state does not determine κ, and none was given.
    """
    compression = system.forms.compression
    fields = system.condensation
    if compression is None or fields is None:
        return None
    names = ", ".join(f"'{fields.fields[i].name}'" for i in compression.numbers)
    products = _products(system, fields, compression.numbers)
    modulus = _modulus(system, products, kappa, names)
    compression.compliance.value = modulus.scale / modulus.kappa  # γ = c/κ
    if system.comm.rank == 0:
        level = logging.WARNING if kappa is None else logging.INFO
        logger.log(level, _description(names, modulus, tolerance))
    sizes = [1.0] * len(fields.fields)
    for row, i in enumerate(compression.numbers):
        mixed, square, _ = map(float, products[row])  # K_upᵀ : K_pu and K_up : K_up
        sizes[i] = abs(mixed / square if square > 0.0 else modulus.scale)  # |c| of field i
    return sizes


def _products(system: System, fields: Condensation, numbers: Sequence[int]) -> Array:
    """Return K_upᵀ : K_pu, K_up : K_up and tr K_up M⁻¹ K_pu of fields, (fields, 3). Collective.

    Args:
        system: The equations.
        fields: Their condensed fields.
        numbers: Numbers of the incompressible ones.
    """
    system.linearise()

    def on_process() -> Array:
        of_fields = [fields.constraint_products(i) for i in numbers]
        return np.array([(each.mixed, each.square, each.stiffness) for each in of_fields])

    return total_of(on_all(on_process, system.comm), system.comm)


def _modulus(system: System, products: Array, kappa: float | None, names: str) -> Modulus:
    """Return the user's modulus, or one by the stiffness of the tangent. Collective.

    Args:
        system: The equations, with the tangent of the present state.
        products: What :func:`_products` returns.
        kappa: The user's κ, or None.
        names: Names of the incompressible fields, for the message.

    Raises:
        ValueError: The state does not determine it.
    """
    mixed, square, stiffness = products.sum(axis=0)
    c = mixed / square if square > 0.0 else 0.0
    if kappa is None:
        kappa = STIFFNESS_RATIO * system.tangent.trace() * c / stiffness
    if not (0.0 < kappa < np.inf and abs(c) > 0.0):
        raise ValueError(
            f"The equation of {names} has no term in it, and a modulus for one cannot be chosen "
            "from the forms at the start: give kappa=, a few times the stiffness of the material, "
            "or a term of its own, such as −p q/kappa."
        )
    return Modulus(kappa, c)


def _description(names: str, modulus: Modulus, tolerance: float | None) -> str:
    """Return how fields are made solvable: by a penalty, or by multipliers with a tolerance."""
    text = f"The equation of {names} has no term in it (incompressible)"
    if tolerance is None:
        return (
            f"{text}: kappa={modulus.kappa:g} adds the penalty −p q/kappa, and volumes change by "
            "p/kappa."
        )
    return (
        f"{text}: solved by multipliers with kappa={modulus.kappa:.3g}, to "
        f"volume_tolerance={tolerance:g}. Give both to choose them, or kappa= alone for a penalty."
    )
