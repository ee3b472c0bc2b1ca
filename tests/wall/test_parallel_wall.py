# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Walls in XDMF: reading restores what was written, and each process reads only its share."""

from __future__ import annotations

import gc
import re
from dataclasses import replace
from pathlib import Path
from unittest import mock

from mpi4py import MPI

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from ufl_values import scalar
from wall_files import ROOT, centroids, on_first

import dolfinx
import ufl

from dolfinx_feti.meshes import walls
from dolfinx_feti.meshes.bricks import create_brick_tube
from dolfinx_feti.meshes.walls import open_wall
from dolfinx_feti.wall import area, read_wall, write_wall, xdmf
from dolfinx_feti.wall.wall import extent

#: The end of the light data's list: the largest layer, and how many cells each process has written.
PARTS = re.compile(r"(parts&quot;: \[)[\d, ]*\]")

EXAMPLE = ROOT / "meshes/example.msh"


def volumes(wall):
    """Return the volume of each layer [mm³]."""
    dx = ufl.Measure("dx", wall.mesh, subdomain_data=wall.cell_tags)
    one = dolfinx.fem.Constant(wall.mesh, 1.0)
    return {name: scalar(one * dx(tag)) for name, tag in wall.layers.items()}


def same(one, other):
    agree(list(one.names.items()) == list(other.names.items()), other.names)
    for dim in (0, 3):
        count = [w.mesh.topology.index_map(dim).size_global for w in (one, other)]
        agree(count[0] == count[1], count)
    for name in one.surfaces:
        small(area(other, name) / area(one, name) - 1.0, 1e-11)
    for name, volume in volumes(one).items():
        small(volumes(other)[name] / volume - 1.0, 1e-11)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("tetrahedra", [True, False])
def test_what_is_written_is_read(tmp_path, order, tetrahedra):
    """Reading restores mesh, layers and surfaces, of straight and curved cells."""
    shape = {"length": 0.6, "size": 0.3, "order": order, "tetrahedra": tetrahedra}
    wall = create_brick_tube(COMM, **shape)
    called = wall.mesh.name, wall.cell_tags.name, wall.facet_tags.name
    path = COMM.bcast(tmp_path / "new" / "tube.xdmf")
    write_wall(path, wall)
    agree(called == (wall.mesh.name, wall.cell_tags.name, wall.facet_tags.name))
    agree(sorted(p.name for p in path.parent.iterdir()) == ["tube.h5", "tube.xdmf"])
    same(wall, read_wall(path, COMM))
    equal(extent(read_wall(path, COMM, scale=10.0).mesh), 10.0 * np.array(extent(wall.mesh)), 1e-12)


def test_parts_are_those_that_were_written(tmp_path):
    """On as many processes as wrote a file, each process reads its own part again."""
    path = COMM.bcast(tmp_path / "tube.xdmf")
    keep = xdmf._partitioner_of_file
    wall = create_brick_tube(COMM, length=0.6, size=0.15, order=1, tetrahedra=True)
    total = wall.mesh.topology.index_map(3).size_global
    uneven = np.diff(np.linspace(0.0, total**0.5, COMM.size + 1).astype(int) ** 2).tolist()
    uneven[-1] += total - sum(uneven)
    write_wall(path, wall)
    with mock.patch.object(
        xdmf, "_partitioner_of_file", lambda _, rows, comm: keep(uneven, rows, comm)
    ):
        torn = read_wall(path, COMM)
    write_wall(path, torn)
    again = read_wall(path, COMM)
    agree(again.mesh.topology.index_map(3).size_local == uneven[COMM.rank])
    equal(sorted(centroids(again).tolist()), sorted(centroids(torn).tolist()), 1e-12)
    same(wall, again)


@pytest.mark.parametrize("given", ["one alone", "not all"])
def test_tags_are_those_that_were_written(tmp_path, given):
    """Tags are restored, with one layer and with cells without a tag too."""
    wall = create_brick_tube(COMM, length=0.6, size=0.15, order=1, tetrahedra=True)
    tags = wall.cell_tags
    mesh = wall.mesh
    values = tags.values.copy()
    some = np.ones(len(tags.values), dtype=bool)
    if given == "one alone":
        values[:] = 7
    else:
        some = tags.indices % 5 > 0
    changed = dolfinx.mesh.meshtags(mesh, 3, tags.indices[some], values[some])
    names = {"wall": 7} if given == "one alone" else wall.layers
    wall = replace(wall, cell_tags=changed, layers=names)
    path = COMM.bcast(tmp_path / "tube.xdmf")
    write_wall(path, wall)
    same(wall, read_wall(path, COMM))


