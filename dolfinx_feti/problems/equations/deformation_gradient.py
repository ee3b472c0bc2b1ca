# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The deformation gradient F = I + c Grad u of a problem: its det F, and the lengths in it.

c is 1 for a displacement u and Δt for a velocity (``fem.user_forms.deformation.GradientFactor``).
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

import dolfinx

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.decomposition import TornSpace, cell_sizes
from dolfinx_feti.fem.quadrature import quadrature_points
from dolfinx_feti.fem.user_forms.deformation import GradientFactor, VolumeRatio
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all


class DeformationGradient:
    """The deformation gradient and the volume ratio that every iterate keeps positive.

    The ratio is det F, or another expression that the user has given by ``volume_ratio=``. If that
    expression contains an F, the factor c is taken from it.
    """

    def __init__(
        self, ratio: VolumeRatio, space: TornSpace, *, quadrature_degree: int, compiler: Compiler
    ) -> None:
        """Compile the volume ratio. Collective.

        Args:
            ratio: The volume ratio in UFL.
            space: Space of u and its torn counterpart.
            quadrature_degree: Of the rule at whose points det F is evaluated.
            compiler: Compiles the expression.
        """
        mesh = space.V.mesh
        self._mesh = mesh
        self._space = space
        self._n_cells = mesh.topology.index_map(mesh.topology.dim).size_local
        points = quadrature_points(mesh, quadrature_degree)
        self._det_F: dolfinx.fem.Expression = compiler.expression(ratio.of_body, points)
        self._factor = GradientFactor(ratio)

    def smallest_volume_ratio(self) -> float:
        """Return the smallest det F over all quadrature points, −∞ if one is NaN. Collective."""
        comm = self._mesh.comm
        return float(comm.allreduce(on_all(self._smallest_on_process, comm), op=MPI.MIN))

    def _smallest_on_process(self) -> float:
        """Return the smallest det F over the quadrature points of this process."""
        if not self._n_cells:
            return np.inf
        cells = np.arange(self._n_cells, dtype=np.int32)
        values = self._det_F.eval(self._mesh, cells)
        return float(values.min()) if np.all(np.isfinite(values)) else -np.inf

    def lengths(self) -> Array:
        """Return h/c at each torn dof, (n,): the size of u at which c Grad u is of the size of I.

        h is the largest diameter of a cell around the dof. Both are computed anew, because mesh
        and c may have changed.
        """
        h = cell_sizes(self._space)
        return np.asarray(h / self._factor.value())
