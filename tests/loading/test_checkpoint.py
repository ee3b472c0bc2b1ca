# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checkpoints: read back, refused, and readable whenever the run was killed."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import json
import os
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from checkpoint_run import STEPS
from collective import COMM, agree, equal, raises, small
from problems import cube
from wall_files import ROOT, on_first
from walls import create_mesh, tube, wall

import dolfinx

from dolfinx_feti import loads
from dolfinx_feti.loading import checkpoint as module
from dolfinx_feti.loading.checkpoint import Checkpoint, describe
from dolfinx_feti.loading.load_steps import follow_load

pytest.importorskip("adios4dolfinx")

PARAMETERS = {"kappa": 1000.0, "layers": [29, 62], "law": "HGO"}
ROUNDING = 1e-14
#: What names the processes of a run to those that it starts.
LAUNCHERS = ("OMPI_", "PMIX_", "PRTE_", "PMI_")


class State:
    """A quadratic vector and a number for each cell, in a cube."""

    def __init__(self, n: int = 2, *, degree: int = 2, scale: float = 1.0) -> None:
        mesh = cube(3, n)
        mesh.geometry.x[:] *= scale
        V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        Q = dolfinx.fem.functionspace(mesh, ("DG", 0))
        self.functions = [dolfinx.fem.Function(V), dolfinx.fem.Function(Q)]

    def set(self, t: float) -> list[np.ndarray]:
        """Give the functions known values, and return them."""
        u, p = self.functions
        u.interpolate(lambda x: np.stack([x[0] ** 2, t + x[1] * x[2], 1 - t * x[2]]))
        p.interpolate(lambda x: t - x[0] + 2 * x[1])
        return [f.x.array.copy() for f in self.functions]


@pytest.fixture
def state() -> State:
    return State()


def opened(folder: Path, restart: bool = True, **other: object) -> Checkpoint:
    return Checkpoint(folder, COMM, parameters=PARAMETERS | other, restart=restart)


def written(folder: Path, state: State, *times: float) -> Checkpoint:
    """Write the states of some times, and leave the functions at zero."""
    checkpoint = opened(folder, restart=False)
    for t in times:
        state.set(t)
        checkpoint.write(state.functions, {"t": t})
    for f in state.functions:
        f.x.array[:] = 0.0
    return checkpoint


def check(folder: Path, state: State, t: float) -> None:
    """The folder holds the state of one time, on this number of processes."""
    checkpoint = opened(folder)
    past = checkpoint.read(state.functions)
    found = [f.x.array.copy() for f in state.functions]
    agree(past == [] and checkpoint.record == {"t": t}, checkpoint.record)
    for actual, expected in zip(found, state.set(t), strict=True):
        equal(actual, expected, ROUNDING)


def content(folder: Path) -> dict[str, bytes]:
    return on_first(
        lambda: {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*.*[!p]")}
    )


# -- what is written is read


def test_round_trip(tmp_path, state):
    """On this mesh and on another one of the same input, with what was before."""
    before = [state.set(1.0), state.set(2.0)]
    now = state.set(3.0)
    record = {"load": 3.0, "nan": np.float64("nan"), "steps": [{"n": np.int32(4)}], "name": "κ"}
    checkpoint = opened(tmp_path / "new/run", restart=False)
    agree(checkpoint.record is None)
    checkpoint.write(state.functions, record, before)
    for other in (state, State()):
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


def test_only_the_last_state_is_kept(tmp_path, state):
    written(tmp_path, state, 1.0, 2.0, 3.0)
    agree({path.name for path in tmp_path.iterdir()} == {"latest.json", "step-0003"})
    check(tmp_path, state, 3.0)


def test_a_restarted_run_writes_on(tmp_path, state):
    written(tmp_path, state, 1.0, 2.0)
    checkpoint = opened(tmp_path)
    checkpoint.read(state.functions)
    state.set(7.0)
    checkpoint.write(state.functions, {"t": 7.0})
    agree(checkpoint.record == {"t": 7.0})
    check(tmp_path, state, 7.0)


def test_where_a_process_has_no_cell(tmp_path):
    """A limit of adios4dolfinx, said before it is met."""
    mesh = create_mesh(COMM, np.vstack([np.zeros(3), np.eye(3)]), np.arange(4)[None])
    f = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 1)))
    checkpoint = opened(tmp_path, restart=False)
    if COMM.size == 1:
        checkpoint.write([f], {})
    else:
        with raises(ValueError, "1 cells on . processes leave one without a cell: .*need fewer"):
            checkpoint.write([f], {})
    agree((tmp_path / "latest.json").exists() == (COMM.size == 1))


# -- what is refused, and left as it was


