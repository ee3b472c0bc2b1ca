# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Energies, compiled with their first and second derivatives and evaluated at many states at once.

    Ψ(F),   P = ∂Ψ/∂F,   A = ∂²Ψ/∂F∂F,   A_iJkL = ∂P_iJ/∂F_kL

F is a Function on a quadrature element whose points are the states: the tangents at 64 states take
0.1 ms. Nothing here is parallel: every process does the same work.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix.ufl
import dolfinx
import ufl
from ufl.core.expr import Expr
from ufl.corealg.traversal import unique_pre_traversal
from ufl.variable import Label, Variable

from dolfinx_feti.mechanics.kinematics import jacobian, right_cauchy_green
from dolfinx_feti.mechanics.materials import volumetric
from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.runtime.values import require_type, require_within

__all__ = ["CompiledEnergy", "Material", "States", "compile_material", "evaluate"]

#: States per call of the generated code. A choice: larger batches gain little per state.
BATCH = 64

#: Arguments of an energy.
MEASURES = ("F", "C", "J")

#: Label of the variable F. Labels counted by UFL would change the signature of an energy, so that
#: it is compiled again.
LABEL = Label(-1)


@dataclass(frozen=True, slots=True)
class States:
    """An energy and its derivatives at n states."""

    F: Array  #: Deformation gradients, (n, 3, 3)
    psi: Array  #: Energies per unit reference volume [kPa], (n,)
    P: Array  #: First Piola stresses ∂Ψ/∂F [kPa], (n, 3, 3)
    A: Array  #: Tangents ∂²Ψ/∂F∂F [kPa], (n, 3, 3, 3, 3)

    @property
    def finite(self) -> Mask:
        """Whether all values of a state are finite, (n,)."""
        values = [a.reshape(len(self.F), -1) for a in (self.psi, self.P, self.A)]
        return np.logical_and.reduce(np.isfinite(np.hstack(values)), axis=1)


class CompiledEnergy:
    """Generated code of an energy, with a Function for the states and Constants for parameters."""

    def __init__(
        self,
        psi: Callable[..., Expr],
        parameters: Sequence[str] = (),
        jit_options: Mapping[str, Any] | None = None,
    ) -> None:
        """Compile an energy.

        Args:
            psi: The energy, see :func:`compile_material`.
            parameters: Names of its parameters.
            jit_options: Options of dolfinx's compiler.
        """
        mesh = dolfinx.mesh.create_interval(MPI.COMM_SELF, 1, (0.0, 1.0))
        points = np.linspace(0.0, 1.0, BATCH)[:, None]
        element = basix.ufl.quadrature_element(
            "interval", value_shape=(3, 3), points=points, weights=np.full(BATCH, 1 / BATCH)
        )
        self.parameters = tuple(parameters)
        self._mesh = mesh
        self._F = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element))
        self._kappa = dolfinx.fem.Constant(mesh, np.float64(0.0))
        self._values = {name: dolfinx.fem.Constant(mesh, np.float64(1.0)) for name in parameters}
        F = Variable(self._F, LABEL)
        energy = _call(psi, F, self._values)
        _check_energy(energy, F, self._values)
        constants = ufl.algorithms.analysis.extract_constants(energy)
        of_user = [c for c in constants if c not in self._values.values()]
        self._copies = {c: dolfinx.fem.Constant(mesh, c.value) for c in of_user}
        energy = ufl.replace(energy, self._copies) + volumetric(jacobian(F), self._kappa)
        P = ufl.diff(energy, F)
        options = {"cffi_extra_compile_args": ["-O1"], **(jit_options or {})}
        self._expressions = [
            dolfinx.fem.Expression(e, points, jit_options=options)
            for e in (energy, P, ufl.diff(P, F))
        ]

    def __call__(self, F: Array, kappa: float, parameters: Mapping[str, float]) -> States:
        """Evaluate at the states F, (n, 3, 3), with a finite κ; see :func:`evaluate`."""
        self._kappa.value = kappa
        for name, constant in self._values.items():
            constant.value = parameters[name]
        for of_user, copy in self._copies.items():
            copy.value = of_user.value
        batches = [self._batch(F[i : i + BATCH]) for i in range(0, len(F), BATCH)]
        psi, P, A = (np.concatenate(parts) for parts in zip(*batches, strict=True))
        return States(F, psi, P, A)

    def _batch(self, F: Array) -> list[Array]:
        """Return Ψ, P and A at up to BATCH states; NaN if F is not finite.

        Such an F is replaced by I for the evaluation: the generated code would spread its NaN to
        all states.
        """
        states = np.tile(np.eye(3), (BATCH, 1, 1))
        is_finite = np.isfinite(F).all(axis=(1, 2))
        states[: len(F)][is_finite] = F[is_finite]
        self._F.x.array[:] = states.ravel()
        cell = np.zeros(1, dtype=np.int32)
        parts = []
        for rank, expression in zip((0, 2, 4), self._expressions, strict=True):
            values = np.array(expression.eval(self._mesh, cell)).reshape(BATCH, *(3,) * rank)
            values[: len(F)][~is_finite] = np.nan
            parts.append(values[: len(F)])
        return parts


