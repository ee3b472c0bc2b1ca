# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Data at quadrature points: their projection in each cell, and files of points.

In each cell the projection of values :math:`f_q` at points :math:`ξ_q` with weights :math:`w_q` to
a basis :math:`φ_i` minimises :math:`\sum_q w_q (\sum_i c_i φ_i(ξ_q) - f_q)^2`. A point cloud is an
XDMF file with its heavy data in a binary file: points and values, step after step.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import cast
from xml.sax.saxutils import quoteattr

from mpi4py import MPI

import numpy as np

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_root

__all__ = ["PointCloud", "projection"]

#: XDMF's name of a value by its number of components; all others are matrices.
TYPES = {1: "Scalar", 3: "Vector", 9: "Tensor"}


def projection(φ: Array, weights: Array) -> Array:
    """Return the map from values at quadrature points to the coefficients of a basis.

    Args:
        φ: Values of the basis at the points, (points, basis).
        weights: Weights of the points, (points,); if one is not positive, all count as equal.

    Returns:
        Π, (basis, points).
    """
    w = np.sqrt(weights if np.all(weights > 0.0) else np.ones(len(weights)))
    return np.asarray(np.linalg.pinv(w[:, None] * φ) * w)  # (√W Φ)⁺ √W


class PointCloud:
    """Writer of values at points, step by step, to `name.xdmf` and `name.bin`."""

    def __init__(self, path: Path, comm: MPI.Comm) -> None:
        """Open the files. Collective."""
        self._path = path
        self._comm = comm
        heavy = str(path.with_suffix(".bin"))
        mode = MPI.MODE_CREATE | MPI.MODE_WRONLY
        self._file = MPI.File.Open(cast(MPI.Intracomm, comm), heavy, mode)
        self._file.Set_size(0)
        self._end = 0
        self._grids: list[str] = []

    def write(self, t: float, x: Array, fields: Mapping[str, Array]) -> None:
        """Append a step. Collective.

        Args:
            t: Time or load.
            x: Points of this process, (n, 3).
            fields: Values at the points by name, (n, k) each.
        """
        n = self._comm.allreduce(len(x))
        grid = [
            f'<Grid GridType="Uniform"><Time Value="{t!r}"/>',
            f'<Topology TopologyType="Polyvertex" NumberOfElements="{n}"/>',
            f'<Geometry GeometryType="XYZ">{self._append(x)}</Geometry>',
        ]
        for name, values in fields.items():
            kind = f'AttributeType="{TYPES.get(values.shape[1], "Matrix")}" Center="Node"'
            item = self._append(values)
            grid.append(f"<Attribute Name={quoteattr(name)} {kind}>{item}</Attribute>")
        self._file.Sync()
        self._grids.append("\n".join([*grid, "</Grid>"]))
        head = '<?xml version="1.0"?>\n<Xdmf Version="3.0"><Domain>'
        head += '<Grid GridType="Collection" CollectionType="Temporal">'
        text = "\n".join([head, *self._grids, "</Grid></Domain></Xdmf>\n"])
        on_root(lambda: self._path.write_text(text, encoding="utf-8"), self._comm)

    def _append(self, values: Array) -> str:
        """Append rows to the binary file; return the DataItem that refers to them. Collective.

        Args:
            values: Rows of this process, (n, k).
        """
        rows = self._comm.allgather(len(values))
        width = 8 * values.shape[1]
        start = self._end + width * sum(rows[: self._comm.rank])
        self._file.Write_at_all(start, np.ascontiguousarray(values, dtype="<f8"))
        seek = self._end
        self._end = self._end + width * sum(rows)
        return (
            f'<DataItem Dimensions="{sum(rows)} {values.shape[1]}" NumberType="Float" '
            f'Precision="8" Format="Binary" Endian="Little" Seek="{seek}">'
            f"{self._path.stem}.bin</DataItem>"
        )

    def close(self) -> None:
        """Close the files. Collective."""
        self._file.Close()
