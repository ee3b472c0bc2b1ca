# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""How well a deformation keeps the volume: the volume ratio of each element.

.. math:: J_τ = \frac{1}{|τ|} \int_τ \det F \,\mathrm d X,

the deformed volume of an element τ over its volume at rest. The pressure, constant in each element,
holds J_τ near one; det F at a point is free in quadratic elements.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl

from dolfinx_feti import kinematics

__all__ = ["VolumeRatios", "summarise", "volume_ratios"]

#: |J_τ − 1| above which an element counts as one that does not keep its volume.
NOTICEABLE = 0.01


@dataclass(frozen=True, slots=True)
class VolumeRatios:
    """The volume ratios of all elements in a few numbers.

    Attributes:
        min_J: Least J_τ.
        mean_J: Mean of J_τ over the elements.
        max_J: Greatest J_τ.
        mean_deviation_J: Mean of |J_τ − 1|.
        share_J: Share of the elements with |J_τ − 1| > 1 %.
    """

    min_J: float
    mean_J: float
    max_J: float
    mean_deviation_J: float
    share_J: float


def volume_ratios(u: dolfinx.fem.Function) -> npt.NDArray[np.float64]:
    """Return J_τ of the owned cells, (n_cells,).

    Args:
        u: Displacement in P_k.

    Note:
        Collective.
    """
    mesh = u.function_space.mesh
    q = ufl.TestFunction(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    cubic = 3 * (u.function_space.ufl_element().embedded_superdegree - 1)
    dx = ufl.dx(metadata={"quadrature_degree": cubic})
    J = kinematics.jacobian(kinematics.deformation_gradient(u))
    one = dolfinx.fem.Constant(mesh, 1.0)
    deformed, rest = (dolfinx.fem.assemble_vector(dolfinx.fem.form(f * q * dx)) for f in (J, one))
    n = mesh.topology.index_map(mesh.topology.dim).size_local
    return deformed.array[:n] / rest.array[:n]


def summarise(J: npt.NDArray[np.float64], comm: MPI.Comm) -> VolumeRatios:
    """Sum up the volume ratios of all processes.

    Args:
        J: Those of this process, (n_cells,).
        comm: Communicator of the mesh.

    Note:
        Collective.
    """
    off = np.abs(J - 1.0)
    sums = [len(J), J.sum(), off.sum(), np.count_nonzero(off > NOTICEABLE)]
    count, total, deviation, noticeable = comm.allreduce(np.array(sums, dtype=float))
    return VolumeRatios(
        min_J=comm.allreduce(float(J.min(initial=np.inf)), op=MPI.MIN),
        mean_J=total / count,
        max_J=comm.allreduce(float(J.max(initial=-np.inf)), op=MPI.MAX),
        mean_deviation_J=deviation / count,
        share_J=noticeable / count,
    )
