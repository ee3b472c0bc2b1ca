# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pictures: what is drawn, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, raises, small
from wall_files import on_first

import dolfinx
import ufl

from dolfinx_feti import LinearProblem
from dolfinx_feti.meshes.walls import create_tube_wall
from dolfinx_feti.output import pictures
from dolfinx_feti.output.pictures.composition import DPI, TITLE_HEIGHT, WIDTH
from dolfinx_feti.output.pictures.drawing import colour_ranges
from dolfinx_feti.output.pictures.fibre_lines import LENGTH
from dolfinx_feti.wall import fibre_families, fibre_frame

pytest.importorskip("pyvista")


@pytest.fixture(scope="module")
def beam() -> LinearProblem:
    """A beam bent by its weight."""
    mesh = dolfinx.mesh.create_box(COMM, [[0.0, 0.0, 0.0], [4.0, 1.0, 1.0]], [8, 2, 2])
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    left = dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[0], 0.0))
    bc = dolfinx.fem.dirichletbc(np.zeros(3), dolfinx.fem.locate_dofs_topological(V, 2, left), V)
    L = -0.01 * v[2] * ufl.dx
    problem = LinearProblem(a, L, bcs=[bc], subdomains=4)
    problem.solve()
    return problem


def read(path) -> np.ndarray:
    """Return the picture as an array, (height, width, 4)."""
    from matplotlib.image import imread

    return on_first(lambda: imread(path))


def test_field_and_subdomains_side_by_side(beam, tmp_path):
    """Two panels give a transparent picture of the stated width, filled by the bodies."""
    picture = pictures.draw(
        tmp_path / "new" / "beam.png",
        pictures.subdomains(beam, title="4 subdomains"),
        pictures.field(beam.u, "displacement |u| [mm]", displacement=beam.u, title="bent"),
    )
    image = read(picture.path)
    agree(image.shape[1] == WIDTH * DPI, image.shape)
    agree(image[0, 0, 3] == 0.0)
    columns = np.flatnonzero((image[:, :, 3] > 0).any(axis=0))
    agree(columns[0] < 60 and columns[-1] > image.shape[1] - 60, columns[[0, -1]])
    agree(on_first(lambda: len(picture._repr_png_())) > 1000)


def test_texts_follow_the_background(beam, tmp_path):
    """The title is dark on a light background, and light on a dark one."""
    for dark in (False, True):
        picture = pictures.draw(
            tmp_path / f"{dark}.png", pictures.subdomains(beam, title="MMMM"), dark=dark
        )
        title = read(picture.path)[: int(0.7 * TITLE_HEIGHT * DPI)]
        opaque = title[title[:, :, 3] > 0.9]
        agree((opaque[:, :3].mean() > 0.7) == dark, opaque.mean())


def test_colours_of_panels_with_one_label_are_those_of_one_scale(beam, tmp_path):
    """Panels with one label share a scale up to the percentile 99 of both."""
    panel = pictures.field(beam.u, "|u|")
    doubled = pictures.field(2 * beam.u, "|u|")

    def look() -> tuple[float, float]:
        ranges = colour_ranges([panel, doubled], None)
        return ranges["|u|"][1], doubled.surface.values.max()

    end, largest = on_first(look)
    agree(0.9 * largest < end <= largest)
    pictures.draw(tmp_path / "limits.png", panel, limits=(0.0, 1.0), colours="plasma")


def test_fibres_follow_the_layer(tmp_path):
    """Fibre lines stay near the surface of their layer, and have the given length."""
    wall = create_tube_wall(COMM, size=0.5)
    families = fibre_families(wall, fibre_frame(wall))
    panel = pictures.fibres(wall, families, "media", title="media")

    def look() -> list[tuple[float, float]]:
        found = []
        for lines in panel.lines:
            radius = np.hypot(lines[..., 0], lines[..., 1])
            off = np.minimum(np.abs(radius - 0.71), np.abs(radius - 0.97))
            steps = np.linalg.norm(np.diff(lines, axis=1), axis=2)
            found.append((float(np.median(off)), float(np.median(steps.sum(axis=1)))))
        return found

    found = on_first(look)
    agree(len(found) == 2)
    for off, length in found:
        agree(off < 0.03)
        small(length / (3 * LENGTH) - 1.0, 0.1)
    pictures.draw(tmp_path / "fibres.png", panel)
    many = pictures.fibres(wall, [*families, *families], "media")
    pictures.draw(tmp_path / "four.png", many)  # the fourth family has the first one's colour
    with raises(ValueError, "no layer 'intima'; it has .*media"):
        pictures.fibres(wall, families, "intima")
    with raises(ValueError, "families is empty: give one direction at least"):
        pictures.fibres(wall, [], "media")


def test_plane_body(tmp_path):
    """A plane body is drawn."""
    mesh = dolfinx.mesh.create_unit_square(COMM, 4, 4)
    picture = pictures.draw(
        tmp_path / "plane.png", pictures.field(ufl.SpatialCoordinate(mesh)[0], "x")
    )
    agree(read(picture.path).std() > 0.1)


def test_mesh_for_scenes_of_any_kind(beam):
    """``mesh()`` returns a PyVista mesh with the values, on the first process only."""
    mesh = pictures.field(beam.u, "|u|").mesh()
    agree((mesh is None) == (COMM.rank > 0))
    agree(mesh is None or mesh.point_data["values"].max() > 0.0)


def test_nothing_to_draw(tmp_path):
    """A picture without panels, and a field without a mesh, are refused."""
    with raises(ValueError, "nothing to draw: give a panel"):
        pictures.draw(tmp_path / "none.png")
    with raises(ValueError, "lives on no mesh"):
        pictures.field(ufl.as_ufl(1.0), "one")


def test_arguments_in_another_order(beam, tmp_path):
    """A panel in place of the path, and a Function in place of a panel, are refused."""
    panel = pictures.field(beam.u, "|u|")
    with raises(TypeError, "path is FieldPanel.*give the name of the file first"):
        pictures.draw(panel, tmp_path / "wall.png")
    with raises(TypeError, "is no panel: give the result of field"):
        pictures.draw(tmp_path / "wall.png", beam.u)


def test_picture_that_cannot_be_written(beam, tmp_path):
    """If a picture cannot be written, all processes raise the error."""
    on_first(lambda: (tmp_path / "wall.png").mkdir())
    with raises(IsADirectoryError, "wall.png"):
        pictures.draw(tmp_path / "wall.png", pictures.field(beam.u, "|u|"))


@pytest.mark.serial
def test_machine_without_a_library_to_draw(monkeypatch, beam, tmp_path):
    """Without a graphics library an error is raised, where VTK would end the process."""
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("VTK_DEFAULT_OPENGL_WINDOW", raising=False)
    monkeypatch.setattr("ctypes.util.find_library", lambda name: None)
    with raises(RuntimeError, "apt install libegl1"):
        pictures.draw(tmp_path / "none.png", pictures.field(beam.u, "|u|"))


def test_without_pyvista(monkeypatch, beam):
    """Without PyVista the error explains how to install it."""
    monkeypatch.setattr("importlib.util.find_spec", lambda *_: None)
    with raises(ImportError, "pip install .pyvista"):
        pictures.subdomains(beam)
