# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Output for ParaView: all fields in one file, step by step (docs/stresses.md).

The format is VTX, `name.bp`, if dolfinx has ADIOS2: each field becomes a discontinuous function of
the degree of the geometry. Otherwise, and for prisms, it is XDMF: continuous fields at nodes, other
fields with one value per cell. Data at quadrature points are projected to these functions, or
written at their points to `name_points.xdmf`. Data on facets are fields of a submesh; fields on a
mesh of vertices are written at points.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from mpi4py import MPI

import numpy as np

import basix
import dolfinx
import dolfinx.io
import ufl
from ufl.core.expr import Expr
from ufl.domain import extract_domains

from dolfinx_feti.fem.quadrature import quadrature_rule
from dolfinx_feti.mechanics.values import require_sequence
from dolfinx_feti.output.file_fields import FieldCopy, QuadratureFields, VertexFields
from dolfinx_feti.output.point_cloud import PointCloud
from dolfinx_feti.runtime.collective import error_message, on_all
from dolfinx_feti.runtime.compat import geometry_degree
from dolfinx_feti.runtime.folders import try_to_write, writable_folder

__all__ = ["FieldWriter"]

#: Suffix of the file or folder of each format.
SUFFIXES = {"vtx": ".bp", "xdmf": ".xdmf"}

#: Cells of VTX files.
VTX_CELLS = ("interval", "triangle", "quadrilateral", "tetrahedron", "hexahedron")


