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
from collections.abc import Callable, Mapping, Sequence
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

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.quadrature import quadrature_rule, same_points
from dolfinx_feti.mechanics.values import require_sequence
from dolfinx_feti.output.points import PointCloud, projection
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import error_message, on_all
from dolfinx_feti.runtime.compat import geometry_degree, geometry_dofmap, interpolation_points
from dolfinx_feti.runtime.folders import try_to_write, writable_folder

__all__ = ["FieldWriter", "cell_values"]

SUFFIXES = {"vtx": ".bp", "xdmf": ".xdmf"}

#: Cells of VTX files.
VTX_CELLS = ("interval", "triangle", "quadrilateral", "tetrahedron", "hexahedron")


class FieldWriter:
    """Writer of functions on one mesh, and of expressions in them, step by step.

    Example::

        with FieldWriter(folder / "wall", [u, layers], {"stress": stress}) as writer:
            for load in loads:
                …
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
            quadrature: Data at quadrature points: ``project`` to linear functions in each cell
                (VTX) or means (XDMF), or write them at the ``points``.

        Raises:
            ValueError: ``kind`` or ``quadrature`` is unknown or cannot show the cells, there is no
                function, two fields have one name, or a field cannot be written: it is mixed, lives
                on another mesh or on facets, or has several quadrature rules.
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
        self._mesh = mesh = functions[0].function_space.mesh
        self._kind = _checked_kind(kind, mesh)
        self._updates: list[Callable[[], object]] = []
        self._copies: list[dolfinx.fem.Function] = []
        self._at_points: dict[str, Callable[[], Array]] = {}  # name → values, (n, k)
        self._x: Callable[[], Array] | None = None  # coordinates of the points, (n, 3)
        self._rule: Array | None = None
        self._meshes = 0
        for name, field in fields:
            self._add(name, field, quadrature)
        self.path = _writable_place(Path(path), self._kind, mesh.comm)
        self.points: Path | None = None
        self._file: dolfinx.io.VTXWriter | dolfinx.io.XDMFFile | None = None
        self._cloud: PointCloud | None = None
        if self._at_points:
            place = self.path.with_name(f"{Path(path).name}_points.xdmf")
            for file in (place, place.with_suffix(".bin")):
                try_to_write(_append_nothing, file, "file", mesh.comm)
            self._cloud = PointCloud(place, mesh.comm)
            self.points = place
        if not self._copies:
            self.path = self.points or self.path
        elif self._kind == "vtx":
            self._file = dolfinx.io.VTXWriter(mesh.comm, self.path, self._copies)
        else:
            self._file = dolfinx.io.XDMFFile(mesh.comm, self.path, "w")
            self._write_mesh(self._file)

    def write(self, t: float) -> None:
        """Write the current values at a time or load, which orders the steps. Collective."""
        if not math.isfinite(t):
            raise ValueError(f"t={t}: give a finite time or load.")
        for update in self._updates:
            update()
        if isinstance(self._file, dolfinx.io.XDMFFile):
            has_moved = not np.array_equal(self._nodes, self._mesh.geometry.x)
            if self._mesh.comm.allreduce(has_moved, op=MPI.LOR):
                self._write_mesh(self._file)
            grid = f"/Xdmf/Domain/Grid[@GridType='Uniform'][{self._meshes}]"
            for copy in self._copies:
                self._file.write_function(copy, t, grid)
        elif self._file is not None:
            self._file.write(t)
        if self._cloud is not None and self._x is not None:
            x = self._x()
            values = {name: value().reshape(len(x), -1) for name, value in self._at_points.items()}
            self._cloud.write(float(t), x, values)

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
        self._meshes = self._meshes + 1
        name = mesh.name
        if self._meshes > 1:
            mesh.name = f"{name}_{self._meshes}"
        file.write_mesh(mesh)
        mesh.name = name
        self._nodes = mesh.geometry.x.copy()

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
                self._add_at_vertices(name, field)
            elif rule is not None and quadrature == "points":
                self._add_at_points(name, field, rule[0])
            else:
                is_continuous = isinstance(field, dolfinx.fem.Function) and _is_continuous(field)
                degree = geometry_degree(mesh) if self._kind == "vtx" or is_continuous else 0
                family = "Lagrange" if is_continuous and self._kind == "xdmf" else "DG"
                space = dolfinx.fem.functionspace(mesh, (family, degree, field.ufl_shape))
                copy = dolfinx.fem.Function(space, name=name)
                update = _updater(field, copy, rule)
                update()  # raises errors now, not at the first step
                self._copies.append(copy)
                self._updates.append(update)
        except (NotImplementedError, RuntimeError, TypeError, ValueError) as error:
            raise ValueError(
                f"The field {name!r} cannot be written: {error_message(error)}"
            ) from error

    def _add_at_vertices(self, name: str, field: dolfinx.fem.Function | Expr) -> None:
        """Add the values of a function on a mesh of vertices."""
        if not isinstance(field, dolfinx.fem.Function):
            raise ValueError("it is an expression on a mesh of points, where only functions live.")
        mesh = self._mesh
        V = field.function_space
        n = mesh.topology.index_map(0).size_local
        nodes = geometry_dofmap(mesh)[:n, 0]
        dofs = V.dofmap.list[:n, 0]

        def coordinates() -> Array:
            return np.asarray(mesh.geometry.x[nodes], dtype=np.float64)

        def values() -> Array:
            return np.asarray(field.x.array.reshape(-1, V.dofmap.bs)[dofs])

        self._x = coordinates
        self._at_points[name] = values

    def _add_at_points(self, name: str, field: Expr, points: Array) -> None:
        """Add the values at quadrature points, which are the same for all fields of the file.

        Args:
            name: Name of the field.
            field: The field.
            points: The points in the reference cell, (points, tdim).
        """
        mesh = self._mesh
        gdim = self._mesh.geometry.dim
        if self._rule is None:
            evaluate_x = _evaluator(ufl.SpatialCoordinate(mesh), mesh, points)

            def coordinates() -> Array:
                x = evaluate_x().reshape(-1, gdim)
                return np.pad(x, ((0, 0), (0, 3 - gdim)))  # zero out of the plane

            self._x = coordinates
            self._rule = points
        elif not same_points(self._rule, points):
            raise ValueError("its quadrature points are others than those of the fields before it.")
        self._at_points[name] = _evaluator(field, mesh, points)


def cell_values(expression: Expr, mesh: dolfinx.mesh.Mesh) -> Array:
    """Return a scalar or vector at the centroids of the owned cells, (n_cells, …). Collective.

    For data at quadrature points it is their mean.
    """
    rule = quadrature_rule(expression)
    cell = getattr(basix.CellType, mesh.topology.cell_name())
    points = np.asarray(basix.geometry(cell)).mean(axis=0, keepdims=True)
    points, weights = (points, np.ones(1)) if rule is None else rule
    values = _evaluator(expression, mesh, points)()
    means = np.tensordot(values, weights / weights.sum(), axes=(1, 0))
    return np.asarray(means).reshape(len(values), *expression.ufl_shape)


def _checked_kind(kind: str | None, mesh: dolfinx.mesh.Mesh) -> str:
    """Return the format of the file, ``vtx`` or ``xdmf``.

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


