# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The balance of energies of a motion: what is stored, and the work of external forces.

.. math:: T_{n+1} - T_n + Π_{n+1} - Π_n = W + O(Δt^3), \qquad
          W = ½\, (f_n + f_{n+1}) · (u_{n+1} - u_n),

with the kinetic energy T, the energy Π that the material stores, and external forces f.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl

from dolfinx_feti.fem.compiler import Compiler

__all__ = ["Energies", "create_energies"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Energies:
    """Compiled forms of the balance.

    Attributes:
        u: The displacement.
        energy: Π; None if it is not followed.
        forces: f, tested with v; None if they are not followed.
    """

    u: dolfinx.fem.Function
    energy: dolfinx.fem.Form | None
    forces: dolfinx.fem.Form | None

    def stored(self) -> float:
        """Return Π of the present state; NaN if it is not followed.

        Note:
            Collective.
        """
        if self.energy is None:
            return math.nan
        comm = self.u.function_space.mesh.comm
        return float(comm.allreduce(dolfinx.fem.assemble_scalar(self.energy)))

    def present_forces(self) -> Array:
        """Return f of the present state, (owned,); NaN if they are not followed.

        Note:
            Collective.
        """
        dofmap = self.u.function_space.dofmap
        f = dolfinx.la.vector(dofmap.index_map, dofmap.index_map_bs)
        owned = dofmap.index_map.size_local * dofmap.index_map_bs
        if self.forces is None:
            f.array[:] = math.nan
        else:
            dolfinx.fem.assemble_vector(f.array, self.forces)
            f.scatter_reverse(dolfinx.la.InsertMode.add)
        return np.asarray(f.array[:owned])

    def work(self, before: Array, moved: Array) -> float:
        """Return the work W of the forces in a step.

        Args:
            before: f at its beginning, (owned,).
            moved: u_{n+1} − u_n, with ghosts.

        Note:
            Collective.
        """
        f = self.present_forces()
        return float(
            self.u.function_space.mesh.comm.allreduce((before + f) @ moved[: len(f)] / 2.0)
        )


def create_energies(
    u: dolfinx.fem.Function, energy: ufl.Form | None, forces: ufl.Form | None
) -> Energies:
    """Compile the forms of the balance, those that there are.

    Note:
        Collective.
    """
    compiler = Compiler(u.function_space.mesh.comm)
    return Energies(u, *(None if f is None else compiler.form(f) for f in (energy, forces)))