@pytest.mark.parametrize(
    ("other", "match"),
    [
        ({"n": 3}, "cells are 48 there and 162 here; vertices are 27 there and 64 here"),
        ({"degree": 1}, r"elements are .*, 2, .* there and .*, 1, .* here"),
        ({"scale": 1 + 1e-6}, "extent of the mesh or the order of its cells are others"),
    ],
)
def test_another_mesh_or_element(tmp_path, state, other, match):
    written(tmp_path, state, 1.0)
    before, other = content(tmp_path), State(**other)
    values = other.set(5.0)
    with raises(ValueError, f"is one of another problem: .*{match}.*, or name another folder"):
        opened(tmp_path).read(other.functions)
    agree(content(tmp_path) == before and len(before) > 2)
    for f, array in zip(other.functions, values, strict=True):
        equal(f.x.array, array)


def test_cells_in_another_order():
    """Same numbers, same extent: the state would be put into other cells."""
    i = np.arange(15)  # a helix of tetrahedra
    x = np.column_stack([np.cos(2.3 * i), np.sin(2.3 * i), 0.6 * i])
    cells = i[:12, None] + i[:4]
    one, same, other, turned = (
        describe([dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))])
        for mesh in (create_mesh(COMM, x, c) for c in (cells, cells, cells[::-1], cells[:, ::-1]))
    )
    agree(module._other_problem(one, same) == [])
    for wrong in (other, turned):
        agree(len(found := module._other_problem(one, wrong)) == 1 and "order" in found[0], found)


@pytest.mark.parametrize(
    ("other", "match"),
    [
        ({"kappa": 1e5}, "kappa is 1000.0 there and 100000.0 here"),
        ({"layers": [29, 61], "law": "NH"}, r"law is HGO there and NH here; layers is \[29, 62\]"),
        ({"c": 3.0}, "c is not given there and 3.0 here"),
    ],
)
def test_other_parameters(tmp_path, state, other, match):
    written(tmp_path, state, 1.0)
    before = content(tmp_path)
    with raises(ValueError, f"is one of another problem: {match}.*Restart with that problem"):
        opened(tmp_path, **other)
    agree(content(tmp_path) == before)


def test_parameters_that_no_file_holds(tmp_path):
    with raises(ValueError, r"parameters\['law'\] is <.*>: give numbers, strings, or lists"):
        opened(tmp_path / "run", restart=False, law=object())
    agree(not (tmp_path / "run").exists())


def test_a_checkpoint_is_not_overwritten(tmp_path, state):
    written(tmp_path, state, 1.0)
    with raises(FileExistsError, "holds the checkpoint of an earlier run: restart from it, or"):
        opened(tmp_path, restart=False)
    check(tmp_path, state, 1.0)


def test_nothing_to_restart_from(tmp_path):
    with raises(FileNotFoundError, "no .*latest.json to restart from: name the folder of an"):
        opened(tmp_path / "nowhere")
    agree(not (tmp_path / "nowhere").exists())
    checkpoint = opened(tmp_path, restart=False)
    with raises(ValueError, "There is no state in .* yet"):
        checkpoint.read(State().functions)


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "{}", '{"format": 0}', '{"format": 1, "state": "step-0001"}']
)
def test_corrupt_names(tmp_path, state, text):
    written(tmp_path, state, 1.0)
    on_first(lambda: (tmp_path / "latest.json").write_text(text))
    with raises(ValueError, "latest.json is no checkpoint of this version: name another folder"):
        opened(tmp_path)


@pytest.mark.parametrize("damage", ["missing", "short", "flipped"])
def test_damaged_states(tmp_path, state, damage):
    """Found before ADIOS2 reads them."""
    written(tmp_path, state, 1.0)

    def spoil() -> None:
        path = next(tmp_path.glob("step-0001/state.bp/data.*"))
        old = path.read_bytes()
        if damage == "missing":
            path.unlink()
        else:
            half = len(old) // 2
            path.write_bytes(
                old[:half] + (bytes([old[half] ^ 1]) + old[half + 1 :]) * (damage == "flipped")
            )

    on_first(spoil)
    with raises(ValueError, "state.bp/data.* is missing or damaged: begin anew in another folder"):
        opened(tmp_path)


def test_folder_that_cannot_be_written(tmp_path):
    on_first(lambda: (tmp_path / "notes").write_text("mine"))
    with raises(OSError, "folder .*notes/run cannot be written"):
        opened(tmp_path / "notes/run", restart=False)


@pytest.mark.parametrize("rank", [0, COMM.size - 1])
def test_without_adios4dolfinx(tmp_path, monkeypatch, rank):
    """On one process or another: all raise."""
    if COMM.rank == rank:
        monkeypatch.setitem(sys.modules, "adios4dolfinx", None)
    with raises(ModuleNotFoundError, "need adios4dolfinx, .*: install Debian's python3-adios4dol"):
        opened(tmp_path / "run", restart=False)
    agree(not (tmp_path / "run").exists())


