# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Fibre directions are those of a tube, and equal on any number of processes."""

from __future__ import annotations

import re
from dataclasses import replace
from unittest import mock

from mpi4py import MPI

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small, whole
from ufl_values import scalar
from wall_files import ROOT, centroids, on_first, tube_wall

import dolfinx
import ufl

from dolfinx_feti.meshes.files import write_msh
from dolfinx_feti.meshes.tube import write_tube
from dolfinx_feti.meshes.vessel import write_vessel
from dolfinx_feti.runtime.petsc_options import inserted
from dolfinx_feti.wall import (
    Clamp,
    Pressure,
    Slide,
    apply_conditions,
    area,
    facets,
    fibres,
    laplace,
    read_wall,
)
from dolfinx_feti.wall.fibres import ANGLES, fibre_families, fibre_frame
from dolfinx_feti.wall.laplace import gradient, solve_laplace
from dolfinx_feti.wall.wallfile import read_wall_arrays

EXAMPLE = ROOT / "meshes/example.msh"

#: Height of a sliver in that of a good cell.
FLATNESS = 1e-4
EPS = np.finfo(float).eps


def vectors(f):
    return f.x.array.reshape(-1, 3)


def directions(frame):
    """Return the circumferential, longitudinal and transmural directions of cells, (cells, 3)."""
    return [vectors(f) for f in (frame.circumferential, frame.longitudinal, frame.transmural)]


def cylindrical(wall):
    """Return e_θ, e_z, e_r at the centroids."""
    r = centroids(wall) * [1, 1, 0]
    r /= np.linalg.norm(r, axis=1, keepdims=True)
    z = np.tile([0.0, 0.0, 1.0], (len(r), 1))
    return [np.cross(z, r), z, r]


def degrees(a, b):
    """Return the angles between unit vectors [°]."""
    sine = np.linalg.norm(np.cross(a, b), axis=1)
    cosine = np.sum(a * b, axis=1)
    return np.degrees(np.arctan2(sine, cosine))


def worst(angles):
    return COMM.allreduce(angles.max(initial=0.0), op=MPI.MAX)


def by_number(wall, values):
    """Return values of all cells in the order of the file, on every process."""
    index = wall.mesh.topology.index_map(3)
    n = index.size_local
    comm = wall.mesh.comm
    number = np.concatenate(comm.allgather(wall.mesh.topology.original_cell_index[:n]))
    return np.concatenate(comm.allgather(values[:n]))[np.argsort(number)]


def is_frame(frame):
    e0, e1, e2 = directions(frame)
    for e in (e0, e1, e2):
        equal(np.linalg.norm(e, axis=1), np.ones(len(e)), 1e-14)
    agree(np.abs(np.sum(e1 * e2, axis=1)).max(initial=0) < 1e-13)
    equal(np.cross(e0, e1), e2, 1e-13)


@pytest.mark.parametrize("scale", [1e-3, 1e-9, 1e6])
def test_nothing_depends_on_the_unit_of_length(tmp_path, scale):
    """The frame of a wall is the same in metres and in millimetres."""
    path = tmp_path / "wall.msh"
    mesh = on_first(lambda: read_wall_arrays(EXAMPLE))
    on_first(lambda: write_msh(path, replace(mesh, points=scale * mesh.points)))
    wall = read_wall(path, COMM)
    same = read_wall(EXAMPLE, COMM)
    for name in same.surfaces:
        equal(area(wall, name) / scale**2, area(same, name), 1e-9)
    for e, expected in zip(*(directions(fibre_frame(w)) for w in (wall, same)), strict=True):
        small(np.abs(by_number(wall, e) - by_number(same, expected)).max(), 1e-6)
    V = dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 1, (3,)))
    conditions = {"lumen": Pressure(), "opening_1": Clamp(), "opening_2": Slide()}
    boundary = apply_conditions(wall, dolfinx.fem.Function(V), conditions, axis="z")
    agree(boundary.energy is not None, "the pressure has a potential")


