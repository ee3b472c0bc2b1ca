# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Mixed elements with one part, ``basix.ufl.mixed_element([e])``: the part is torn.

Programs for any number of fields create them. Forms are rewritten in the only part u of the user's
Function w. Dirichlet conditions stay on the mixed space: their dofs and values are translated.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.runtime.arrays import Array, Indices, Mask


def is_mixed_of_one(V: dolfinx.fem.FunctionSpace) -> bool:
    """Return True for a space of ``basix.ufl.mixed_element([e])``."""
    element = V.ufl_element()
    return len(element.sub_elements) == 1 and getattr(element, "block_size", 1) == 1


class MixedOfOne:
    """The only part u of a user's Function w on a mixed space.

    Attributes:
        w: The user's Function.
        u: The part, with a copy of the values.
    """

    def __init__(self, w: dolfinx.fem.Function) -> None:
        """Create u with the values of w. Collective."""
        self.w = w
        W = w.function_space
        V, dofs = W.sub(0).collapse()
        self.u = dolfinx.fem.Function(V, name=w.name)
        #: Dof of w of each dof of u; dolfinx 0.11 returns an array for each type of cells.
        self._dofs: Indices = np.asarray(dofs, dtype=np.int32).ravel()
        self._owned = self._dofs[: V.dofmap.index_map.size_local * V.dofmap.index_map_bs]
        self.read()

    def read(self) -> None:
        """Copy the values of w into u."""
        self.u.x.array[:] = self.w.x.array[self._dofs]

    def write(self) -> None:
        """Copy the values of u into w."""
        self.w.x.array[self._dofs] = self.u.x.array

    def rewrite(self, forms: Any) -> Any:
        """Return forms, in sequences or not, with w and its arguments replaced by those of u."""
        if isinstance(forms, list | tuple):
            return [self.rewrite(form) for form in forms]
        if not isinstance(forms, ufl.Form):
            return forms
        W = self.w.function_space
        V = self.u.function_space
        replaced: dict[Expr, Expr] = {self.w: _as_mixed(self.u)}
        for v in forms.arguments():
            if v.ufl_function_space() == W:
                replaced[v] = _as_mixed(ufl.Argument(V, v.number()))
        return ufl.replace(forms, replaced)

    def gap(self, bcs: Sequence[dolfinx.fem.DirichletBC]) -> Array:
        """Return u − g on the dofs of conditions on w, zero on others, (owned dofs of u,)."""
        dofmap = self.w.function_space.dofmap
        gap = np.zeros(dofmap.index_map.size_local * dofmap.index_map_bs)
        for bc in bcs:
            bc.set(gap, self.w.x.array, -1.0)  # −1 · (g − w)
        return np.asarray(gap[self._owned])

    def of_part(self, mask: Mask) -> Mask:
        """Return the entries of the owned dofs of u from a mask of the owned dofs of w."""
        return np.asarray(mask[self._owned])


def _as_mixed(f: Expr) -> Expr:
    """Return a function or an argument as a vector of its components."""
    if not f.ufl_shape:
        return ufl.as_vector([f])
    if len(f.ufl_shape) == 1:
        return f
    return ufl.as_vector([f[i] for i in np.ndindex(f.ufl_shape)])
