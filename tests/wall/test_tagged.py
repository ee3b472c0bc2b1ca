# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Walls from meshes with tags of Gmsh or dolfinx, and conditions on them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from cases import each
from collective import COMM, agree, equal, raises
from pages import programs
from ufl_values import scalar

import dolfinx
import ufl

from dolfinx_feti import LinearProblem, loads
from dolfinx_feti.wall import (
    Clamp,
    Pressure,
    Slide,
    Spring,
    apply_conditions,
    area,
    by_layer,
    create_wall,
    read_wall,
    surface_measure,
)

CELLS = [dolfinx.mesh.CellType.tetrahedron, dolfinx.mesh.CellType.hexahedron]
SIZES = np.array([2.0, 1.0, 0.5])
NAMES = {"end": (2, 4), "below": (2, 0), "left": (3, 7), "right": (3, 8)}


def box(cell=CELLS[0]):
    """Return a mesh with the layers 7 and 8, and the surfaces 4 (x = 0), 5 (x = 2), 0 (z = 0)."""
    mesh = dolfinx.mesh.create_box(COMM, [np.zeros(3), SIZES], (4, 2, 2), cell)
    cells = mesh.topology.index_map(3)
    n = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
    half = dolfinx.mesh.compute_midpoints(mesh, 3, n)[:, 0] > 1.0
    cell_tags = dolfinx.mesh.meshtags(mesh, 3, n, np.where(half, 8, 7).astype(np.int32))
    planes = ((4, 0, 0.0), (5, 0, 2.0), (0, 2, 0.0))
    found = [
        dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x, k=k, at=at: np.isclose(x[k], at))
        for _, k, at in planes
    ]
    facets = np.concatenate(found)
    values = np.repeat([tag for tag, *_ in planes], [len(f) for f in found]).astype(np.int32)
    order = np.argsort(facets)
    return mesh, cell_tags, dolfinx.mesh.meshtags(mesh, 2, facets[order], values[order])


@pytest.mark.parametrize("cell", CELLS)
def test_names_by_hand(cell):
    """Tags without a name are named by their number, and names without a tag are omitted."""
    wall = create_wall(*box(cell), NAMES | {"nothing": (2, 9), "edge": (1, 4)})
    agree(wall.layers == {"left": 7, "right": 8}, wall.layers)
    agree(wall.surfaces == {"end": 4, "below": 0, "surface_5": 5}, wall.surfaces)
    found = [area(wall, name) for name in ("end", "surface_5", "below")]
    equal(found, [0.5, 0.5, 2.0], 1e-13)
    equal(scalar(by_layer(wall, {"left": 1.0, "right": 3.0}) * ufl.dx), 2.0, 1e-13)


@pytest.mark.parametrize("cell", CELLS)
def test_without_layers_and_names(cell):
    """Without names, facets tagged 0 are not a surface."""
    mesh, _, facet_tags = box(cell)
    wall = create_wall(mesh, None, facet_tags)
    agree((wall.layers, wall.surfaces) == ({"wall": 1}, {"surface_4": 4, "surface_5": 5}))


@pytest.mark.parametrize("cell", CELLS)
def test_body_under_pressure(cell):
    """A wall from tags, under pressure and on springs, has plain dolfinx's solution."""
    wall = create_wall(*box(cell), NAMES)
    V = dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 1, (3,)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    rest = dolfinx.fem.Function(V)
    conditions = {"end": Clamp(), "below": Slide(), "surface_5": [Pressure(), Spring(2.0)]}
    boundary = apply_conditions(wall, rest, conditions)
    boundary.pressure.value = 0.1
    inside = ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * ufl.dx
    ds = surface_measure(wall)(5)
    n = ufl.FacetNormal(wall.mesh)
    springs = 2.0 * ufl.dot(u, n) * ufl.dot(v, n) * ds
    springs += loads.follower_pressure_tangent(0.1, rest, v, u, ds, "full")
    solutions = [
        LinearProblem(inside + a, L, bcs=boundary.bcs, petsc_options={"ksp_rtol": 1e-10}).solve()
        for a, L in ((boundary.tangent, -boundary.residual), (springs, -0.1 * ufl.dot(n, v) * ds))
    ]
    by_conditions, by_hand = solutions
    equal(by_conditions.x.array, by_hand.x.array, 1e-7)


# -- Gmsh's models


def test_names_of_physical_groups():
    """Physical groups of a Gmsh model give layers and surfaces their names, or their numbers."""
    gmsh = pytest.importorskip("gmsh")
    try:
        from dolfinx.io import gmshio
    except ImportError:  # since dolfinx 0.10
        from dolfinx.io import gmsh as gmshio
    if COMM.rank == 0:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("cube")
        gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
        gmsh.model.occ.synchronize()
        gmsh.model.addPhysicalGroup(3, [1], 3, "muscle")
        gmsh.model.addPhysicalGroup(2, [1], 4, "fixed")  # x = 0
        for face, tag in ((3, 6), (6, 5)):  # y = 0, z = 1
            gmsh.model.addPhysicalGroup(2, [face], tag)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
        gmsh.model.mesh.generate(3)
    data = gmshio.model_to_mesh(gmsh.model, COMM, 0)
    groups = {}
    if COMM.rank == 0:
        groups = {gmsh.model.getPhysicalName(*g): g for g in gmsh.model.getPhysicalGroups()}
        gmsh.finalize()
    for names in (groups, groups or None):
        wall = create_wall(*data[:3], names)
        agree(wall.layers == {"muscle": 3}, wall.layers)
        agree(wall.surfaces == {"fixed": 4, "surface_5": 5, "surface_6": 6}, wall.surfaces)
    equal([area(wall, "fixed"), area(wall, "surface_5")], [1.0, 1.0], 1e-12)
    if hasattr(data, "physical_groups"):
        agree(create_wall(*data[:3], data.physical_groups).surfaces["fixed"] == 4)


