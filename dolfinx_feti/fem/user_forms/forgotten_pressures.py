# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Check of an energy for a pressure that the user forgot to condense.

.. math:: Π(u, p) = \int Ψ(u) + p\, (J - 1) - \frac{p^2}{2 κ}\, \mathrm dX

is stationary in p. Without ``condense=p`` the pressure keeps its value, zero at first, so nothing
resists a change of volume. A scalar Function p that is neither an unknown nor condensed counts as
such a pressure if both conditions hold:

- :math:`∂Π/∂p` depends on u, so that p exerts a force.
- :math:`∂^2Π/∂p^2`, called the curvature here, is negative and does not depend on u. Π then has a
  term in p alone. This term exerts no force, so it serves only the equation of p.

======================================================  ========================================
other Functions of an energy                            why they are no such pressures
======================================================  ========================================
moduli, loads, active tensions                          the curvature is zero
eigenstrain, as α T in (ε − α T I) : C : (ε − α T I)    the curvature is positive
histories of a material                                 the curvature is positive
damage                                                  the curvature depends on u
======================================================  ========================================

In a three-field energy :math:`U(θ) + p\, (J - θ)` the curvature in p is zero. There the dilation θ
has the term without u, and p multiplies it.

Residuals are not searched: in a residual, p cof F : Grad v may be the pressure of a fluid in pores,
which is data of the problem.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl
from ufl.algorithms import expand_derivatives
from ufl.classes import CoefficientDerivative

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.user_forms.checks import shares_no_dofs
from dolfinx_feti.runtime.collective import on_all, warn

#: A curvature along the constant 1 counts as negative if it exceeds this share of the curvature
#: along a random field. A rounding margin: the integrals have errors of some 1e-14.
CURVATURE_RTOL = 1e-8

Function = dolfinx.fem.Function


@dataclass(frozen=True, slots=True)
class ForgottenPressure:
    """A pressure in an energy that is neither an unknown nor condensed.

    Attributes:
        p: The pressure.
        dilation: Dilation θ that p multiplies in a three-field energy; None without one.
    """

    p: Function
    dilation: Function | None = None

    @property
    def fields(self) -> list[Function]:
        """The fields to condense: θ, if there is one, then p."""
        return [self.p] if self.dilation is None else [self.dilation, self.p]


def check_pressures(
    F: ufl.Form | Sequence[ufl.Form],
    energy: ufl.Form | None,
    u: Function,
    condensed: Collection[Function],
    changing: Collection[Function],
    compiler: Compiler,
) -> None:
    """Check that no pressure of an energy is neither condensed nor an unknown. Collective.

    A discontinuous pressure that is zero is an error, as it has no effect. Another value may be
    meant as data, and a continuous field cannot be condensed: these cause warnings.

    Args:
        F: An energy, a residual, or several of them.
        energy: Potential of the residuals, or None.
        u: The unknown.
        condensed: Condensed fields. An energy without one of them is not searched:
            :class:`~dolfinx_feti.fem.condensation.condensation.Condensation` raises an error.
        changing: Functions that the user or the package changes between solves, such as internal
            variables.
        compiler: Compiler of the problem.

    Raises:
        ValueError: A discontinuous pressure is zero.
    """
    comm = u.function_space.mesh.comm
    for potential in _energies(F, energy, u):
        if not set(condensed).issubset(potential.coefficients()):
            continue
        for pressure in _pressures(potential, u, {*condensed, *changing}, compiler):
            p = pressure.p
            names = [f.name for f in pressure.fields]
            argument = names[0] if len(names) == 1 else f"[{', '.join(names)}]"
            quoted = " and ".join(f"'{name}'" for name in names)
            text = (
                f"The energy has the Function {quoted} as a pressure, as in p*(J - 1) - "
                f"p**2/(2*kappa), but it is no unknown: nothing changes it. Pass "
                f"condense={argument} beside the unknown '{u.name}'; if it is data, leave out its "
                f"term without '{u.name}', which has no effect."
            )
            if not shares_no_dofs(p.function_space):
                warn(
                    f"{text} Only a discontinuous field, such as one in ('DG', 0), can be "
                    "condensed.",
                    comm,
                )
            elif _is_zero(p):
                raise ValueError(text)
            else:
                warn(text, comm)