def test_others_partition_anew(tmp_path):
    """Files may be read on another number of processes than wrote them."""
    path = COMM.bcast(tmp_path / "tube.xdmf")
    wall = create_brick_tube(COMM, length=0.6, size=0.3, order=1, tetrahedra=True)
    write_wall(path, wall)
    alone = on_first(lambda: volumes(read_wall(path, MPI.COMM_SELF)))
    on_first(lambda: write_wall(path, read_wall(path, MPI.COMM_SELF)))
    again = read_wall(path, COMM)
    same(wall, again)
    for parts in ("", ", ".join("1" * COMM.size)):  # none, and those of another mesh
        on_first(
            lambda parts=parts: path.write_text(PARTS.sub(rf"\g<1>{parts}]", path.read_text()))
        )
        same(wall, read_wall(path, COMM))
    for name, volume in volumes(again).items():
        small(alone[name] / volume - 1.0, 1e-11)


def test_generated_walls_are_read_by_all(tmp_path):
    """The quality of generated walls does not depend on the number of processes."""
    folder = COMM.bcast(tmp_path)
    wall, quality = open_wall("tube", COMM, size=0.4, folder=folder)
    agree((folder / "tube_0.4.xdmf").is_file() and (folder / "tube_0.4.h5").is_file())
    alone = on_first(lambda: open_wall("tube", MPI.COMM_SELF, size=0.4, folder=folder)[1])
    agree(quality.histogram == alone.histogram and quality.points == alone.points)
    small(quality.mean - alone.mean, 1e-12)
    small(quality.volume / sum(volumes(wall).values()) - 1.0, 1e-11)


def test_generated_wall_is_kept_as_long_as_its_generator(tmp_path, monkeypatch):
    """A generated wall is reused until size, code or a file changes."""
    folder = COMM.bcast(tmp_path)
    made = []

    def create(path, *, size):
        made.append(size)
        for suffix in (".xdmf", ".h5"):
            path.with_suffix(suffix).write_text("a wall")

    monkeypatch.setitem(walls.GENERATORS, "tube", create)

    def prepare(size):
        on_first(lambda: walls._path_of_wall("tube", size, folder))

    for size in (0.4, 0.4, 0.5, 0.4 + 1e-9, 0.4 + 1e-9):
        prepare(size)
    on_first(lambda: (folder / "tube_0.4.sha256").write_text("of other code"))
    prepare(0.4 + 1e-9)
    on_first(lambda: (folder / "tube_0.5.h5").unlink())
    prepare(0.5)
    expected = [0.4, 0.5, 0.4 + 1e-9, 0.4 + 1e-9, 0.5]
    agree(made == (expected if COMM.rank == 0 else []), made)


def test_wrong_ending():
    """Another file ending than .xdmf is refused."""
    with raises(ValueError, "path='wall.h5': give a name that ends in .xdmf"):
        write_wall("wall.h5", read_wall(EXAMPLE, COMM))


def status(name: str) -> float:
    """Return a value of the process's status [bytes]."""
    return 1024.0 * int(re.search(rf"{name}:\s+(\d+)", Path("/proc/self/status").read_text())[1])


def read_so_far() -> int:
    """Return the number of bytes that this process has read."""
    return int(re.search(r"rchar: (\d+)", Path("/proc/self/io").read_text())[1])


@pytest.mark.skipif(not Path("/proc/self/io").exists(), reason="counted by Linux")
def test_no_process_holds_the_whole_wall(tmp_path):
    """Of P processes each reads a P-th of the file, and needs memory in proportion.

    The points of the layers are read twice, first to check that they exist. The peak of memory is
    six times the bytes read, as measured.
    """
    path = COMM.bcast(tmp_path / "tube.xdmf")
    small_one = path.with_name("small.xdmf")
    write_wall(small_one, create_brick_tube(COMM, length=0.6, size=0.3, order=1, tetrahedra=True))
    write_wall(path, create_brick_tube(COMM, length=4.0, size=0.075, order=1, tetrahedra=True))
    read_wall(small_one, COMM)  # whatever is loaded at first
    gc.collect()
    size = path.with_suffix(".h5").stat().st_size
    agree(size > 6e6)
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins here
    held = status("VmRSS")
    read = read_so_far()
    wall = read_wall(path, COMM)
    cells = wall.mesh.topology.index_map(3).size_global
    agree(read_so_far() - read < (1.05 * size + 32 * cells) / COMM.size + 1e5)
    agree(status("VmHWM") - held < 8.0 * size / COMM.size + 8e6)
    shares = COMM.allgather(wall.mesh.topology.index_map(3).size_local)
    agree(max(shares) < 1.2 * sum(shares) / COMM.size)
