# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Output for ParaView: all fields in one file, step by step (docs/stresses.md).

The format is VTX, `name.bp`, if dolfinx has ADIOS2. Each field becomes a discontinuous function of
the degree of the geometry. Otherwise, and for prisms, the format is XDMF, with continuous fields at
nodes and one value per cell for all others. Data at quadrature points are projected to these
functions, or written at their points to `name_points.xdmf`. To write data on facets, use functions
on a submesh of the facets. Functions on a mesh of vertices are written at points.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import dolfinx
import ufl
from ufl.core.expr import Expr
from ufl.domain import extract_domains

from dolfinx_feti.fem.quadrature import quadrature_rule
from dolfinx_feti.output.file_fields import FieldCopy, QuadratureFields, VertexFields
from dolfinx_feti.output.file_formats import MeshOutput, PointOutput, chosen_format
from dolfinx_feti.runtime.collective import error_message, on_all
from dolfinx_feti.runtime.folders import writable_folder
from dolfinx_feti.runtime.values import require_sequence

__all__ = ["FieldWriter"]


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
            ValueError: ``kind`` or ``quadrature`` is unknown, the format does not have the mesh's
                cells, there is no function, two fields have the same name, or a field cannot be
                written: it is mixed, lives on another mesh or on facets, or has several quadrature
                rules.
            OSError: The file cannot be created.
        """
        require_sequence(dolfinx.fem.Function, functions=functions)
        named = _named_fields(functions, expressions or {})
        if quadrature not in ("project", "points"):
            raise ValueError(f"quadrature={quadrature!r}: choose 'project' or 'points'.")
        mesh = functions[0].function_space.mesh
        chosen = chosen_format(kind, mesh)
        fields = _SortedFields(mesh, chosen, has_point_file=quadrature == "points")
        for name, field in named.items():
            fields.add(name, field)
        folder = writable_folder(Path(path).parent, mesh.comm)
        file_name = Path(path).name
        # both places are checked before a file is opened
        mesh_path: Path | None = None
        if fields.copies:
            mesh_path = chosen.writable_path(folder, file_name, mesh.comm)
        self.points: Path | None = None
        if fields.at_points is not None:
            self.points = PointOutput.writable_path(folder, file_name, mesh.comm)
        self._outputs: list[MeshOutput | PointOutput] = []
        if mesh_path is not None:
            self._outputs.append(chosen(mesh_path, mesh, fields.copies))
        if self.points is not None and fields.at_points is not None:
            self._outputs.append(PointOutput(self.points, mesh.comm, fields.at_points))
        self.path = self._outputs[0].path

    def write(self, t: float) -> None:
        """Write a step: the current values at a time or load t. Collective."""
        if not math.isfinite(t):
            raise ValueError(f"t={t}: give a finite time or load.")
        for output in self._outputs:
            output.write(float(t))

    def close(self) -> None:
        """Close the files. Collective."""
        for output in self._outputs:
            output.close()

    def __enter__(self) -> FieldWriter:
        """Return the writer."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the files."""
        self.close()


def _named_fields(
    functions: Sequence[dolfinx.fem.Function], expressions: Mapping[str, Expr]
) -> dict[str, dolfinx.fem.Function | Expr]:
    """Return functions and expressions by their names.

    Raises:
        ValueError: There is no function, or two fields have the same name.
    """
    fields = [*((f.name, f) for f in functions), *expressions.items()]
    names = [name for name, _ in fields]
    if not functions or len(set(names)) < len(names):
        raise ValueError(
            f"The fields are named {names}: give at least one function, and distinct names."
        )
    return dict(fields)


class _SortedFields:
    """Fields of one mesh, sorted by how they are written.

    Attributes:
        copies: Copies of fields for the file of functions, in spaces that the format can write.
    """

    def __init__(
        self, mesh: dolfinx.mesh.Mesh, mesh_format: type[MeshOutput], *, has_point_file: bool
    ) -> None:
        """Start without any field.

        Args:
            mesh: The mesh.
            mesh_format: Format of the file of functions.
            has_point_file: Whether data at quadrature points are written at their points.
        """
        self._mesh = mesh
        self._mesh_format = mesh_format
        self._has_point_file = has_point_file
        self.copies: list[FieldCopy] = []
        self._quadrature_fields: QuadratureFields | None = None
        self._vertex_fields: VertexFields | None = None

    @property
    def at_points(self) -> QuadratureFields | VertexFields | None:
        """Fields with values at points, for the file of points; None without any.

        Vertex fields exist on a mesh of vertices only, quadrature fields on all other meshes.
        """
        return self._quadrature_fields or self._vertex_fields

    def add(self, name: str, field: dolfinx.fem.Function | Expr) -> None:
        """Choose how a field is written, and evaluate a copy of it once. Collective.

        Args:
            name: Its name in the file.
            field: The field.

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
            elif rule is not None and self._has_point_file:
                points, _ = rule
                if self._quadrature_fields is None:
                    self._quadrature_fields = QuadratureFields(mesh, points)
                self._quadrature_fields.add(name, field, points)
            else:
                space = self._mesh_format.space_of_copy(mesh, field)
                copy = FieldCopy(name, field, space, rule)
                copy.update()  # raises errors now, not at the first step
                self.copies.append(copy)
        except (NotImplementedError, RuntimeError, TypeError, ValueError) as error:
            raise ValueError(
                f"The field {name!r} cannot be written: {error_message(error)}"
            ) from error


def _check_field(field: dolfinx.fem.Function | Expr, mesh: dolfinx.mesh.Mesh) -> None:
    """Raise a ValueError if a field has another mesh, a test function, or a mixed element."""
    if any(domain != mesh.ufl_domain() for domain in extract_domains(field)):
        raise ValueError("it lives on another mesh than the first function; use a file for each.")
    if ufl.algorithms.extract_arguments(field):
        raise ValueError("it holds a test or trial function.")
    if isinstance(field, dolfinx.fem.Function):
        element = field.function_space.ufl_element()
        if element.num_sub_elements > 1 and element.block_size == 1:
            raise ValueError("its space is mixed; write its parts, f.sub(0), f.sub(1), …")
