# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Formats of files for ParaView: VTX and XDMF for functions on a mesh, XDMF for values at points.

An output writes the current values of its fields, step by step, to a file that ParaView opens. Some
formats store the arrays in a second file. A new format of functions is a subclass of
:class:`MeshOutput` and an entry of `FORMATS`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path

from mpi4py import MPI

import numpy as np

import basix
import dolfinx
import dolfinx.io
from ufl.core.expr import Expr

from dolfinx_feti.output.file_fields import FieldCopy, QuadratureFields, VertexFields
from dolfinx_feti.output.point_cloud import PointCloud
from dolfinx_feti.runtime.compat import geometry_degree
from dolfinx_feti.runtime.folders import try_to_write, writable_folder

__all__ = ["FORMATS", "MeshOutput", "PointOutput", "chosen_format"]

#: Cells of VTX files.
VTX_CELLS = ("interval", "triangle", "quadrilateral", "tetrahedron", "hexahedron")


class MeshOutput(ABC):
    """A file of functions on one mesh.

    Attributes:
        path: The file or folder to open in ParaView.
        copies: The copies of fields that it writes.
    """

    def __init__(self, path: Path, mesh: dolfinx.mesh.Mesh, copies: Sequence[FieldCopy]) -> None:
        """Open the file. Collective.

        Args:
            path: The path, from :meth:`writable_path`.
            mesh: The mesh.
            copies: Copies of the fields, one at least, in spaces of :meth:`space_of_copy`.
        """
        self.path = path
        self.copies = copies

    @staticmethod
    @abstractmethod
    def check_mesh(mesh: dolfinx.mesh.Mesh) -> None:
        """Raise a ValueError if the format does not have the mesh's cells."""

    @staticmethod
    @abstractmethod
    def space_of_copy(
        mesh: dolfinx.mesh.Mesh, field: dolfinx.fem.Function | Expr
    ) -> dolfinx.fem.FunctionSpace:
        """Return the space in which the format writes a field. Collective.

        Its element is a Lagrange element or a discontinuous one, see ``FieldCopy``.
        """

    @staticmethod
    @abstractmethod
    def writable_path(folder: Path, name: str, comm: MPI.Comm) -> Path:
        """Return the path of a file, after a check that it can be written. Collective.

        The check creates missing files, or the folder of VTX.

        Args:
            folder: An existing folder.
            name: Name of the file without suffix.
            comm: Communicator of the mesh.

        Raises:
            OSError: The file cannot be written. The error is raised on all processes; dolfinx
                would raise it on one process only.
        """

    def write(self, t: float) -> None:
        """Write the current values of the fields at a time or load. Collective."""
        for copy in self.copies:
            copy.update()
        self._write_copies(t)

    @abstractmethod
    def _write_copies(self, t: float) -> None:
        """Write the functions of the copies, which have their current values. Collective.

        Args:
            t: Time or load.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the file. Collective."""


class VTXOutput(MeshOutput):
    """A VTX file: discontinuous functions of the degree of the geometry."""

    def __init__(self, path: Path, mesh: dolfinx.mesh.Mesh, copies: Sequence[FieldCopy]) -> None:
        """Open the file. Collective; see :class:`MeshOutput`."""
        super().__init__(path, mesh, copies)
        functions = [copy.function for copy in copies]
        self._file = dolfinx.io.VTXWriter(mesh.comm, path, functions)

    @staticmethod
    def check_mesh(mesh: dolfinx.mesh.Mesh) -> None:
        """Raise a ValueError if the format does not have the mesh's cells."""
        cell = mesh.topology.cell_name()
        if cell not in (*VTX_CELLS, "point"):
            raise ValueError(f"kind='vtx': VTX has no cells of type {cell}; choose kind='xdmf'.")

    @staticmethod
    def space_of_copy(
        mesh: dolfinx.mesh.Mesh, field: dolfinx.fem.Function | Expr
    ) -> dolfinx.fem.FunctionSpace:
        """Return the space in which the format writes a field. Collective."""
        return dolfinx.fem.functionspace(mesh, ("DG", geometry_degree(mesh), field.ufl_shape))

    @staticmethod
    def writable_path(folder: Path, name: str, comm: MPI.Comm) -> Path:
        """Return the path of a file, after a check that it can be written. Collective."""
        return writable_folder(folder / f"{name}.bp", comm)

    def close(self) -> None:
        """Close the file. Collective."""
        self._file.close()

    def _write_copies(self, t: float) -> None:
        """Write the functions of the copies. Collective."""
        self._file.write(t)


