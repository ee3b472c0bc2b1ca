# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Scenes: the file holds the surface of the panel, and needs no network."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from collective import COMM, agree, equal, raises
from wall_files import on_first

import dolfinx
import ufl

from dolfinx_feti import LinearProblem
from dolfinx_feti.meshes.walls import create_tube_wall
from dolfinx_feti.output import pictures, scenes
from dolfinx_feti.wall import fibre_families, fibre_frame

pytest.importorskip("pyvista")

#: Rounding of the points of a scene, which are stored in single precision.
SINGLE = 1e-6


def read(path: Path) -> dict[str, Any]:
    """Return the data of a scene."""

    def data() -> Any:
        text = path.read_text(encoding="utf-8")
        (content,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text)
        return json.loads(content)

    return on_first(data)


def array(text: str, dtype: str) -> np.ndarray:
    """Return a base64-encoded array of a scene as (n, 3)."""
    return np.frombuffer(base64.b64decode(text), dtype=dtype).reshape(-1, 3)


@pytest.fixture(scope="module")
def x_squared() -> dolfinx.fem.Function:
    """The function x² on a box of 4 × 1 × 1."""
    mesh = dolfinx.mesh.create_box(COMM, [[0.0, 0.0, 0.0], [4.0, 1.0, 1.0]], [8, 2, 2])
    f = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 1)))
    f.interpolate(lambda x: x[0] ** 2)
    return f


def test_scene_of_a_field(x_squared, tmp_path):
    """A scene has the points of the body over its radius, and colours that follow the field."""
    panel = pictures.field(x_squared, "x² </script>", title="box")
    scene = scenes.write_scene(tmp_path / "new/box.html", panel, limits=(0.0, 16.0))
    data = read(scene.path)
    agree((data["title"], data["label"]) == ("box", "x² </script>"), data["label"])
    agree((data["low"], data["high"]) == ("0", "16"), data["low"])
    (body,) = data["bodies"]
    points = array(body["points"], "<f4")
    radius = np.linalg.norm([4.0, 1.0, 1.0]) / 2
    expected = np.array([4.0, 1.0, 1.0]) / 2 / radius
    equal(points.max(axis=0), expected, SINGLE)
    equal(points.min(axis=0), -expected, SINGLE)
    triangles = array(body["triangles"], "<u4")
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1).sum() / 2 * radius**2
    agree(abs(area - 18.0) < 1e-4, area)
    at_corners = array(body["normals"], "i1")[triangles] / 127.0
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    agree(np.abs(at_corners - unit[:, None]).max() < 0.01)  # a box has edges
    colours = array(body["colours"], "u1")
    at_end = np.isclose(points[:, 0], expected[0])
    agree((colours[at_end] == [253, 231, 36]).all())  # the last colour of viridis
    view = np.array(data["view"])
    equal(view @ view.T, np.eye(3), 1e-12)
    agree(np.linalg.det(view) > 0.0, view)


@pytest.mark.parametrize("viewer", [(0.0, 0.0, 1.0), (0.0, 0.0, -2.0), (0.0, 1.0, 0.0)])
def test_scene_from_any_side(x_squared, tmp_path, viewer):
    """The view looks from the viewer, also if that is the upward direction."""
    panel = pictures.field(x_squared, "x²")
    view = np.array(
        read(scenes.write_scene(tmp_path / "box.html", panel, viewer=viewer).path)["view"]
    )
    equal(view @ view.T, np.eye(3), 1e-12)
    equal(view[2], np.array(viewer) / np.linalg.norm(viewer), 1e-12)


@pytest.mark.parametrize("viewer", [(0.0, 0.0, 0.0), (np.nan, 0.0, 1.0), (np.inf, 0.0, 0.0)])
def test_direction_to_the_viewer_that_is_none(x_squared, tmp_path, viewer):
    """A direction that is zero or not finite is refused, and no file is written."""
    panel = pictures.field(x_squared, "x²")
    with raises(ValueError, "viewer=.*give a finite direction that is not zero"):
        scenes.write_scene(tmp_path / "box.html", panel, viewer=viewer)
    agree(not list(tmp_path.iterdir()), list(tmp_path.iterdir()))


def test_scene_with_arguments_in_another_order(x_squared, tmp_path):
    """A panel in place of the path, and a Function in place of a panel, are refused."""
    panel = pictures.field(x_squared, "x²")
    with raises(TypeError, "path is FieldPanel.*give the name of the file first"):
        scenes.write_scene(panel, tmp_path / "box.html")
    with raises(TypeError, "is no panel: give the result of field"):
        scenes.write_scene(tmp_path / "box.html", x_squared)


def test_scene_of_a_plane_body(tmp_path):
    """A plane body is seen from above, without shading."""
    mesh = dolfinx.mesh.create_unit_square(COMM, 4, 4)
    x = ufl.SpatialCoordinate(mesh)
    data = read(scenes.write_scene(tmp_path / "square.html", pictures.field(x[0], "x")).path)
    agree(data["plane"])
    equal(data["view"], np.eye(3), 1e-12)
    height = array(data["bodies"][0]["points"], "<f4")[:, 2]
    equal(height, np.zeros(len(height)))


def test_file_needs_no_network(x_squared, tmp_path):
    """The file loads nothing from the network, and a notebook shows it in a frame."""
    scene = scenes.write_scene(tmp_path / "box.html", pictures.field(x_squared, "x²"))
    text = on_first(lambda: scene.path.read_text(encoding="utf-8"))
    agree("{{" not in text and not re.search(r"https?:|src=|href=|import ", text))
    frame = on_first(scene._repr_html_)
    agree(frame.startswith("<iframe") and "&lt;canvas" in frame and "<canvas" not in frame)


def test_scene_of_subdomains(tmp_path):
    """Each subdomain has one colour."""
    mesh = dolfinx.mesh.create_unit_cube(COMM, 4, 4, 4)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    problem = LinearProblem((u * v + ufl.inner(ufl.grad(u), ufl.grad(v))) * ufl.dx, v * ufl.dx)
    panel = pictures.subdomains(problem)
    data = read(scenes.write_scene(tmp_path / "parts.html", panel).path)
    colours = np.unique(array(data["bodies"][0]["colours"], "u1"), axis=0)
    parts = on_first(lambda: len(np.unique(panel.surface.part)))
    agree(len(colours) == parts, colours)
    agree(not data["label"] and "low" not in data)


def test_scene_of_fibres(tmp_path):
    """A scene of fibres has a body for the layer and one for each family."""
    wall = create_tube_wall(COMM, length=1.0, size=0.6)
    families = fibre_families(wall, fibre_frame(wall), {"media": 29.0, "adventitia": 62.0})
    panel = pictures.fibres(wall, list(families), "media")
    data = read(scenes.write_scene(tmp_path / "fibres.html", panel).path)
    agree(len(data["bodies"]) == 3)
    counts = [len(array(body["triangles"], "<u4")) for body in data["bodies"]]
    agree(min(counts) > 100, counts)


def test_scene_that_cannot_be_written_fails_on_all_processes(x_squared, tmp_path):
    """A scene that cannot be written is an error on all processes."""
    on_first(lambda: (tmp_path / "box.html").mkdir())
    panel = pictures.field(x_squared, "x²")
    with raises(IsADirectoryError, "box.html"):
        scenes.write_scene(tmp_path / "box.html", panel)
