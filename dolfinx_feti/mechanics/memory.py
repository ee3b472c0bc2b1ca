# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Materials with memory: the energy of a time step, and the update of internal variables.

The stress at the end of a step derives from an energy Ψ(C; ξₙ), with the internal variables ξₙ of
the last state: residual, tangent and line search are those of a hyperelastic material. Pass the
updates :math:`ξ_{n+1} = Ξ(C, ξ_n)` to ``NonlinearProblem(internal_variables=…)``.

*Viscosity*: isochoric overstresses Q_α, with their shares β_α and times τ_α (Prony series;
Holzapfel 2000, sec. 6.10), are integrated over a step Δt by

.. math:: Q_{α,n+1} = e^{-Δt/τ_α}\, Q_{α,n} + δ_α\, (S_{n+1} - S_n), \qquad
          δ_α = β_α\, e^{-Δt/2τ_α}, \qquad S = 2\, ∂\barΨ/∂C,

which is of second order in Δt, and exact while S is constant. The stress :math:`S + \sum_α Q_α` is
that of :math:`(1 + \sum_α δ_α)\, \barΨ + ½ \sum_α (e^{-Δt/τ_α} Q_{α,n} - δ_α S_n) : C`.

*Damage*: the stress (1 − d) S of a material that softens with the largest energy m of its history,
:math:`d = d_∞ (1 - e^{-m/W})`, :math:`m = \max(m_n, Ψ)` (discontinuous softening; Simo 1987),
is that of

.. math:: φ(Ψ) = \begin{cases} (1 - d(m_n))\, Ψ & Ψ ≤ m_n \\
          φ(m_n) + (1 - d_∞)(Ψ - m_n) + d_∞ W (e^{-m_n/W} - e^{-Ψ/W}) & \text{else.} \end{cases}
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import ufl
from ufl.core.expr import Expr
from ufl.variable import Variable

from dolfinx_feti.mechanics.materials import Parameter
from dolfinx_feti.runtime.values import require_positive, require_within

__all__ = ["MaxwellBranch", "damaged", "viscoelastic"]


@dataclass(frozen=True, slots=True)
class MaxwellBranch:
    """A spring and a dashpot in series, parallel to the elastic material."""

    Q: Expr  #: Overstress [kPa], (d, d), a Function of quadrature points or cells; zero at first
    share: Parameter  #: Stiffness of the spring over that of the elastic material, β [-]
    time: Parameter  #: Relaxation time τ [s]

    def __post_init__(self) -> None:
        """Check the values."""
        require_positive(share=self.share, time=self.time)


def viscoelastic(
    psi: Expr, F: Variable, S_n: Expr, branches: Sequence[MaxwellBranch], *, dt: Expr
) -> tuple[Expr, dict[Expr, Expr]]:
    """Energy of a step of a viscoelastic material (Holzapfel 2000, sec. 6.10).

    Args:
        psi: Energy Ψ̄ of the elastic material after complete relaxation [kPa], written in F.
        F: Deformation gradient, a ``ufl.variable``, as ``kinematics.deformation_gradient`` is.
        S_n: Stress S of the last state [kPa], (d, d), a Function like the overstresses; zero in a
            state at rest.
        branches: Overstresses, with their shares and times.
        dt: Length Δt of the step [s], a dolfinx Constant.

    Returns:
        The energy, and the updates of S_n and of all Q.

    Raises:
        ValueError: ``dt`` is a number that is not positive. (:class:`MaxwellBranch` checks the
            numbers of a branch.)
    """
    require_positive(dt=dt)
    S = ufl.inv(F) * ufl.diff(psi, F)  # S = F⁻¹ ∂Ψ̄/∂F
    energy = psi
    updates = {S_n: S}
    C = F.T * F
    for branch in branches:
        decay = ufl.exp(-dt / branch.time)  # e^{−Δt/τ}
        δ = branch.share * ufl.exp(-dt / (2 * branch.time))  # β e^{−Δt/2τ}
        history = decay * branch.Q - δ * S_n  # what the last state contributes to Q
        energy += δ * psi + ufl.inner(history, C) / 2
        updates[branch.Q] = history + δ * S  # Q ← e^{−Δt/τ} Q + δ (S − S_n)
    return energy, updates


def damaged(psi: Expr, m: Expr, *, d_max: Parameter, W: Parameter) -> tuple[Expr, dict[Expr, Expr]]:
    """Energy of a step of a material that softens with its largest energy so far (Simo 1987).

    Args:
        psi: Energy Ψ of the intact material [kPa], not negative.
        m: The largest Ψ so far [kPa], a scalar Function of quadrature points or cells; at first
            zero.
        d_max: Limit d_∞ of the damage d, between 0 and 1 [-].
        W: Energy scale of the damage, positive [kPa].

    Returns:
        The energy, and the update of m.
    """
    require_within(0.0, 1.0, {"d_max": d_max}, includes_ends=False)
    require_positive(W=W)
    decay_at_m = ufl.exp(-m / W)
    decay_at_psi = ufl.exp(-psi / W)
    intact = 1 - d_max * (1 - decay_at_m)  # 1 − d(m)
    below_m = intact * psi  # Ψ ≤ m: the damage does not grow
    above_m = intact * m + (1 - d_max) * (psi - m) + d_max * W * (decay_at_m - decay_at_psi)
    φ = ufl.conditional(ufl.le(psi, m), below_m, above_m)
    return φ, {m: ufl.max_value(m, psi)}
