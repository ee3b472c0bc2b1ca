# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Which of several unknowns is torn: the only one whose dofs cells share.

Unknowns whose dofs no two cells share are condensed; those on real spaces are scalars.
"""

from __future__ import annotations

from collections.abc import Sequence

import dolfinx

from dolfinx_feti.fem.user_forms.checks import shares_no_dofs
from dolfinx_feti.problems.unknowns.alternatives import (
    FLUX_SPACES,
    alternative_for,
    has_interior_facets,
)
from dolfinx_feti.scalars.real_spaces import is_real


def torn_first(unknowns: Sequence[dolfinx.fem.Function], name: str, forms: object) -> list[int]:
    """Return the numbers of the unknowns that are no scalars, the torn one first.

    Args:
        unknowns: All unknowns.
        name: Name of the argument, for the message.
        forms: Forms of the problem, by which the message chooses its advice.

    Raises:
        ValueError: No unknown can be torn, or several.
    """
    numbers = [i for i, w in enumerate(unknowns) if not is_real(w.function_space)]
    spaces = [unknowns[i].function_space for i in numbers]
    torn = numbers[torn_unknown(spaces, name, forms)]
    return [torn, *(i for i in numbers if i != torn)]


def torn_unknown(spaces: Sequence[dolfinx.fem.FunctionSpace], name: str, forms: object) -> int:
    """Return the number of the unknown that is torn: the only one whose dofs cells share.

    Args:
        spaces: Spaces of the unknowns, without real ones.
        name: Name of the argument, for the message.
        forms: Forms of the problem, by which the message chooses its advice.

    Raises:
        ValueError: There is no such unknown, or there are several.
    """
    if not spaces:
        raise ValueError(
            f"{name} holds only scalars on real spaces: give a continuous unknown as well."
        )
    if len(spaces) == 1:
        return 0
    shared = [i for i, V in enumerate(spaces) if not shares_no_dofs(V)]
    if not shared:  # a mesh of one cell, which shares no dofs with others: its element decides
        shared = [i for i, V in enumerate(spaces) if _is_continuous(V)]
    has_flux = any(V.ufl_element().basix_sobolev_space in FLUX_SPACES for V in spaces)
    # jumps of a discontinuous vector, as of cohesive zones, couple the cells that would condense it
    has_vectors = any(V.dofmap.bs > 1 and shares_no_dofs(V) for V in spaces)
    has_jumps = has_vectors and has_interior_facets(forms)
    if len(shared) != 1 or has_flux or has_jumps:
        raise ValueError(f"{name} is a block of {len(spaces)}{alternative_for(spaces, forms)}")
    return shared[0]


def _is_continuous(V: dolfinx.fem.FunctionSpace) -> bool:
    """Return True if the element of a space is continuous."""
    element = V.ufl_element()
    return not element.discontinuous and element.basix_sobolev_space.name == "H1"


def coupling_message(name: str, field: dolfinx.fem.Function, scalar: dolfinx.fem.Function) -> str:
    """Return the message for a condensed field and a scalar in one block.

    Args:
        name: The argument with the block, a or J.
        field: The condensed field.
        scalar: The scalar.
    """
    return (
        f"{name} couples the condensed field '{field.name}' and the scalar '{scalar.name}' on a "
        "real space: each cell eliminates its fields alone. State the equation in u, such as κ div "
        "u for a pressure."
    )
