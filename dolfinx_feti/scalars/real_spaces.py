# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Scalars stated on a real space: F_s tested in it, s a Function on it; as scifem makes them.

A real space has one dof for each component, on all processes. Its Functions become constants, and
a residual tested in it one form for each component.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.scalars.equations import ScalarEquation

__all__ = ["is_real_function", "separated", "separated_linear"]


def is_real_function(s: object) -> bool:
    """Tell whether something is a Function on a real space."""
    return isinstance(s, dolfinx.fem.Function) and is_real(s.function_space)


def is_real(V: dolfinx.fem.FunctionSpace) -> bool:
    """Tell whether a space holds one number for each component."""
    dofmap = V.dofmap
    cells = V.mesh.topology.index_map(V.mesh.topology.dim).size_global
    return cells > 1 and dofmap.index_map.size_global == 1 and dofmap.dof_layout.num_dofs == 1


def separated(
    F: ufl.Form | Sequence[ufl.Form], u: dolfinx.fem.Function | Sequence[dolfinx.fem.Function]
) -> tuple[ufl.Form | Sequence[ufl.Form], Any, list[ScalarEquation]]:
    """Take the scalars out of a problem that is stated in blocks; leave another one alone.

    F are residuals tested with v and, for each s, in its real space; or a Lagrangian in u and s.
    Returns F in constants, the unknown, and the equations of the scalars.
    """
    if not isinstance(u, Sequence) or not any(map(is_real_function, u)):
        return F, u, []
    scalars = [s for s in u if is_real(s.function_space)]
    others = [w for w in u if not is_real(w.function_space)]
    if len(others) != 1:
        raise ValueError(
            f"u holds {len(others)} unknowns beside {len(scalars)} scalars on real spaces: give "
            "one, and condense discontinuous fields by condense=."
        )
    constants = [_constant(s) for s in scalars]
    in_constants = dict(zip(scalars, constants, strict=True))
    if isinstance(F, ufl.Form):
        energy = ufl.replace(F, in_constants)
        v = ufl.TestFunction(others[0].function_space)
        blocks = [ufl.derivative(F, s, ufl.TestFunction(s.function_space)) for s in scalars]
        rest: ufl.Form | list[ufl.Form] = ufl.derivative(energy, others[0], v)
    else:
        forms = [ufl.replace(form, in_constants) for form in F]
        blocks = [form for form in forms if is_real(_space(form))]
        rest = [form for form in forms if not is_real(_space(form))]
        rest = rest[0] if len(rest) == 1 else rest
    equations = []
    for s, constant in in_constants.items():
        own = [form for form in blocks if _space(form) == s.function_space]
        if len(own) > 1 and len(blocks) == len(scalars):  # several scalars on one space
            own = [blocks[scalars.index(s)]]
        if len(own) != 1:
            raise ValueError(
                f"The scalar '{s.name}' has {len(own)} residuals: give one, tested in its space."
            )
        (test,) = own[0].arguments()
        n = s.ufl_shape
        units = [ufl.unit_vector(i, n[0]) for i in range(n[0])] if n else [ufl.as_ufl(1.0)]
        tested = (ufl.replace(own[0], {test: e, **in_constants}) for e in units)
        equations.append(ScalarEquation(constant, tuple(tested), mirror=s))
    return rest, others[0], equations


def separated_linear(
    a: ufl.Form | Sequence[Sequence[ufl.Form | None]],
    L: ufl.Form | Sequence[ufl.Form | None],
    u: Sequence[dolfinx.fem.Function],
    condensed: Sequence[dolfinx.fem.Function] = (),
) -> tuple[ufl.Form, ufl.Form, dolfinx.fem.Function, list[ScalarEquation]]:
    """Take the scalars out of a linear problem that is stated in blocks, a row for each of u.

    Returns a and L of the unknown, the unknown, and the equations of the scalars. Nothing may be
    condensed: blocks of three kinds have no order.
    """
    if condensed:
        raise ValueError(
            "u holds scalars on real spaces, and condense is given: give the scalars by scalars=, "
            "with a and L the blocks of u and the condensed fields."
        )
    if not isinstance(a, Sequence) or not isinstance(L, Sequence):
        raise ValueError(
            "u holds scalars on real spaces, but a and L are not blocks: give a as "
            "[[a_uu, a_us], [a_su, a_ss]] and L as [L_u, L_s]."
        )
    (k, *others) = [i for i, w in enumerate(u) if not is_real_function(w)] or [0]
    a_uu = a[k][k]
    if others or a_uu is None or len(a) != len(u) or len(L) != len(u):
        raise ValueError(
            f"a has {len(a)} rows, L {len(L)} and u {len(u)} parts: give one unknown, scalars on "
            "real spaces, and as many rows."
        )

    def acting(row: Sequence[ufl.Form | None]) -> list[ufl.Form]:
        pairs = [(form, w) for form, w in zip(row, u, strict=True) if form is not None]
        return [ufl.replace(form, {form.arguments()[1]: w}) for form, w in pairs]

    residuals = [sum(acting(row), ufl.Form([])) - f for row, f in zip(a, L, strict=True)]
    work = acting([None if j == k else form for j, form in enumerate(a[k])])
    first, *equations = separated(residuals, u)[2]
    in_constants = {e.mirror: e.unknown for e in (first, *equations)}
    whole = ufl.replace(sum(work, ufl.Form([])), in_constants)
    return a_uu, L[k], u[k], [replace(first, work=whole), *equations]


def _space(form: ufl.Form) -> dolfinx.fem.FunctionSpace:
    """Return the space that a residual is tested in."""
    arguments = form.arguments()
    if len(arguments) != 1:
        raise ValueError(f"F holds a form with {len(arguments)} arguments: give residuals.")
    return arguments[0].ufl_function_space()


def _constant(s: dolfinx.fem.Function) -> dolfinx.fem.Constant:
    """Return a constant of the shape and with the values of a Function on a real space."""
    s.x.scatter_forward()
    return dolfinx.fem.Constant(s.function_space.mesh, np.reshape(s.x.array.copy(), s.ufl_shape))