def test_surfaces_by_other_names(tmp_path):
    """Surfaces of other names may be passed, with the same frame as a result."""
    wall = read_wall(EXAMPLE, COMM)
    names = dict(zip(("inside", "outside", "below", "above"), wall.surfaces.values(), strict=True))
    other = replace(wall, surfaces=names)
    frame = fibre_frame(other, inner="inside", outer="outside", ends=["below", "above"])
    for e, expected in zip(directions(frame), directions(fibre_frame(wall)), strict=True):
        equal(e, expected, 1e-12)
    with raises(ValueError, "no surface 'lumen'"):
        fibre_frame(other, ends=["below", "above"])
    with raises(ValueError, "No surface is called opening_.*: pass their names, such as ends="):
        fibre_frame(other, inner="inside", outer="outside")
    with raises(ValueError, "but the wall has the layers wall"):
        fibre_families(replace(other, layers={"wall": 1}), frame)


# -- the tube


@pytest.mark.parametrize("quarter", [False, True])
def test_frame_of_a_tube_is_cylindrical(tmp_path, quarter):
    """In a tube the frame is e_θ, e_z, e_r, up to the angle of its polygon."""
    errors = []
    for around in (12, 24, 48):
        counts = {"around": around // 4 if quarter else around, "along": 3, "through": (1, 1)}
        wall = tube_wall(tmp_path, quarter=quarter, length=0.3, **counts)
        frame = fibre_frame(wall)
        is_frame(frame)
        pairs = zip(directions(frame), cylindrical(wall), strict=True)
        errors.append([worst(degrees(e, exact)) for e, exact in pairs])
    coarse, half, fine = np.array(errors)
    agree(np.all(half < coarse / 1.8) and np.all(fine < half / 1.8), errors)
    agree(fine.max() < 2.5, errors)


def test_laplace_problems_on_flat_cells_are_solved(tmp_path):
    """On flat cells, where CG fails, MUMPS solves the Laplace problems to rounding."""
    wall = tube_wall(tmp_path, size=0.2, length=1.0)
    z = wall.mesh.geometry.x[:, 2]
    step = np.diff(np.unique(np.round(whole(z), 9)))[0]
    z[np.isclose(z, 2.0 * step)] = step * (1.0 + FLATNESS)
    ends = {"opening_1": 0.0, "opening_2": 1.0}
    z_unit = [0.0, 0.0, 1.0]
    with (
        mock.patch.object(laplace, "DIRECT_OPTIONS", laplace.CG_OPTIONS),
        raises(ArithmeticError, "not solved"),
    ):
        solve_laplace(wall, ends)
    slope = gradient(solve_laplace(wall, ends))
    equal(slope, np.tile(z_unit, (len(slope), 1)), 1e3 * EPS / FLATNESS)
    frame = fibre_frame(wall)
    is_frame(frame)
    for e, expected in zip(directions(frame), cylindrical(wall), strict=True):
        agree(worst(degrees(e, expected)) < 6.0)  # twice what cells a tenth as high have


@pytest.mark.parametrize("angles", [None, {"media": 0.0, "adventitia": 90.0}])
def test_families_have_their_angles(tmp_path, angles):
    """Fibres have ±α from ê₀ in the plane of ê₀ and ê₁, with a jump at the interface."""
    wall = tube_wall(tmp_path, size=0.26, length=0.6)
    frame = fibre_frame(wall)
    e0, e1, e2 = directions(frame)
    families = fibre_families(wall, frame, angles)
    agree([f.name for f in families] == ["fibres_1", "fibres_2"])
    a, b = map(vectors, families)
    angles = ANGLES if angles is None else angles
    r = np.linalg.norm(centroids(wall)[:, :2], axis=1)
    α = np.where(r < 0.97 * np.cos(np.pi / 22), angles["media"], angles["adventitia"])
    for family, sign in ((a, 1), (b, -1)):
        equal(np.linalg.norm(family, axis=1), np.ones(len(a)), 1e-14)
        equal(degrees(family, e0), α, 1e-12)
        equal(np.sum(family * e1, axis=1), sign * np.sin(np.radians(α)), 1e-13)
        agree(np.abs(np.sum(family * e2, axis=1)).max(initial=0) < 1e-13)
    jump = whole(degrees(a, e0))
    equal([jump.min(), jump.max()], list(angles.values()), 1e-12)
    with raises(ValueError, "media = nan: give a finite number"):
        fibre_families(wall, frame, {"media": float("nan"), "adventitia": 62.0})


# -- inlet


def test_inlet_may_be_chosen(tmp_path):
    """The other end as inlet reverses the longitudinal and circumferential directions."""
    wall = tube_wall(tmp_path, size=0.4, length=1.0)
    forth = directions(fibre_frame(wall, inlet="opening_1"))
    back = directions(fibre_frame(wall, inlet="opening_2"))
    for sign, f, b in zip((-1, -1, 1), forth, back, strict=True):
        equal(b, sign * f, 1e-8)
    with raises(ValueError, "inlet='lumen' is not an opening; choose one of opening_1, opening_2"):
        fibre_frame(wall, inlet="lumen")
    with raises(ValueError, "There is one opening, .opening_1., but .* needs two surfaces"):
        fibre_frame(wall, ends=["opening_1"])


@pytest.mark.parametrize("wide", ["opening_1", "opening_2"])
def test_inlet_is_the_widest_opening(tmp_path, wide):
    """The default inlet is the widest opening, at either end of a cone."""

    def make():
        write_tube(tmp_path / "t.msh", size=0.4, length=1.0)
        w = read_wall_arrays(tmp_path / "t.msh")
        z = w.points[:, 2:]
        factor = 1 + 0.3 * (z if wide == "opening_2" else 1 - z)
        points = w.points * np.hstack([factor, factor, np.ones_like(z)])
        write_msh(tmp_path / "cone.msh", replace(w, points=points))

    on_first(make)
    e1 = vectors(fibre_frame(read_wall(tmp_path / "cone.msh", COMM)).longitudinal)
    direction = 1.0 if wide == "opening_1" else -1.0
    agree(np.all(direction * e1[:, 2] > 0.5), wide)


# -- any number of processes


@pytest.fixture(scope="module")
def vessel(tmp_path_factory):
    """The file of a coarse vessel."""
    path = on_first(lambda: tmp_path_factory.mktemp("vessel") / "vessel.msh")
    on_first(lambda: write_vessel(path, size=2.4))
    return path


def test_the_same_on_one_process(vessel):
    """The frame is the same on one process and on several."""
    alone = read_wall(vessel, MPI.COMM_SELF)
    common = read_wall(vessel, COMM)
    frames = fibre_frame(alone), fibre_frame(common)
    is_frame(frames[1])
    for f, g in zip(*map(directions, frames), strict=True):
        equal(by_number(common, g), by_number(alone, f), 1e-9)
    families = fibre_families(alone, frames[0]), fibre_families(common, frames[1])
    for f, g in zip(*families, strict=True):
        equal(by_number(common, vectors(g)), by_number(alone, vectors(f)), 1e-8)


def test_vessel_points_outwards(vessel):
    """In a vessel ê₂ leaves through the outer wall, and ê₁ leads from the inlet to the outlets.

    The angle of ê₂ to the outer surface is nowhere below 12°, and above 64° on most of it.
    """
    wall = read_wall(vessel, COMM)
    frame = fibre_frame(wall)
    e = dolfinx.fem.Function(frame.transmural.function_space)
    along = ufl.inner(e, ufl.FacetNormal(wall.mesh))
    signs = {"outer": 1, "lumen": -1, "opening_1": -1, "opening_2": 1, "opening_3": 1}
    for name, sign in signs.items():
        part = frame.transmural if name in ("outer", "lumen") else frame.longitudinal
        e.x.array[:] = sign * part.x.array
        found = np.sort(facets(wall, name))
        tags = dolfinx.mesh.meshtags(wall.mesh, 2, found, np.ones_like(found))
        ds = ufl.Measure("ds", wall.mesh, subdomain_data=tags)(1, degree=1)
        away, most = (
            scalar(ufl.conditional(ufl.gt(along, least), 1.0, 0.0) * ds) / area(wall, name)
            for least in (0.2, 0.9)
        )
        agree(away > 1.0 - 1e-12 and most > 0.5, (name, away, most))


# -- the guard


def spoiled(wall, frame, where):
    """Return the transmural gradients, scaled by 1e-4 in the cells numbered ``where``."""
    gradient = vectors(frame.transmural).copy()
    number = wall.mesh.topology.original_cell_index
    gradient[np.isin(number, where)] *= 1e-4
    return gradient


def test_weak_gradients_take_their_neighbours_direction(tmp_path):
    """Single cells, and a ring that takes several rounds; serial and parallel agree.

    One element spans 16° of the tube.
    """
    file = tmp_path / "t.msh"
    on_first(lambda: write_tube(file, size=0.26, length=2.0))
    found = []
    for comm in (MPI.COMM_SELF, COMM):
        wall = read_wall(file, comm)
        frame = fibre_frame(wall)
        x = by_number(wall, centroids(wall))
        alone = np.random.default_rng(6120).choice(len(x), len(x) // 20, replace=False)
        ring = np.flatnonzero(np.abs(x[:, 2] - 1.0) < 0.35)
        zero = np.zeros((len(vectors(frame.transmural)), 3))
        for where, limit in ((alone, 8), (ring, 16)):
            e = fibres._unit_directions(wall, spoiled(wall, frame, where), zero)
            found.append(by_number(wall, e))
            truth = by_number(wall, cylindrical(wall)[2])
            small(degrees(found[-1], truth).max(), limit)
        across = fibres._unit_directions(
            wall, spoiled(wall, frame, ring), vectors(frame.longitudinal)
        )
        small(np.abs(np.sum(across * vectors(frame.longitudinal), axis=1)).max(initial=0), 1e-13)
        found.append(by_number(wall, across))
    for serial, parallel in zip(found[:3], found[3:], strict=True):
        equal(parallel, serial, 1e-8)


def test_no_direction_anywhere(tmp_path):
    """If all gradients vanish, the error says that cells have no direction."""
    wall = tube_wall(tmp_path, size=0.4, length=0.4)
    n = len(centroids(wall))
    with raises(ArithmeticError, "cells of the wall have no direction"):
        fibres._unit_directions(wall, np.zeros((n, 3)), np.zeros((n, 3)))


# -- a wall of one's own, end to end


def test_the_readmes_gmsh_example(tmp_path, monkeypatch):
    """The Gmsh example of README.md creates a wall that can be solved."""
    pytest.importorskip("gmsh")
    readme = (ROOT / "meshes/README.md").read_text(encoding="utf-8")
    code = re.findall(r"```python\n(.*?)```", readme, re.DOTALL)[0]
    monkeypatch.chdir(tmp_path)
    on_first(lambda: exec(code, {}))
    wall = read_wall(tmp_path / "own_wall.msh", COMM)
    agree(set(wall.names) == {"media", "adventitia", "lumen", "outer", "opening_1", "opening_2"})
    frame = fibre_frame(wall)
    is_frame(frame)
    equal(np.abs(vectors(frame.longitudinal)[:, 2]) > 0.9, np.ones(len(centroids(wall))))
    a, b = fibre_families(wall, frame)
    equal(np.linalg.norm(vectors(a), axis=1), np.ones(len(vectors(b))), 1e-13)


# -- bad input


def test_unsolved_laplace_problem(tmp_path):
    """A Laplace problem that does not converge is an error with its reason and option."""
    wall = tube_wall(tmp_path, size=0.4, length=0.4)
    options = {"ksp_type": "cg", "pc_type": "none", "ksp_max_it": 1}
    with (
        inserted("fibres_", options),
        raises(ArithmeticError, r"not solved \(reason -3\).*-fibres_ksp_type"),
    ):
        fibre_frame(wall)
