# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Point clouds: an XDMF file with points and values of all steps, and a binary file of arrays."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import cast
from xml.sax.saxutils import quoteattr

from mpi4py import MPI

import numpy as np

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_root

__all__ = ["PointCloud"]

#: XDMF's type of an attribute by its number of components; all others are matrices.
ATTRIBUTE_TYPES = {1: "Scalar", 3: "Vector", 9: "Tensor"}


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
        self._end = 0  # size of the binary file
        self._grids: list[str] = []  # XML of each step

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
            attribute_type = ATTRIBUTE_TYPES.get(values.shape[1], "Matrix")
            grid.append(
                f'<Attribute Name={quoteattr(name)} AttributeType="{attribute_type}" Center="Node">'
                f"{self._append(values)}</Attribute>"
            )
        self._file.Sync()
        self._grids.append("\n".join([*grid, "</Grid>"]))
        # the whole text is written at each step: the file stays complete if the run is killed
        head = (
            '<?xml version="1.0"?>\n<Xdmf Version="3.0"><Domain>'
            '<Grid GridType="Collection" CollectionType="Temporal">'
        )
        text = "\n".join([head, *self._grids, "</Grid></Domain></Xdmf>\n"])
        on_root(lambda: self._path.write_text(text, encoding="utf-8"), self._comm)

    def _append(self, values: Array) -> str:
        """Append rows to the binary file; return the DataItem that refers to them. Collective.

        Args:
            values: Rows of this process, (n, k).
        """
        rows = self._comm.allgather(len(values))
        row_bytes = 8 * values.shape[1]
        start = self._end
        start_here = start + row_bytes * sum(rows[: self._comm.rank])
        self._file.Write_at_all(start_here, np.ascontiguousarray(values, dtype="<f8"))
        self._end = start + row_bytes * sum(rows)
        return (
            f'<DataItem Dimensions="{sum(rows)} {values.shape[1]}" NumberType="Float" '
            f'Precision="8" Format="Binary" Endian="Little" Seek="{start}">'
            f"{self._path.stem}.bin</DataItem>"
        )

    def close(self) -> None:
        """Close the files. Collective."""
        self._file.Close()
