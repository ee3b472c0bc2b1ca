# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checkpoints are read back or refused; failed writes and killed runs keep the last state."""

from __future__ import annotations

import contextlib
import os
import resource
import shutil
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from collective import COMM, agree, equal, raises
from problems import cube
from wall_files import on_first
from walls import create_mesh

import dolfinx

from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.loading.identity import describe_problem, differences

PARAMETERS = {"kappa": 1000.0, "layers": [29, 62], "law": "HGO"}
ROUNDING = 1e-14


class Fields:
    """A quadratic vector and a number for each cell, on a cube."""

    def __init__(self, n: int = 2, *, degree: int = 2, scale: float = 1.0) -> None:
        mesh = cube(3, n)
        mesh.geometry.x[:] *= scale
        V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        Q = dolfinx.fem.functionspace(mesh, ("DG", 0))
        self.functions = [dolfinx.fem.Function(V), dolfinx.fem.Function(Q)]

    def set(self, t: float) -> list[np.ndarray]:
        """Set the functions to known values and return them."""
        u, p = self.functions
        u.interpolate(lambda x: np.stack([x[0] ** 2, t + x[1] * x[2], 1 - t * x[2]]))
        p.interpolate(lambda x: t - x[0] + 2 * x[1])
        return [f.x.array.copy() for f in self.functions]


def opened(folder: Path, restart: bool = True, **other: object) -> Checkpoint:
    """Open a checkpoint; further parameters replace those of ``PARAMETERS``."""
    return Checkpoint(folder, COMM, parameters=PARAMETERS | other, restart=restart)


def written(folder: Path, state: Fields, *times: float) -> Checkpoint:
    """Write states of some times to a folder, and reset the functions to zero."""
    checkpoint = opened(folder, restart=False)
    for t in times:
        state.set(t)
        checkpoint.write(state.functions, {"t": t})
    for f in state.functions:
        f.x.array[:] = 0.0
    return checkpoint


def check(folder: Path, state: Fields, t: float) -> None:
    """Require the folder's state to be that of one time."""
    checkpoint = opened(folder)
    past = checkpoint.read(state.functions)
    found = [f.x.array.copy() for f in state.functions]
    agree(past == [] and checkpoint.record == {"t": t}, checkpoint.record)
    for actual, expected in zip(found, state.set(t), strict=True):
        equal(actual, expected, ROUNDING)


def content(folder: Path) -> dict[str, bytes]:
    """Return the bytes of each file of a folder, by its path."""
    return on_first(
        lambda: {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*.*[!p]")}
    )


@pytest.fixture
def state() -> Fields:
    return Fields()


def test_checkpoint_restores_state_and_record(tmp_path, state):
    """A checkpoint restores state and record, also on an equal mesh that is created anew."""
    before = [state.set(1.0), state.set(2.0)]
    now = state.set(3.0)
    record = {"load": 3.0, "nan": np.float64("nan"), "steps": [{"n": np.int32(4)}], "name": "κ"}
    checkpoint = opened(tmp_path / "new/run", restart=False)
    agree(checkpoint.record is None)
    checkpoint.write(state.functions, record, before)
    for other in (state, Fields()):
        for f in other.functions:
            f.x.array[:] = -1.0
        again = opened(tmp_path / "new/run")
        past = again.read(other.functions)
        present = [f.x.array for f in other.functions]
        for found, expected in zip([*past, present], [*before, now], strict=True):
            for actual, values in zip(found, expected, strict=True):
                equal(actual, values, ROUNDING)
        agree(again.record["load"] == 3.0 and again.record["steps"] == [{"n": 4}])
        agree(np.isnan(again.record["nan"]) and again.record["name"] == "κ")


def test_where_a_process_has_no_cell(tmp_path):
    """A checkpoint restores a function on a mesh that leaves processes without cells."""
    mesh = create_mesh(COMM, np.vstack([np.zeros(3), np.eye(3)]), np.arange(4)[None])
    f = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 1)))
    f.interpolate(lambda x: 1.0 + x[0])
    before = f.x.array.copy()
    opened(tmp_path, restart=False).write([f], {})
    f.x.array[:] = 0.0
    opened(tmp_path).read([f])
    equal(f.x.array, before)