def test_the_lines_of_the_page(tmp_path, monkeypatch):
    """The code of docs/walls.md leads from a Gmsh model to a solved wall."""
    pytest.importorskip("gmsh")
    monkeypatch.chdir(tmp_path)
    (code,) = programs("A wall from a Gmsh model", "docs/walls.md")
    names: dict[str, Any] = {"comm": COMM, "read_wall": read_wall}
    exec(code, names)
    wall = names["wall"]
    u = names["u"]
    agree((set(wall.layers), set(wall.surfaces)) == ({"patch"}, {"rim", "above"}), wall.names)
    agree(names["problem"].solver.getConvergedReason() > 0)
    sunk = scalar(u[2] * surface_measure(wall)(wall.surfaces["above"])) / area(wall, "above")
    agree(-0.5 < sunk < -0.01)  # mm, in the mean


# -- what is refused, on all processes


class TaggedBox:
    """The box with its tags, and meshes and tags that do not fit it."""

    def __init__(self):
        self.mesh, self.cell_tags, self.facet_tags = box()

    def no_facets(self):
        none = np.zeros(0, dtype=np.int32)
        return dolfinx.mesh.meshtags(self.mesh, 2, none, none)

    def one_cell(self):
        tags = self.cell_tags
        return dolfinx.mesh.meshtags(self.mesh, 3, tags.indices[:1], tags.values[:1])


def plane():
    return dolfinx.mesh.create_unit_square(COMM, 3, 3)


#: Wrong arguments of create_wall, the error, and its message.
WRONG = {
    "no-mesh": (
        lambda b: (None, b.cell_tags, b.facet_tags),
        TypeError,
        "mesh is None: give dolfinx.mesh.Mesh",
    ),
    "facet-tags-alone": (lambda b: (None, None, b.facet_tags), TypeError, "mesh is None"),
    "no-facet-tags": (
        lambda b: (b.mesh, b.cell_tags, None),
        TypeError,
        "facet_tags is None: give dolfinx.mesh.MeshTags",
    ),
    "plane": (
        lambda b: (plane(), None, b.facet_tags),
        ValueError,
        "cells of type triangle in 2 dimensions",
    ),
    "tags-of-another-mesh": (
        lambda b: (b.mesh, b.cell_tags, box()[2]),
        ValueError,
        "facet_tags belong to another mesh",
    ),
    "cells-as-facets": (
        lambda b: (b.mesh, None, b.cell_tags),
        ValueError,
        "cell_tags are of dimension 3 and facet_tags of 3",
    ),
    "swapped": (
        lambda b: (b.mesh, b.facet_tags, b.cell_tags),
        ValueError,
        "dimension 2 and facet_tags of 3: give those of",
    ),
    "cells-without-a-layer": (
        lambda b: (b.mesh, b.one_cell(), b.facet_tags),
        ValueError,
        "cell_tags leave .* cells without a layer",
    ),
    "no-surface": (
        lambda b: (b.mesh, b.cell_tags, b.no_facets()),
        ValueError,
        "facet_tags mark no surface",
    ),
    "number-as-a-name": (
        lambda b: (b.mesh, b.cell_tags, b.facet_tags, {"end": 4}),
        TypeError,
        r"names\['end'\] is 4: give",
    ),
    "text-as-names": (
        lambda b: (b.mesh, b.cell_tags, b.facet_tags, "end"),
        TypeError,
        "names is 'end': give Mapping",
    ),
}


@each(("arguments", "error", "message"), WRONG)
def test_wrong_arguments(arguments, error, message):
    """Meshes, tags and names that do not fit together are refused."""
    with raises(error, message):
        create_wall(*arguments(TaggedBox()))


def test_loads_inside_the_wall():
    """A pressure or spring on an inner surface is an error, as ``ds`` would integrate nothing."""
    mesh, cell_tags, _ = box()
    middle = np.sort(dolfinx.mesh.locate_entities(mesh, 2, lambda x: np.isclose(x[0], 1.0)))
    tags = dolfinx.mesh.meshtags(mesh, 2, middle, np.ones_like(middle))
    wall = create_wall(mesh, cell_tags, tags, {"middle": (2, 1)})
    u = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,))))
    for condition in (Pressure(), [Slide(), Spring(1.0)]):
        with raises(ValueError, "surface 'middle' has 8 facets inside the wall, where no pressure"):
            apply_conditions(wall, u, {"middle": condition})
    agree(len(apply_conditions(wall, u, {"middle": Clamp()}).bcs) == 1)


def test_conditions_need_a_wall_and_a_displacement():
    """Conditions refuse what is not a Wall, and a u that is not a vector on its mesh."""
    mesh, *tags = box()
    wall = create_wall(mesh, *tags, NAMES)
    vectors = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    with raises(TypeError, r"wall is .*Mesh.*: give .*Wall"):
        apply_conditions(mesh, dolfinx.fem.Function(vectors), {"end": Clamp()})
    for V in (
        dolfinx.fem.functionspace(mesh, ("Lagrange", 1)),
        dolfinx.fem.functionspace(box()[0], ("Lagrange", 1, (3,))),
    ):
        with raises(ValueError, "u has the shape .*, or lives on another mesh"):
            apply_conditions(wall, dolfinx.fem.Function(V), {"end": Clamp()})