class XDMFOutput(MeshOutput):
    """An XDMF file: continuous functions at nodes, all others with one value per cell."""

    def __init__(self, path: Path, mesh: dolfinx.mesh.Mesh, copies: Sequence[FieldCopy]) -> None:
        """Open the file, and write the mesh. Collective; see :class:`MeshOutput`."""
        super().__init__(path, mesh, copies)
        self._mesh = mesh
        self._file = dolfinx.io.XDMFFile(mesh.comm, path, "w")
        self._meshes_written = 0
        self._written_nodes = mesh.geometry.x.copy()
        self._write_mesh()

    @staticmethod
    def check_mesh(mesh: dolfinx.mesh.Mesh) -> None:
        """Raise a ValueError if the format does not have the mesh's cells."""
        cell = mesh.topology.cell_name()
        degree = geometry_degree(mesh)
        if degree > (1 if cell in ("prism", "pyramid") else 2):
            raise ValueError(
                f"kind='xdmf': XDMF has no {cell} of degree {degree}; choose kind='vtx'."
            )

    @staticmethod
    def space_of_copy(
        mesh: dolfinx.mesh.Mesh, field: dolfinx.fem.Function | Expr
    ) -> dolfinx.fem.FunctionSpace:
        """Return the space in which the format writes a field. Collective."""
        element: tuple[object, ...] = ("DG", 0, field.ufl_shape)
        if isinstance(field, dolfinx.fem.Function) and _is_continuous(field):
            element = ("Lagrange", geometry_degree(mesh), field.ufl_shape)
        return dolfinx.fem.functionspace(mesh, element)

    @staticmethod
    def writable_path(folder: Path, name: str, comm: MPI.Comm) -> Path:
        """Return the path of a file, after a check that it can be written. Collective."""
        path = folder / f"{name}.xdmf"
        _check_files((path, folder / f"{name}.h5"), comm)
        return path

    def close(self) -> None:
        """Close the file. Collective."""
        self._file.close()

    def _write_copies(self, t: float) -> None:
        """Write the mesh if it has moved, then the functions of the copies. Collective."""
        has_moved = not np.array_equal(self._written_nodes, self._mesh.geometry.x)
        if self._mesh.comm.allreduce(has_moved, op=MPI.LOR):
            self._write_mesh()
        # XPath of the mesh that was written last, to which the values belong
        grid = f"/Xdmf/Domain/Grid[@GridType='Uniform'][{self._meshes_written}]"
        for copy in self.copies:
            self._file.write_function(copy.function, t, grid)

    def _write_mesh(self) -> None:
        """Write the mesh at its current position, under a new name each time. Collective."""
        mesh = self._mesh
        self._meshes_written += 1
        name = mesh.name
        if self._meshes_written > 1:
            mesh.name = f"{name}_{self._meshes_written}"
        self._file.write_mesh(mesh)
        mesh.name = name
        self._written_nodes = mesh.geometry.x.copy()


class PointOutput:
    """An XDMF file of values at points.

    Attributes:
        path: The file to open in ParaView.
    """

    def __init__(self, path: Path, comm: MPI.Comm, fields: QuadratureFields | VertexFields) -> None:
        """Open the file. Collective.

        Args:
            path: The path, from :meth:`writable_path`.
            comm: Communicator of the mesh.
            fields: The fields.
        """
        self.path = path
        self._fields = fields
        self._cloud = PointCloud(path, comm)

    @staticmethod
    def writable_path(folder: Path, name: str, comm: MPI.Comm) -> Path:
        """Return the path of a file, after a check that it can be written. Collective.

        The check creates missing files.

        Args:
            folder: An existing folder.
            name: Name without suffix, as for a file of functions; ``_points`` is appended to it.
            comm: Communicator of the mesh.

        Raises:
            OSError: The file cannot be written, on all processes.
        """
        path = folder / f"{name}_points.xdmf"
        _check_files((path, path.with_suffix(".bin")), comm)
        return path

    def write(self, t: float) -> None:
        """Write the current points and values at a time or load. Collective."""
        self._cloud.write(t, self._fields.coordinates(), self._fields.values())

    def close(self) -> None:
        """Close the file. Collective."""
        self._cloud.close()


#: Formats of functions on a mesh, by the value of the argument ``kind``.
FORMATS: dict[str, type[MeshOutput]] = {"vtx": VTXOutput, "xdmf": XDMFOutput}


def chosen_format(kind: str | None, mesh: dolfinx.mesh.Mesh) -> type[MeshOutput]:
    """Return the format of a file of functions.

    Args:
        kind: Its name; if None, VTX if dolfinx has ADIOS2 and VTX has the cells, else XDMF.
        mesh: The mesh.

    Raises:
        ValueError: The format is unknown or does not have the mesh's cells.
    """
    if kind is None:
        has_vtx = dolfinx.has_adios2 and mesh.topology.cell_name() in VTX_CELLS
        kind = "vtx" if has_vtx else "xdmf"
    if kind not in FORMATS:
        raise ValueError(f"kind={kind!r}: choose {' or '.join(map(repr, FORMATS))}.")
    FORMATS[kind].check_mesh(mesh)
    return FORMATS[kind]


def _is_continuous(f: dolfinx.fem.Function) -> bool:
    """Return True if a function is continuous across facets."""
    space = f.function_space.ufl_element().basix_sobolev_space
    return space in (basix.SobolevSpace.H1, basix.SobolevSpace.H2, basix.SobolevSpace.H3)


def _check_files(paths: Sequence[Path], comm: MPI.Comm) -> None:
    """Raise an OSError on all processes if a file cannot be written. Collective.

    Missing files are created empty, existing ones stay as they are.
    """
    for path in paths:
        try_to_write(_append_nothing, path, "file", comm)


def _append_nothing(path: Path) -> None:
    """Open a file for writing: a missing file is created empty, an existing one stays as it is."""
    path.open("ab").close()