def _energies(
    F: ufl.Form | Sequence[ufl.Form], energy: ufl.Form | None, u: Function
) -> list[ufl.Form]:
    """Return the energies among the forms, and those whose derivative in u is a residual.

    A residual that is written as ``ufl.derivative(Π, u, v)`` contains Π until UFL expands it, in a
    node of UFL's class CoefficientDerivative. If another version of UFL has no such nodes, the
    energies of residuals are not searched.

    Args:
        F: An energy, a residual, or several of them.
        energy: Potential of the residuals, or None.
        u: The unknown.
    """
    energies = [] if energy is None else [energy]
    forms = [F] if isinstance(F, ufl.Form) else F
    for form in forms:
        if not form.arguments():
            energies.append(form)
            continue
        densities = []
        for integral in form.integrals():
            integrand = integral.integrand()
            if isinstance(integrand, CoefficientDerivative):
                density, varied, *_ = integrand.ufl_operands
                if u in varied.ufl_operands:
                    densities.append(integral.reconstruct(integrand=density))
        if densities:
            energies.append(ufl.Form(densities))
    return energies


def _pressures(
    potential: ufl.Form, u: Function, excluded: Collection[object], compiler: Compiler
) -> list[ForgottenPressure]:
    """Return the forgotten pressures of an energy. Collective.

    Args:
        potential: The energy.
        u: The unknown.
        excluded: Functions that are condensed, or change between solves.
        compiler: Compiler of the problem.
    """
    gradients: dict[Function, ufl.Form] = {}  # derivative of the energy in each scalar function
    for f in potential.coefficients():
        if isinstance(f, Function) and f is not u and f not in excluded and not f.ufl_shape:
            test = ufl.TestFunction(f.function_space)
            gradient = expand_derivatives(ufl.derivative(potential, f, test))
            if not gradient.empty():
                gradients[f] = gradient
    pressures = []
    for p, gradient in gradients.items():
        if u not in gradient.coefficients():
            continue
        curvature = _curvature(gradient, p)
        if curvature.empty():  # linear in p: a multiplier, perhaps of a dilation
            for θ, gradient_in_θ in gradients.items():
                if θ in gradient.coefficients() and _is_nonlinear_without_u(gradient_in_θ, θ, u):
                    pressures.append(ForgottenPressure(p, θ))
        elif u not in curvature.coefficients() and _is_negative(curvature, p, compiler):
            pressures.append(ForgottenPressure(p))
    return pressures


def _curvature(gradient: ufl.Form, f: Function) -> ufl.Form:
    """Return the second derivative of an energy in f, from its first derivative."""
    return expand_derivatives(ufl.derivative(gradient, f, ufl.TrialFunction(f.function_space)))


def _is_nonlinear_without_u(gradient: ufl.Form, f: Function, u: Function) -> bool:
    """Return True if the derivative of an energy in f depends on f and not on u."""
    return u not in gradient.coefficients() and not _curvature(gradient, f).empty()


def _is_negative(curvature: ufl.Form, p: Function, compiler: Compiler) -> bool:
    """Return True if the curvature of an energy along a constant field is negative. Collective.

    The size of the curvature is measured along a random field. A dof that two processes share has
    two random values, which does not matter for a size.
    """
    Q = p.function_space
    one = Function(Q)
    one.x.array[:] = 1.0
    random = Function(Q)
    random.x.array[:] = np.random.default_rng(0).standard_normal(len(random.x.array))

    def along(w: Function) -> float:
        return _integral_over_all(ufl.action(ufl.action(curvature, w), w), compiler)

    return along(one) < -CURVATURE_RTOL * abs(along(random))


def _integral_over_all(functional: ufl.Form, compiler: Compiler) -> float:
    """Return the integral over all processes of a form without arguments. Collective."""
    compiled = compiler.form(functional)
    value = on_all(lambda: dolfinx.fem.assemble_scalar(compiled), compiler.comm)
    return float(compiler.comm.allreduce(value, op=MPI.SUM))


def _is_zero(p: Function) -> bool:
    """Return True if a field is zero everywhere. Collective."""
    largest = np.abs(p.x.array).max(initial=0.0)
    return bool(p.function_space.mesh.comm.allreduce(largest, op=MPI.MAX) == 0.0)