class FieldWriter:
    """Writer of functions on one mesh, and of expressions in them, step by step.

    Example::

        problem = NonlinearProblem(energy, u, bcs=bcs)
        stress = kinematics.cauchy_stress(psi, F)
        with FieldWriter("wall", [u], {"stress": stress}) as writer:
            for load in (0.1, 0.2):
                set_load(load)
                problem.solve()
                writer.write(load)

    Attributes:
        path: The file or folder to open in ParaView.
        points: The file of the values at points; None without such values.
    """

    def __init__(
        self,
        path: Path | str,
        functions: Sequence[dolfinx.fem.Function],
        expressions: Mapping[str, Expr] | None = None,
        *,
        kind: str | None = None,
        quadrature: Literal["project", "points"] = "project",
    ) -> None:
        """Open the file. Collective.

        Args:
            path: Path of the file without suffix.
            functions: Functions to write, under their own names, of any element.
            expressions: UFL expressions to write, by name; they are evaluated cell by cell.
            kind: ``vtx`` or ``xdmf``; by default VTX if dolfinx has ADIOS2, else XDMF.
            quadrature: How data at quadrature points are written: ``project`` projects them, in
                each cell, to functions of the degree of the geometry (VTX) or to a mean (XDMF);
                ``points`` writes them at their points.

        Raises:
            ValueError: ``kind`` or ``quadrature`` is unknown, the format lacks the cells, there is
                no function, two fields have one name, or a field cannot be written: it is mixed,
                lives on another mesh or on facets, or has several quadrature rules.
            OSError: The file cannot be created.
        """
        require_sequence(dolfinx.fem.Function, functions=functions)
        expressions = expressions or {}
        fields = [*((f.name, f) for f in functions), *expressions.items()]
        names = [name for name, _ in fields]
        if not functions or len(set(names)) < len(names):
            raise ValueError(
                f"The fields are named {names}: give at least one function, and distinct names."
            )
        if quadrature not in ("project", "points"):
            raise ValueError(f"quadrature={quadrature!r}: choose 'project' or 'points'.")
        mesh = functions[0].function_space.mesh
        self._mesh = mesh
        self._kind = _checked_kind(kind, mesh)
        self._copies: list[FieldCopy] = []
        self._quadrature_fields: QuadratureFields | None = None
        self._vertex_fields: VertexFields | None = None
        for name, field in fields:
            self._add(name, field, quadrature)
        self.path = _writable_place(Path(path), self._kind, mesh.comm)
        self.points: Path | None = None
        self._file: dolfinx.io.VTXWriter | dolfinx.io.XDMFFile | None = None
        self._cloud: PointCloud | None = None
        self._meshes_written = 0
        self._point_fields = self._quadrature_fields or self._vertex_fields
        if self._point_fields is not None:
            place = self.path.with_name(f"{Path(path).name}_points.xdmf")
            for file in (place, place.with_suffix(".bin")):
                try_to_write(_append_nothing, file, "file", mesh.comm)
            self._cloud = PointCloud(place, mesh.comm)
            self.points = place
        if not self._copies:
            self.path = self.points or self.path
        elif self._kind == "vtx":
            written = [copy.function for copy in self._copies]
            self._file = dolfinx.io.VTXWriter(mesh.comm, self.path, written)
        else:
            self._file = dolfinx.io.XDMFFile(mesh.comm, self.path, "w")
            self._write_mesh(self._file)

    def write(self, t: float) -> None:
        """Write the current values at a time or load, which orders the steps. Collective."""
        if not math.isfinite(t):
            raise ValueError(f"t={t}: give a finite time or load.")
        for copy in self._copies:
            copy.update()
        if isinstance(self._file, dolfinx.io.XDMFFile):
            has_moved = not np.array_equal(self._written_nodes, self._mesh.geometry.x)
            if self._mesh.comm.allreduce(has_moved, op=MPI.LOR):
                self._write_mesh(self._file)
            grid = f"/Xdmf/Domain/Grid[@GridType='Uniform'][{self._meshes_written}]"
            for copy in self._copies:
                self._file.write_function(copy.function, t, grid)
        elif self._file is not None:
            self._file.write(t)
        if self._cloud is not None and self._point_fields is not None:
            points = self._point_fields.coordinates()
            self._cloud.write(float(t), points, self._point_fields.values())

    def close(self) -> None:
        """Close the files. Collective."""
        for file in (self._file, self._cloud):
            if file is not None:
                file.close()

    def __enter__(self) -> FieldWriter:
        """Return the writer."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self.close()

    def _write_mesh(self, file: dolfinx.io.XDMFFile) -> None:
        """Write the mesh at its current position, each time under a different name."""
        mesh = self._mesh
        self._meshes_written += 1
        name = mesh.name
        if self._meshes_written > 1:
            mesh.name = f"{name}_{self._meshes_written}"
        file.write_mesh(mesh)
        mesh.name = name
        self._written_nodes = mesh.geometry.x.copy()

    def _add(self, name: str, field: dolfinx.fem.Function | Expr, quadrature: str) -> None:
        """Choose how a field is written, and evaluate it once. Collective.

        Args:
            name: Its name in the file.
            field: The field.
            quadrature: ``project`` or ``points``, for data at quadrature points.

        Raises:
            ValueError: The field cannot be written.
        """
        mesh = self._mesh
        try:
            _check_field(field, mesh)
            rule = on_all(lambda: quadrature_rule(field), mesh.comm)
            if mesh.topology.dim == 0:
                if self._vertex_fields is None:
                    self._vertex_fields = VertexFields(mesh)
                self._vertex_fields.add(name, field)
            elif rule is not None and quadrature == "points":
                points, _ = rule
                if self._quadrature_fields is None:
                    self._quadrature_fields = QuadratureFields(mesh, points)
                self._quadrature_fields.add(name, field, points)
            else:
                copy = FieldCopy(name, field, self._space_of_copy(field), rule)
                copy.update()  # raises errors now, not at the first step
                self._copies.append(copy)
        except (NotImplementedError, RuntimeError, TypeError, ValueError) as error:
            raise ValueError(
                f"The field {name!r} cannot be written: {error_message(error)}"
            ) from error

    def _space_of_copy(self, field: dolfinx.fem.Function | Expr) -> dolfinx.fem.FunctionSpace:
        """Return the space in which a field is written. Collective."""
        is_continuous = isinstance(field, dolfinx.fem.Function) and _is_continuous(field)
        has_nodes = self._kind == "vtx" or is_continuous
        degree = geometry_degree(self._mesh) if has_nodes else 0
        family = "Lagrange" if is_continuous and self._kind == "xdmf" else "DG"
        return dolfinx.fem.functionspace(self._mesh, (family, degree, field.ufl_shape))


def _checked_kind(kind: str | None, mesh: dolfinx.mesh.Mesh) -> str:
    """Return the format of the file, ``vtx`` or ``xdmf``, after checks.

    Raises:
        ValueError: The format is unknown or does not have the mesh's cells.
    """
    cell = mesh.topology.cell_name()
    kind = kind or ("vtx" if dolfinx.has_adios2 and cell in VTX_CELLS else "xdmf")
    if kind not in SUFFIXES:
        raise ValueError(f"kind={kind!r}: choose 'vtx' or 'xdmf'.")
    if kind == "vtx" and cell not in (*VTX_CELLS, "point"):
        raise ValueError(f"kind='vtx': VTX has no cells of type {cell}; choose kind='xdmf'.")
    degree = geometry_degree(mesh)
    if kind == "xdmf" and degree > (1 if cell in ("prism", "pyramid") else 2):
        raise ValueError(f"kind='xdmf': XDMF has no {cell} of degree {degree}; choose kind='vtx'.")
    return kind


def _check_field(field: dolfinx.fem.Function | Expr, mesh: dolfinx.mesh.Mesh) -> None:
    """Raise a ValueError if a field is not on the mesh, or has several elements."""
    if any(domain != mesh.ufl_domain() for domain in extract_domains(field)):
        raise ValueError("it lives on another mesh than the first function; open a file for each.")
    if ufl.algorithms.extract_arguments(field):
        raise ValueError("it holds a test or trial function.")
    if isinstance(field, dolfinx.fem.Function):
        element = field.function_space.ufl_element()
        if element.num_sub_elements > 1 and element.block_size == 1:
            raise ValueError("its space is mixed; write its parts, f.sub(0), f.sub(1), …")


def _is_continuous(f: dolfinx.fem.Function) -> bool:
    """Return True if a function is continuous across facets."""
    space = f.function_space.ufl_element().basix_sobolev_space
    return space in (basix.SobolevSpace.H1, basix.SobolevSpace.H2, basix.SobolevSpace.H3)


def _writable_place(path: Path, kind: str, comm: MPI.Comm) -> Path:
    """Return the path with its suffix, after a check that files can be written there. Collective.

    The check creates missing files, or the folder of VTX. They stay empty if all fields are written
    at points.

    Raises:
        OSError: A file cannot be written, on all processes; dolfinx would raise on one.
    """
    folder = writable_folder(path.parent, comm)
    place = folder / (path.name + SUFFIXES[kind])
    if kind == "vtx":
        return writable_folder(place, comm)
    for file in (place, folder / (path.name + ".h5")):
        try_to_write(_append_nothing, file, "file", comm)
    return place


def _append_nothing(path: Path) -> None:
    """Open a file for writing: a missing file is created empty, an existing one stays as it is."""
    path.open("ab").close()
