# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""How well a deformation keeps the volume: the volume ratio of each element.

.. math:: J_τ = \frac{1}{|τ|} \int_τ \det F \,\mathrm d X,

the deformed volume of an element τ over its volume at rest. The pressure, constant in each element,
holds J_τ near one; det F at a point is free in quadratic elements.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl

from benchmarks.common.records import Record
from dolfinx_feti import kinematics

__all__ = ["summarise", "volume_ratios"]

#: |J_τ − 1| above which an element counts as one that does not keep its volume.
NOTICEABLE = 0.01


def volume_ratios(u: dolfinx.fem.Function) -> npt.NDArray[np.float64]:
    """Return J_τ of the owned cells, (n_cells,), under a displacement in P_k. Collective."""
    mesh = u.function_space.mesh
    q = ufl.TestFunction(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    cubic = 3 * (u.function_space.ufl_element().embedded_superdegree - 1)
    dx = ufl.dx(metadata={"quadrature_degree": cubic})
    J = kinematics.jacobian(kinematics.deformation_gradient(u))
    one = dolfinx.fem.Constant(mesh, 1.0)
    deformed, rest = (dolfinx.fem.assemble_vector(dolfinx.fem.form(f * q * dx)) for f in (J, one))
    n = mesh.topology.index_map(mesh.topology.dim).size_local
    return deformed.array[:n] / rest.array[:n]


def summarise(J: npt.NDArray[np.float64], comm: MPI.Comm) -> Record:
    """Return least, mean and greatest J_τ, the mean of |J_τ − 1|, and the share of large ones.

    Args:
        J: Those of this process, (n_cells,).
        comm: Communicator of the mesh.
    """
    off = np.abs(J - 1.0)
    sums = [len(J), J.sum(), off.sum(), np.count_nonzero(off > NOTICEABLE)]
    count, total, deviation, noticeable = comm.allreduce(np.array(sums, dtype=float)).tolist()
    return {
        "min_J": comm.allreduce(float(J.min(initial=np.inf)), op=MPI.MIN),
        "mean_J": total / count,
        "max_J": comm.allreduce(float(J.max(initial=-np.inf)), op=MPI.MAX),
        "mean_deviation_J": deviation / count,
        "share_J": noticeable / count,
    }