def _evaluator(field: Expr, mesh: dolfinx.mesh.Mesh, points: Array) -> Callable[[], Array]:
    """Return a function that evaluates a field in the owned cells, (cells, points, components)."""
    on_mesh = dolfinx.fem.Constant(mesh, np.float64(1.0)) * field  # a number knows no mesh
    compiled = Compiler(mesh.comm).expression(on_mesh, points)
    cells = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)

    def values() -> Array:
        if not len(cells):
            return np.zeros((0, len(points), int(np.prod(field.ufl_shape))))
        return np.asarray(compiled.eval(mesh, cells)).reshape(len(cells), len(points), -1)

    return values


def _updater(
    field: dolfinx.fem.Function | Expr, copy: dolfinx.fem.Function, rule: tuple[Array, Array] | None
) -> Callable[[], object]:
    """Return a function that interpolates a field, or projects data at quadrature points."""
    V = copy.function_space
    if rule is None and isinstance(field, dolfinx.fem.Function):
        if field.function_space.ufl_element().pullback == ufl.identity_pullback:
            return lambda: copy.interpolate(field)
    points, weights = (interpolation_points(V), None) if rule is None else rule
    values = _evaluator(field, V.mesh, points)
    project = None
    if weights is not None:
        φ = V.element.basix_element.tabulate(0, points)[0, :, :, 0]
        project = projection(φ, weights)

    def update() -> None:
        coefficients = values()
        if project is not None:
            coefficients = np.einsum("iq,cqk->cik", project, coefficients)  # c = Π f
        copy.x.array.reshape(-1, V.dofmap.bs)[V.dofmap.list[: len(coefficients)]] = coefficients
        copy.x.scatter_forward()

    return update


def _writable_place(path: Path, kind: str, comm: MPI.Comm) -> Path:
    """Return the path with its suffix, after a check that files can be written there. Collective.

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
    """Open a file for writing, without a change; an OSError if it cannot be opened."""
    path.open("ab").close()
