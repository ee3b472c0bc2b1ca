# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A mixed element or a block form, which cannot be torn: the lines that take its place."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import basix
import dolfinx
import ufl
from ufl.finiteelement import AbstractFiniteElement

__all__ = ["refuse_blocks", "refuse_mixed_form", "refuse_mixed_space"]

#: Pressures that are condensed as they are.
DISCONTINUOUS: dict[object, str] = {basix.ElementFamily.P: "DG", basix.ElementFamily.DPC: "DPC"}

#: Spaces of fluxes and fields, whose parts are continuous across facets.
FLUXES = (basix.SobolevSpace.HDiv, basix.SobolevSpace.HCurl)

LINES = """\
    V = functionspace(mesh, ("Lagrange", {degree}, ({dim},)))
    Q = functionspace(mesh, {discontinuous})
    {u}, {p} = Function(V), Function(Q)
    v, q = TestFunction(V), TestFunction(Q)
    # F_u, F_p: the residuals, linear ones too, in these functions, tested with v and with q
    problem = NonlinearProblem([F_u, F_p], {u}, bcs=bcs, condense={p})
"""


def refuse_mixed_space(V: dolfinx.fem.FunctionSpace) -> None:
    """Refuse a mixed element.

    Args:
        V: The space of the unknown.

    Raises:
        TypeError: Its element is mixed.
    """
    element = V.ufl_element()
    parts = list(element.sub_elements)
    if parts and getattr(element, "block_size", 1) == 1:
        raise TypeError(f"The space has a mixed element of {len(parts)}{_instead(parts)}")


def refuse_mixed_form(name: str, form: ufl.Form) -> None:
    """Refuse a form on a ``ufl.MixedFunctionSpace``.

    Args:
        name: Of the argument.
        form: The form.

    Raises:
        ValueError: It has several test functions.
    """
    tests = [argument for argument in form.arguments() if argument.number() == 0]
    if len(tests) > 1:
        parts = [v.ufl_function_space().ufl_element() for v in tests]
        raise ValueError(f"{name} has {len(parts)} test functions{_instead(parts)}")


def refuse_blocks(name: str, given: object) -> None:
    """Refuse several forms or functions.

    Args:
        name: Of the argument.
        given: Its value.

    Raises:
        ValueError: It is a list.
    """
    if not isinstance(given, Sequence):
        return
    if len(given) == 1:
        raise ValueError(f"{name} is a list of one: take it out of the list.")
    if name == "J":
        raise ValueError("J is a block: give the derivative of F_u in u alone, or leave it out.")
    spaces = [next(_spaces(part), None) for part in given]
    parts = [space.ufl_element() for space in spaces if space is not None]
    names = [part.name for part in given if isinstance(part, dolfinx.fem.Function)]
    raise ValueError(f"{name} is a block of {len(given)}{_instead(parts, names)}")


def _spaces(part: object) -> Iterator[dolfinx.fem.FunctionSpace]:
    """Yield the spaces of functions, and of the test functions of forms, in a row of blocks."""
    if isinstance(part, dolfinx.fem.Function):
        yield part.function_space
    elif isinstance(part, ufl.Form):
        yield from (argument.ufl_function_space() for argument in part.arguments()[:1])
    elif isinstance(part, Sequence):
        for entry in part:
            yield from _spaces(entry)


def _instead(parts: Sequence[AbstractFiniteElement], names: Sequence[str] = ()) -> str:
    """Say what to do in place of a problem in several fields."""
    only = ", but only a problem on one continuous space is torn. "
    if any(part.basix_sobolev_space in FLUXES for part in parts):
        return (
            f"{only}Solve it by dolfinx, with MUMPS or a field split; or solve −div(k ∇p) = f for "
            "p alone, in ('Lagrange', k), and interpolate the flux −k ∇p."
        )
    vectors = [i for i, part in enumerate(parts) if len(part.reference_value_shape) == 1]
    if len(parts) != 2 or len(vectors) != 1 or parts[1 - vectors[0]].reference_value_shape:
        return f"{only}Solve it by dolfinx, with MUMPS or a field split."
    k = vectors[0]
    ours = len(set(names)) == 2 and all(name.isidentifier() for name in names)
    u, p = (names[k], names[1 - k]) if ours else ("u", "p")
    lines = LINES.format(
        u=u,
        p=p,
        degree=max(2, parts[k].embedded_subdegree),
        dim=parts[k].reference_value_shape[0],
        discontinuous=_discontinuous(parts[1 - k]),
    )
    return (
        f"{only}Condense a discontinuous pressure of an elastic solid:\n\n{lines}\n"
        f"F_p has to contain {p}, as in (J - 1 - {p}/kappa)*q, and bcs are conditions on V. The "
        "blocks of a linear problem are taken as they are, LinearProblem(a, L, bcs=bcs, "
        f"condense={p}). A pressure that is continuous, or has no term of its own, as in Stokes' "
        "equations, is solved by dolfinx, with MUMPS or a field split."
    )


def _discontinuous(pressure: AbstractFiniteElement) -> str:
    """Name the element of a pressure that is condensed: its own, or constants in each cell."""
    family = DISCONTINUOUS.get(getattr(pressure, "element_family", None))
    if family is None or not pressure.discontinuous:
        return '("DG", 0)'
    return f'("{family}", {pressure.embedded_subdegree})'