@pytest.mark.parametrize(
    ("version", "expected"),
    [(dolfinx.__version__, False), ("0.1.2", True)],
    ids=["same_version", "other_version"],
)
def test_other_forms_of_another_version(state, version, expected):
    """Of another version, the error names both versions, and a remedy if only the forms differ."""
    here = describe_problem(state.functions, None, []) | {"forms": "a"}
    there = here | {"forms": "b", "dolfinx": version}
    (text,) = differences(there, here, compare_forms=True)
    agree("numbers in them, differ" in text, text)
    agree((f"dolfinx 0.1.2, and this is {dolfinx.__version__}" in text) == expected, text)
    agree(("allow_changes=True" in text) == expected, text)


@pytest.mark.parametrize(
    ("mesh", "parameters", "match"),
    [
        ({"n": 3}, {}, "cells are 48 there and 162 here; vertices are 27 there and 64 here"),
        ({"degree": 1}, {}, r"elements are .*, 2, .* there and .*, 1, .* here"),
        ({"scale": 1 + 1e-6}, {}, "the extent of the mesh or the order of its cells differs"),
        ({}, {"kappa": 1e5}, "kappa is 1000.0 there and 100000.0 here"),
        (
            {},
            {"layers": [29, 61], "law": "NH"},
            r"law is HGO there and NH here; layers is \[29, 62\]",
        ),
        ({}, {"c": 3.0}, "c is not given there and 3.0 here"),
    ],
)
def test_checkpoint_of_another_problem_is_refused(tmp_path, state, mesh, parameters, match):
    """A checkpoint of another problem is refused, with folder and functions unchanged."""
    written(tmp_path, state, 1.0)
    before = content(tmp_path)
    other = Fields(**mesh)
    values = other.set(5.0)
    with raises(ValueError, f"is one of another problem: {match}.*Restart .*, or name another"):
        opened(tmp_path, **parameters).read(other.functions)
    agree(content(tmp_path) == before and len(before) == 1)
    for f, array in zip(other.functions, values, strict=True):
        equal(f.x.array, array)


def test_cells_in_another_order(tmp_path):
    """A mesh with its cells in another order is refused, although sizes and extent agree."""
    i = np.arange(15)  # a helix of tetrahedra
    x = np.column_stack([np.cos(2.3 * i), np.sin(2.3 * i), 0.6 * i])
    cells = i[:12, None] + i[:4]
    one, same, other, turned = (
        dolfinx.fem.Function(dolfinx.fem.functionspace(create_mesh(COMM, x, c), ("DG", 0)))
        for c in (cells, cells, cells[::-1], cells[:, ::-1])
    )
    checkpoint = opened(tmp_path, restart=False)
    checkpoint.write([one], {})
    checkpoint.read([same])
    for wrong in (other, turned):
        with raises(ValueError, "order of its cells differs"):
            checkpoint.read([wrong])


def test_records_that_cannot_be_written_are_refused(tmp_path, state):
    """Parameters and records that cannot be written are refused.

    Only the record of the first process is written.
    """
    law = "NH" if COMM.rank < COMM.size - 1 else object()
    with raises(ValueError, r"parameters\['law'\] is <.*>: give numbers, strings, or lists"):
        opened(tmp_path / "run", restart=False, law=law)
    agree(not (tmp_path / "run").exists())
    checkpoint = opened(tmp_path, restart=False)
    bad = {"load": object()}
    checkpoint.write(state.functions, bad if COMM.rank else {"load": 1.0})
    agree(checkpoint.record == {"load": 1.0})
    with raises(TypeError, "record holds <.*>: give numbers"):
        checkpoint.write(state.functions, {"load": 1.0} if COMM.rank else bad)
    agree(checkpoint.record == opened(tmp_path).record == {"load": 1.0})


def test_folders_that_are_refused(tmp_path, state):
    """Folders without a state, with an earlier run's, or below a file are refused."""
    written(tmp_path / "old", state, 1.0)
    on_first(lambda: (tmp_path / "notes").write_text("mine"))
    with raises(FileNotFoundError, "no .*state.npz to restart from: name the folder of an"):
        opened(tmp_path / "nowhere")
    with raises(FileExistsError, "holds the checkpoint of an earlier run: restart from it, or"):
        opened(tmp_path / "old", restart=False)
    with raises(OSError, "folder .*notes/run cannot be written"):
        opened(tmp_path / "notes/run", restart=False)
    agree(not (tmp_path / "nowhere").exists())
    check(tmp_path / "old", state, 1.0)
    with raises(ValueError, "There is no state in .* yet"):
        opened(tmp_path / "new", restart=False).read(Fields().functions)


