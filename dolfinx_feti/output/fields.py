# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Output for ParaView: all fields in one file, step by step.

Where dolfinx has ADIOS2 the format is VTX, a folder `name.bp` (ParaView 5.12 or newer): every field
is interpolated cell by cell into discontinuous linear functions, so that displacements, stresses
and cell data share one file and nothing is smoothed. Elsewhere it is XDMF, `name.xdmf` with
`name.h5`: continuous fields at the vertices, the others with one value per cell.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix
import dolfinx
import dolfinx.io
from ufl.core.expr import Expr

from dolfinx_feti.runtime.compat import interpolation_points
from dolfinx_feti.runtime.folders import try_to_write, writable_folder

__all__ = ["FieldWriter", "cell_values"]

SUFFIXES = {"vtx": ".bp", "xdmf": ".xdmf"}


class FieldWriter:
    """Writes functions on one mesh, and expressions of them, step by step.

    Example::

        with FieldWriter(folder / "wall", [u, layers], {"stress": stress}) as writer:
            for load in loads:
                …
                writer.write(load)

    Attributes:
        path: The file or folder to open in ParaView.
    """

    def __init__(
        self,
        path: Path | str,
        functions: Sequence[dolfinx.fem.Function],
        expressions: Mapping[str, Expr] | None = None,
        *,
        kind: str | None = None,
    ) -> None:
        """Open the file.

        Args:
            path: Its name without suffix.
            functions: Scalars and vectors to write, under their own names.
            expressions: UFL expressions to write, by name; they are evaluated cell by cell.
            kind: ``vtx`` or ``xdmf``; by default VTX where dolfinx has ADIOS2, XDMF elsewhere.

        Raises:
            ValueError: The kind is unknown, there is no function, or two fields have one name.
            OSError: The file cannot be created.

        Note:
            Collective.
        """
        kind = kind or ("vtx" if dolfinx.has_adios2 else "xdmf")
        expressions = expressions or {}
        names = [*(f.name for f in functions), *expressions]
        if kind not in SUFFIXES:
            raise ValueError(f"kind={kind!r}: choose 'vtx' or 'xdmf'.")
        if not functions or len(set(names)) < len(names):
            raise ValueError(
                f"The fields are named {names}: give at least one function, and distinct names."
            )
        mesh = functions[0].function_space.mesh
        self.path = _writable_place(Path(path), kind, mesh.comm)
        self._sources: list[dolfinx.fem.Function | dolfinx.fem.Expression] = list(functions)
        self._copies = [_output_function(f, kind) for f in functions]
        for name, expression in expressions.items():
            copy = _cellwise_function(mesh, expression.ufl_shape, name, kind)
            points = interpolation_points(copy.function_space)
            self._sources.append(dolfinx.fem.Expression(expression, points))
            self._copies.append(copy)
        self._file: dolfinx.io.VTXWriter | dolfinx.io.XDMFFile
        if kind == "vtx":
            self._file = dolfinx.io.VTXWriter(mesh.comm, self.path, self._copies)
        else:
            self._file = dolfinx.io.XDMFFile(mesh.comm, self.path, "w")
            self._file.write_mesh(mesh)

    def write(self, t: float) -> None:
        """Write the current values.

        Args:
            t: Time, or another quantity that orders the steps, such as the load.

        Note:
            Collective.
        """
        for source, copy in zip(self._sources, self._copies, strict=False):
            copy.interpolate(source)
        if isinstance(self._file, dolfinx.io.XDMFFile):
            for copy in self._copies:
                self._file.write_function(copy, t)
        else:
            self._file.write(t)

    def close(self) -> None:
        """Close the file.

        Note:
            Collective.
        """
        self._file.close()

    def __enter__(self) -> FieldWriter:
        """Return the writer."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file."""
        self.close()


def cell_values(expression: Expr, mesh: dolfinx.mesh.Mesh) -> npt.NDArray[np.float64]:
    """Evaluate a UFL expression at the centroids of the cells.

    Args:
        expression: A scalar or vector.
        mesh: Its mesh.

    Returns:
        Values in the owned cells, (n_cells, …).
    """
    cell = getattr(basix.CellType, mesh.topology.cell_name())
    centroid = np.asarray(basix.geometry(cell)).mean(axis=0, keepdims=True)
    owned = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
    values = dolfinx.fem.Expression(expression, centroid).eval(mesh, owned)
    return np.asarray(values).reshape(len(owned), *expression.ufl_shape)


def _writable_place(path: Path, kind: str, comm: MPI.Comm) -> Path:
    """Return the path with its suffix, after a check that everything there can be written.

    With a folder in place of a file, or a file in place of a folder, the libraries below would
    raise on one process only, or silently write nothing.
    """
    folder = writable_folder(path.parent, comm)
    place = folder / (path.name + SUFFIXES[kind])
    if kind == "vtx":
        return writable_folder(place, comm)
    for file in (place, folder / (path.name + ".h5")):
        try_to_write(_append_nothing, file, "file", comm)
    return place


def _append_nothing(path: Path) -> None:
    path.open("ab").close()


def _output_function(f: dolfinx.fem.Function, kind: str) -> dolfinx.fem.Function:
    """Return a function of the same shape and name on the space that the format supports."""
    V = f.function_space
    if kind == "vtx" or V.ufl_element().discontinuous:
        return _cellwise_function(V.mesh, f.ufl_shape, f.name, kind)
    space = dolfinx.fem.functionspace(V.mesh, ("Lagrange", 1, f.ufl_shape))
    return dolfinx.fem.Function(space, name=f.name)


def _cellwise_function(
    mesh: dolfinx.mesh.Mesh, shape: tuple[int, ...], name: str, kind: str
) -> dolfinx.fem.Function:
    """Return a discontinuous function, linear for VTX and constant for XDMF."""
    space = dolfinx.fem.functionspace(mesh, ("DG", 1 if kind == "vtx" else 0, shape))
    return dolfinx.fem.Function(space, name=name)
