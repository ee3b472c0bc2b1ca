# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Alternatives to problems in several fields that cannot be torn, for error messages.

A continuous scalar together with a vector is a pressure only if no form contains its gradient. A
scalar with a gradient, such as a temperature, has a differential equation.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

import basix
import dolfinx
import ufl
from ufl import classes
from ufl.corealg.traversal import unique_pre_traversal
from ufl.finiteelement import AbstractFiniteElement

from dolfinx_feti.runtime.arrays import Integers

#: Spaces of vectors of which only normal or tangential components are continuous.
FLUX_SPACES = {basix.SobolevSpace.HDiv, basix.SobolevSpace.HCurl}

#: The first sentence of each message.
ONE_SPACE = "but only a problem on one continuous space is torn"

# Parts of the messages: what helps, for each reason why a problem cannot be torn. For the reasons
# see ``alternative_for``.

MUMPS = "Solve it by dolfinx, with MUMPS or a field split"

PRESSURE = (
    "A pressure has to be discontinuous, such as ('DG', 0), ('DG', 1), or ('DPC', 1) on "
    "hexahedra, to be condensed cell by cell: NonlinearProblem([F_u, F_p], [u, p], bcs=bcs) or "
    "LinearProblem([[a_uu, a_up], [a_pu, a_pp]], [L_u, L_p], bcs=bcs), see docs/elements.md. "
    "Solve one that is continuous, as with Taylor and Hood's elements, by dolfinx, with MUMPS or "
    "a field split."
)

BLOCKS = (
    "Give each field a space of its own and pass blocks, NonlinearProblem([F_u, F_p], [u, p], "
    "bcs=bcs) or LinearProblem([[a_uu, a_up], [a_pu, a_pp]], [L_u, L_p], bcs=bcs): the "
    "discontinuous fields are condensed then, see docs/elements.md."
)

#: How several continuous fields fit into one space.
COMPONENTS = (
    "If all fields may have the same degree, make them components of one unknown in "
    "('Lagrange', k, (n,)), such as u = as_vector([w[0], w[1]]) and T = w[2], and describe rigid "
    "motions by near_null_space=: such a problem is torn, symmetric or not"
)

SCALAR_FIELD = (
    "The scalar has derivatives in the forms, as a temperature, a phase field or the deflection "
    "of a plate has: it is no pressure, and cannot be condensed. If one field does not depend on "
    "the other, or only weakly, solve two problems in turn, each with the other field as a "
    f"coefficient. {COMPONENTS}. Else solve it by dolfinx, with MUMPS or a field split."
)

SEVERAL_FIELDS = (
    f"{COMPONENTS}, as for displacement and rotation of beams and shells, or for several species. "
    f"{MUMPS} otherwise."
)

FLUX = (
    f"{MUMPS}; or, if the vector is a flux −k ∇p, solve −div(k ∇p) = f for p alone, in "
    "('Lagrange', k), and interpolate the flux."
)

JUMPS = (
    "Its integrals over interior facets (dS), such as those of cohesive zones or of discontinuous "
    f"Galerkin methods, couple the cells on both sides. {MUMPS}."
)

ALL_DISCONTINUOUS = (
    "All fields are discontinuous: each cell is solved alone, or jumps over facets, which cannot "
    f"be torn, couple them. {MUMPS}."
)


def alternative_for(
    parts: Sequence[dolfinx.fem.FunctionSpace | AbstractFiniteElement], forms: Any
) -> str:
    """Return the end of an error message: what can be torn, and how to solve this problem.

    It begins with a comma, as in "F is a block of 2, but only …".

    Args:
        parts: Spaces or elements of the fields.
        forms: Forms of the problem, in sequences or not; other objects are ignored.
    """
    elements = [
        part if isinstance(part, AbstractFiniteElement) else part.ufl_element() for part in parts
    ]
    discontinuous = [is_discontinuous(element) for element in elements]
    ranks = sorted(len(element.reference_value_shape) for element in elements)
    all_forms = list(all_forms_in(forms))
    scalars = [i for i, e in enumerate(elements) if e.reference_value_shape == ()]
    if has_interior_facets(all_forms):
        text = JUMPS
    elif any(element.basix_sobolev_space in FLUX_SPACES for element in elements):
        text = FLUX
    elif all(discontinuous):
        text = ALL_DISCONTINUOUS
    elif sum(discontinuous) == len(discontinuous) - 1:
        text = BLOCKS
    elif ranks == [0, 1]:
        has_gradient = differentiated(elements, all_forms).intersection(scalars)
        text = SCALAR_FIELD if has_gradient else PRESSURE
    else:
        text = SEVERAL_FIELDS
    return f", {ONE_SPACE}. {text}"


def is_discontinuous(element: AbstractFiniteElement) -> bool:
    """Return True if no two cells share a dof of this element, on any mesh.

    ``fem.user_forms.checks.shares_no_dofs`` looks at the dofs of a space, on its mesh.
    """
    return bool(element.discontinuous) or element.basix_sobolev_space == basix.SobolevSpace.L2


def has_interior_facets(forms: Any) -> bool:
    """Return True if one of the forms has integrals over interior facets."""
    integrals = (integral for form in all_forms_in(forms) for integral in form.integrals())
    return any(integral.integral_type() == "interior_facet" for integral in integrals)


def all_forms_in(forms: Any) -> Iterator[ufl.Form]:
    """Yield the forms in a form, a sequence of forms, or rows of them; skip other objects."""
    if isinstance(forms, ufl.Form):
        yield forms
    elif isinstance(forms, list | tuple):
        for form in forms:
            yield from all_forms_in(form)


def differentiated(
    elements: Sequence[AbstractFiniteElement], forms: Sequence[ufl.Form]
) -> set[int]:
    """Return the numbers of the fields, given by their elements, with a gradient in the forms."""
    sizes = [element.reference_value_size for element in elements]
    ends = np.cumsum(sizes)  # of the components of each field in a mixed element
    fields: set[int] = set()
    for form in forms:
        for integral in ufl.algorithms.expand_derivatives(form).integrals():
            for node in unique_pre_traversal(integral.integrand()):
                field = _field_of_gradient(node, elements, ends)
                if field is not None:
                    fields.add(field)
    return fields


def _field_of_gradient(
    node: Any, elements: Sequence[AbstractFiniteElement], ends: Integers
) -> int | None:
    """Return the number of the field whose gradient an expression is; None for other expressions.

    Args:
        node: Expression of UFL.
        elements: Element of each field.
        ends: End of the components of each field in a function with a mixed element, (fields,).
    """
    gradient = node
    component = None
    if isinstance(node, classes.Indexed):
        gradient, indices = node.ufl_operands
        component = indices.indices()[0]
    if not isinstance(gradient, classes.Grad):
        return None
    f = gradient
    while isinstance(f, classes.Grad):
        (f,) = f.ufl_operands
    if not isinstance(f, ufl.Coefficient | ufl.Argument):
        return None
    element = f.ufl_element()
    if element in elements:
        return elements.index(element)
    is_mixed = list(element.sub_elements) == list(elements)
    if is_mixed and isinstance(component, classes.FixedIndex):
        return int(np.searchsorted(ends, int(component), side="right"))
    return None