@pytest.mark.parametrize("damage", ["empty", "short", "flipped", "other"])
def test_damaged_states_are_detected_when_opened(tmp_path, state, damage):
    """A damaged state is detected when the folder is opened."""
    written(tmp_path, state, 1.0)
    path = tmp_path / "state.npz"

    def spoil() -> None:
        old = path.read_bytes()
        half = len(old) // 2
        if damage == "other":
            np.savez(path, u=np.zeros(3))
            return
        path.write_bytes(
            {
                "empty": b"",
                "short": old[:half],
                "flipped": old[:half] + bytes([old[half] ^ 1]) + old[half + 1 :],
            }[damage]
        )

    on_first(spoil)
    with raises(ValueError, "state.npz is damaged, or no checkpoint of this version: name another"):
        opened(tmp_path)


# -- interrupted


def test_full_disk_keeps_the_last_state(tmp_path):
    """A full disk on the first process is an error on all; the last state is kept."""
    state = Fields(8)  # its arrays are not sent before they are received
    none = opened(tmp_path / "none", restart=False)
    checkpoint = written(tmp_path / "one", state, 1.0)
    state.set(2.0)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 12 if COMM.rank == 0 else soft, hard))
    try:
        with raises(OSError, r"state.npz cannot be written \(File too large.*one before it is"):
            checkpoint.write(state.functions, {"t": 2.0})
        with raises(OSError, r"state.npz cannot be written \(File too large.*there is none yet"):
            none.write(state.functions, {"t": 2.0})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    agree(checkpoint.record == {"t": 1.0} and none.record is None)
    agree([path.name for path in (tmp_path / "one").iterdir()] == ["state.npz"])
    agree(list((tmp_path / "none").iterdir()) == [])
    check(tmp_path / "one", state, 1.0)
    state.set(3.0)  # there is room again
    checkpoint.write(state.functions, {"t": 3.0})
    check(tmp_path / "one", state, 3.0)


@pytest.mark.processes(2, 3)
def test_memory_of_the_first_process(tmp_path):
    """The first process holds at most one array of another process at a time."""
    state = Fields(8)
    checkpoint = opened(tmp_path, restart=False)
    past = [state.set(float(t)) for t in range(50)]
    checkpoint.write(state.functions, {"t": 0.0})
    tracemalloc.start()
    checkpoint.write(state.functions, {"t": 1.0}, past)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    agree(peak < 20 * past[0][0].nbytes, (peak, past[0][0].nbytes))


class Killed(BaseException):
    """Raised in place of SIGKILL; no code of the package catches it."""


@pytest.mark.serial
@pytest.mark.parametrize(
    ("place", "name"),
    [(np.lib.format, "write_array"), (os, "fsync"), (os, "replace"), (os, "open")],
)
def test_killed_at_any_call(tmp_path, state, monkeypatch, place, name):
    """A run killed before any change of the folder leaves its old state or its new one."""
    written(tmp_path / "first", state, 1.0, 2.0)
    call = getattr(place, name)
    seen = 0
    at = 0

    def kill(*args, **options):
        nonlocal seen
        if (seen := seen + 1) > at:
            raise Killed
        return call(*args, **options)

    while seen >= at:  # until all calls are let through
        folder = tmp_path / f"{at}"
        seen = 0
        shutil.copytree(tmp_path / "first", folder)
        checkpoint = opened(folder)
        state.set(3.0)
        with monkeypatch.context() as patch, contextlib.suppress(Killed):
            patch.setattr(place, name, kill)
            checkpoint.write(state.functions, {"t": 3.0})
        (folder / "state.part").write_bytes(b"half")  # as SIGKILL leaves it
        again = opened(folder)
        t = again.record["t"]
        check(folder, state, t)
        state.set(4.0)
        again.write(state.functions, {"t": 4.0})
        check(folder, state, 4.0)
        agree([path.name for path in folder.iterdir()] == ["state.npz"])
        at += 1
    agree(t == 3.0 and at >= 1)
