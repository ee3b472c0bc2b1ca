# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Scalars on real spaces (scifem), replaced by constants with an equation for each component.

A real space has one number for each component of its functions. A scalar on it is replaced by a
constant with the same values, and a residual tested in it by a form without arguments for each
component: the equations of a :class:`~dolfinx_feti.scalars.equations.ScalarEquation`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.scalars.equations import ScalarEquation

__all__ = ["constant_of", "is_real", "separate_scalars", "unit_values"]


def is_real(V: dolfinx.fem.FunctionSpace) -> bool:
    """Return True if a space has one number for each component, on all processes together.

    In a mesh of one cell, piecewise constants have one as well: no space counts as real there.
    """
    dofmap = V.dofmap
    cells = V.mesh.topology.index_map(V.mesh.topology.dim).size_global
    return cells > 1 and dofmap.index_map.size_global == 1 and dofmap.dof_layout.num_dofs == 1


def constant_of(s: dolfinx.fem.Function) -> dolfinx.fem.Constant:
    """Return a constant of the shape and with the values of a Function on a real space."""
    s.x.scatter_forward()
    return dolfinx.fem.Constant(s.function_space.mesh, np.reshape(s.x.array.copy(), s.ufl_shape))


def unit_values(shape: tuple[int, ...]) -> list[Expr]:
    """Return the unit vectors of a shape (m,), m of them; for a scalar, one."""
    if not shape:
        return [ufl.as_ufl(1.0)]
    return [ufl.unit_vector(k, shape[0]) for k in range(shape[0])]


def separate_scalars(
    F: ufl.Form | Sequence[ufl.Form], unknowns: Sequence[dolfinx.fem.Function]
) -> tuple[list[ufl.Form], dict[dolfinx.fem.Function, dolfinx.fem.Constant], list[ScalarEquation]]:
    """Separate the scalars on real spaces from a problem in blocks.

    Args:
        F: Residuals in the order of the unknowns, or a Lagrangian in all unknowns. Residuals tested
            in real spaces may be at any position; those of one real space are in the order of its
            scalars.
        unknowns: The unknowns, some of them on real spaces.

    Returns:
        The other residuals, with constants in place of the scalars; the constant of each scalar;
        and the equations of the scalars.

    Raises:
        ValueError: The residuals do not fit the scalars.
    """
    scalars = [w for w in unknowns if is_real(w.function_space)]
    if isinstance(F, ufl.Form):
        F = [ufl.derivative(F, w, ufl.TestFunction(w.function_space)) for w in unknowns]
    constants = {s: constant_of(s) for s in scalars}
    forms = [ufl.replace(form, constants) for form in F]
    if any(len(form.arguments()) != 1 for form in forms):
        raise ValueError("F has a form without or with several test functions: give residuals.")
    of_fields = [form for form in forms if not is_real(_test_space(form))]
    of_scalars = [form for form in forms if is_real(_test_space(form))]
    if len(of_scalars) != len(scalars):
        raise ValueError(
            f"F has {len(of_scalars)} residuals tested in real spaces for {len(scalars)} "
            "scalars: give one for each."
        )
    spaces = [s.function_space for s in scalars]
    equations = []
    for i, (s, constant) in enumerate(constants.items()):
        V = s.function_space
        residuals = [form for form in of_scalars if _test_space(form) == V]
        if len(residuals) != spaces.count(V):
            raise ValueError(
                f"F has {len(residuals)} residuals tested in the space of the scalar '{s.name}', "
                f"but {spaces.count(V)} scalars are on it: test that of each scalar in its space."
            )
        residual = residuals[spaces[:i].count(V)]  # the k-th scalar on V has the k-th residual
        (v,) = residual.arguments()
        c = tuple(ufl.replace(residual, {v: unit}) for unit in unit_values(s.ufl_shape))
        equations.append(ScalarEquation(constant, c, mirror=s))
    return of_fields, constants, equations


def _test_space(form: ufl.Form) -> dolfinx.fem.FunctionSpace:
    """Return the space of the test function of a residual."""
    return form.arguments()[0].ufl_function_space()