@dataclass(frozen=True, slots=True)
class Material:
    """A compiled energy, how compressible it is, and the values of its parameters."""

    energy: CompiledEnergy  #: The generated code
    kappa: float = math.inf  #: Penalty κ [kPa], see :func:`compile_material`
    parameters: Mapping[str, float] = field(default_factory=dict)  #: Values by name

    def __post_init__(self) -> None:
        """Check the values."""
        if math.isnan(self.kappa) or self.kappa < 0:
            raise ValueError(
                f"kappa = {self.kappa}: give a penalty in kPa, math.inf for an incompressible "
                "material, or 0 for an energy that is complete in itself."
            )
        if set(self.parameters) != set(self.energy.parameters):
            raise ValueError(
                f"parameters = {dict(self.parameters)}: the energy was compiled with the "
                f"parameters {list(self.energy.parameters)}; give a value for each of them."
            )
        require_within(-math.inf, math.inf, self.parameters, remedy="a finite value")

    @property
    def incompressible(self) -> bool:
        """Whether J = 1 is a constraint, with the pressure as its multiplier."""
        return math.isinf(self.kappa)

    def with_parameters(self, **parameters: float) -> Material:
        """Return the material with other values of parameters, without compilation."""
        return replace(self, parameters={**self.parameters, **parameters})


def compile_material(
    psi: Callable[..., Expr],
    *,
    kappa: float = math.inf,
    parameters: Mapping[str, float] | None = None,
    jit_options: Mapping[str, Any] | None = None,
) -> Material:
    """Compile an energy with its first and second derivatives (docs/workshop.md).

    Args:
        psi: Energy per unit reference volume [kPa], a function of ``C`` and ``J``, or of ``F``, by
            these names, that returns a UFL expression. Other data are part of the function:
            numbers, fibres as ``ufl.as_vector``, or dolfinx Constants with their current values.
        kappa: Penalty κ [kPa] of κ/2 (J − 1)², which is added: ``math.inf`` makes the material
            incompressible, 0 adds nothing to an energy that is complete.
        parameters: Further arguments of ``psi``, which change without compilation, and their
            values.
        jit_options: Options of dolfinx's compiler; by default ``-O1``.

    Raises:
        TypeError: ``psi`` has other arguments, or does not return a UFL expression.
        ValueError: The energy is not a scalar, does not depend on the deformation, or depends on a
            field; or ``kappa`` is negative or NaN, or a parameter is not finite.
    """
    if not callable(psi):
        raise TypeError(f"psi is {psi!r}: give Callable, a function of C and J, or of F.")
    parameters = dict(parameters or {})
    return Material(CompiledEnergy(psi, tuple(parameters), jit_options), kappa, parameters)


def evaluate(material: Material, F: npt.ArrayLike) -> States:
    """Evaluate an energy with its volumetric part, if κ is finite, at several states.

    The pressure of an incompressible material is not included.

    Args:
        material: The material.
        F: Deformation gradients, (n, 3, 3) or (3, 3).

    Returns:
        The states; values outside the domain of the energy, such as J ≤ 0, are not finite.

    Raises:
        ValueError: F has another shape.
    """
    require_type(Material, material=material)
    F = np.array(F, dtype=np.float64)
    if F.shape[-2:] != (3, 3) or F.ndim not in (2, 3) or F.size == 0:
        raise ValueError(f"F has the shape {F.shape}: give (n, 3, 3), with n ≥ 1, or (3, 3).")
    kappa = 0.0 if material.incompressible else material.kappa
    return material.energy(F.reshape(-1, 3, 3), kappa, material.parameters)


def _call(psi: Callable[..., Expr], F: Variable, parameters: Mapping[str, Expr]) -> Expr:
    """Call psi with those of F, C and J that it has as arguments, and with the parameters.

    Raises:
        TypeError: It has other arguments.
    """
    measures = dict(zip(MEASURES, (F, right_cauchy_green(F), jacobian(F)), strict=True))
    signature = inspect.signature(psi)
    arguments = {name: measures[name] for name in MEASURES if name in signature.parameters}
    try:
        signature.bind(**arguments, **parameters)
    except TypeError as error:
        raise TypeError(
            f"psi{signature}: {error}. Name the arguments C and J, or F; bind others with "
            "functools.partial, or give them as parameters."
        ) from error
    return psi(**arguments, **parameters)


def _check_energy(psi: object, F: Variable, parameters: Mapping[str, Expr]) -> None:
    """Raise an error unless an energy is a scalar expression of F and of constants with values.

    Args:
        psi: The energy.
        F: The deformation gradient.
        parameters: Its parameters by name.

    Raises:
        TypeError: The energy is not a UFL expression.
        ValueError: It is not a scalar, or depends on something else.
    """
    if not isinstance(psi, Expr):
        raise TypeError(f"psi returns {psi!r}: return a UFL expression of C and J, or of F.")
    if psi.ufl_shape:
        raise ValueError(
            f"psi has the shape {psi.ufl_shape}: an energy is a scalar, such as ufl.tr(C)."
        )
    terminals = list(unique_pre_traversal(psi))
    if F not in terminals:
        raise ValueError(
            "psi does not depend on the deformation, so its stress would be zero: write it in its "
            "arguments C and J, or F."
        )
    unused = [name for name, constant in parameters.items() if constant not in terminals]
    if unused:
        raise ValueError(
            f"psi does not depend on its parameters {unused}: use them, or leave them out."
        )
    for e in terminals:
        other = isinstance(e, ufl.Coefficient) and e is not F.ufl_operands[0]
        if other or isinstance(e, (ufl.Argument, ufl.geometry.GeometricQuantity)):
            raise ValueError(
                f"psi depends on {e}, which varies in space: bind its value at one point, a number "
                "or ufl.as_vector."
            )
        if isinstance(e, ufl.Constant) and not hasattr(e, "value"):
            raise ValueError(f"psi depends on {e}, which has no value: use dolfinx.fem.Constant.")