# -- writing fails


def test_full_disk(tmp_path, state, monkeypatch):
    """There is no room: found before ADIOS2 writes, by the first process alone."""
    checkpoint = written(tmp_path, state, 1.0)

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "posix_fallocate", full)
        state.set(2.0)
        with raises(OSError, r"step-0002.part cannot be written \(No space left.*one before it is"):
            checkpoint.write(state.functions, {"t": 2.0})
    agree({path.name for path in tmp_path.iterdir()} == {"latest.json", "step-0001"})
    check(tmp_path, state, 1.0)
    state.set(3.0)  # there is room again
    checkpoint.write(state.functions, {"t": 3.0})
    check(tmp_path, state, 3.0)


def test_failure_on_the_last_process(tmp_path, state):
    """All raise, and the first state stays what it is: none."""
    checkpoint = opened(tmp_path, restart=False)

    def broken(*_, **__):
        if COMM.rank == COMM.size - 1:
            raise RuntimeError("[ADIOS2 EXCEPTION]\n no")

    checkpoint._adios4dolfinx = SimpleNamespace(write_function_on_input_mesh=broken)
    with raises(OSError, r"step-0001.part cannot be written \(\[ADIOS2 EXCEPTION\] no\): there is"):
        checkpoint.write(state.functions, {})
    agree(list(tmp_path.iterdir()) == [] and checkpoint.record is None)


class Killed(BaseException):
    """Stands for SIGKILL: nothing catches it."""


@pytest.mark.serial
@pytest.mark.parametrize("name", ["fsync", "rename", "replace", "open", "mkdir"])
def test_killed_at_any_call(tmp_path, state, monkeypatch, name):
    """Before each of the calls that change the folder: the old state is there or the new one."""
    written(tmp_path / "first", state, 1.0, 2.0)
    call, seen, at = getattr(os, name), 0, 0

    def kill(*args, **options):
        nonlocal seen
        if (seen := seen + 1) > at:
            raise Killed
        return call(*args, **options)

    while seen >= at:  # until all calls are let through
        folder, seen = tmp_path / f"{at}", 0
        shutil.copytree(tmp_path / "first", folder)
        checkpoint = opened(folder)
        state.set(3.0)
        with monkeypatch.context() as patch, contextlib.suppress(Killed):
            patch.setattr(module, "os", SimpleNamespace(**{**vars(os), name: kill}))
            patch.setattr(module.Path, "mkdir", lambda path: module.os.mkdir(path))
            checkpoint.write(state.functions, {"t": 3.0})
        again = opened(folder)
        t = again.record["t"]
        check(folder, state, t)
        state.set(4.0)
        again.write(state.functions, {"t": 4.0})
        check(folder, state, 4.0)
        agree({path.name for path in folder.iterdir()} >= {"latest.json"})
        agree(len(list(folder.iterdir())) == 2, list(folder.iterdir()))
        at += 1
    agree(t == 3.0 and at >= 1)


# -- programs


def program(*words: object, processes: int = 1) -> subprocess.Popen[str]:
    """Start `checkpoint_run.py` on some processes of its own."""
    own = {k: v for k, v in os.environ.items() if not k.startswith(LAUNCHERS)}
    own |= {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    own |= {
        "OMPI_MCA_rmaps_base_oversubscribe": "1",
        "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    }
    own |= {"OMPI_MCA_mpi_yield_when_idle": "1"}
    launch = ["mpirun", "-n", str(processes)] if processes > 1 else []
    return subprocess.Popen(
        [*launch, sys.executable, str(ROOT / "tests/common/checkpoint_run.py"), *map(str, words)],
        cwd=ROOT,
        env=own,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def finish(process: subprocess.Popen[str], status: int = 0) -> str:
    """Wait for a program; return what it said."""
    try:
        said, _ = process.communicate(timeout=300)
    finally:
        process.kill()
    assert (process.returncode == 0) == (status == 0), said
    return said


@pytest.mark.serial
def test_restart_on_another_number_of_processes(tmp_path):
    """One process, then two, then one: the result of one run."""
    for name, legs in {"whole": [(3.0, 1)], "parts": [(1.0, 1), (2.5, 2), (3.0, 1)]}.items():
        for i, (load, processes) in enumerate(legs):
            words = ["restart"] * (i > 0)
            finish(program("wall", tmp_path / name, load, *words, processes=processes))
    whole, parts = (np.load(tmp_path / f"{name}.npz") for name in ("whole", "parts"))
    assert parts["load"] == whole["load"] == loads.mmhg(3.0)
    for name in ("u", "p"):
        error, scale = np.abs(parts[name] - whole[name]).max(), np.abs(whole[name]).max()
        assert error <= 1e-8 * scale > 0.0
    assert {1.0, 2.5, 3.0} <= set(parts["path"]) and {1.0, 2.5} & set(whole["path"]) == set()


@pytest.mark.serial
def test_killed_again_and_again(tmp_path):
    """SIGKILL at random moments: the folder holds a whole state, and never an older one."""
    for k in range(4):
        folder = tmp_path / f"run{k}"
        process = program("loop", folder)
        deadline = time.monotonic() + 60
        while not (folder / "latest.json").exists() and time.monotonic() < deadline:
            time.sleep(0.01)
        time.sleep(random.uniform(0.0, 0.4))
        process.kill()
        process.communicate()
        seen = json.loads((folder / "latest.json").read_text())["record"]["value"]
        checkpoint = Checkpoint(folder, COMM, parameters={"kappa": 1000.0}, restart=True)
        f = dolfinx.fem.Function(dolfinx.fem.functionspace(cube(2, 3), ("Lagrange", 1)))
        f.x.array[:] = -1.0
        checkpoint.read([f])
        assert checkpoint.record == {"value": seen} and np.all(f.x.array == seen)


@pytest.mark.serial
@pytest.mark.parametrize("processes", [1, 2])
def test_files_that_may_not_grow(tmp_path, processes):
    """A failure of the system and not of a stand-in; all processes end by themselves."""
    said = finish(program("wall", tmp_path / "run", 4.0, "small", processes=processes), status=1)
    assert said.count("OSError: The checkpoint") == processes, said
    assert "File too large" in said and "there is none yet" in said
    assert list((tmp_path / "run").iterdir()) == []


# -- load steps


def follow(
    folder: Path, target: float, *, restart: bool, kappa: float = 1000.0, rtol: float | None = None
):
    body = wall(tube(around=4, along=2), degree=1, kappa=kappa)
    checkpoint = Checkpoint(folder, COMM, restart=restart)
    steps = follow_load(
        body.problem(3),
        lambda mmhg: setattr(body.load, "value", loads.mmhg(mmhg)),
        [1.0, target],
        dataclasses.replace(STEPS, rtol=rtol),
        state=[body.u, body.p],
        checkpoint=checkpoint,
    )
    return steps, body


def test_a_restart_goes_the_way_of_one_run(tmp_path):
    """Steps, increments, predictions and iterations: the equilibria of the past are kept, too."""
    whole, one = follow(tmp_path / "whole", 3.0, restart=False)

    class StoppedError(Exception):
        """Ends the run."""

    class Stopping(Checkpoint):
        def write(self, functions, record, past=()) -> None:
            super().write(functions, record, past)
            if len(record["steps"]) == 3:
                raise StoppedError

    with pytest.MonkeyPatch.context() as patch, raises(StoppedError, ""):
        patch.setitem(globals(), "Checkpoint", Stopping)
        follow(tmp_path / "parts", 3.0, restart=False)
    parts, other = follow(tmp_path / "parts", 3.0, restart=True)
    agree([step.load for step in parts] == [step.load for step in whole])
    agree(len(parts) > 4 and other.load.value == one.load.value == loads.mmhg(3.0))
    for a, b in zip(parts, whole, strict=True):
        agree(len(a.history) == len(b.history) and a.failures == b.failures)
    equal(other.u.x.array, one.u.x.array, 1e-9)
    again, finished = follow(tmp_path / "parts", 3.0, restart=True)
    agree([step.load for step in again] == [step.load for step in parts], "nothing is left to do")
    equal(finished.u.x.array, other.u.x.array, ROUNDING)


@pytest.mark.parametrize("rtol", [None, 1e-2])
def test_a_target_that_was_met_on_the_way(rtol, tmp_path):
    """It is solved again if it was met roughly; otherwise there is nothing left to do."""
    whole, _ = follow(tmp_path, 3.0, restart=False, rtol=rtol)
    on_the_way = next(s.load for s in whole if s.load > 1.0)
    latest = on_first(lambda: json.loads((tmp_path / "latest.json").read_text()))
    agree(latest["record"]["met"] == [0.0, 1.0, 3.0] and on_the_way < 3.0)
    latest["record"]["met"] = [0.0, 1.0]
    on_first(lambda: (tmp_path / "latest.json").write_text(json.dumps(latest)))
    again, body = follow(tmp_path, 3.0, restart=True, rtol=rtol)
    more = [] if rtol is None else [0.0]
    agree([s.increment for s in again] == [*(s.increment for s in whole), *more])
    small(body.load.value - loads.mmhg(3.0), 0.0)


def test_a_foreign_record(tmp_path):
    body = wall(tube(around=4, along=2), degree=1)
    Checkpoint(tmp_path, COMM).write([body.u, body.p], {"t": 1.0})
    with raises(ValueError, "was not written by follow_load of this version: name another folder"):
        follow(tmp_path, 1.0, restart=True)
