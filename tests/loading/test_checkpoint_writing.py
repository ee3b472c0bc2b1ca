# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checkpoints: writing fails, or the run is killed."""

from __future__ import annotations

import contextlib
import json
import os
import random
import resource
import shutil
import time
import tracemalloc
import zipfile
from types import SimpleNamespace

import numpy as np
import pytest
from collective import COMM, agree, raises
from problems import cube
from programs import finish, start
from states import Fields, check, opened, written

import dolfinx

from dolfinx_feti import loads
from dolfinx_feti.loading import checkpoint as module
from dolfinx_feti.loading.checkpoint import Checkpoint


def test_full_disk(tmp_path):
    """Met by the first process alone: all raise, and the last state stays what it is."""
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
    """It holds an array of another process at a time, and not the past of all."""
    state, checkpoint = Fields(8), opened(tmp_path, restart=False)
    past = [state.set(float(t)) for t in range(50)]
    checkpoint.write(state.functions, {"t": 0.0})
    tracemalloc.start()
    checkpoint.write(state.functions, {"t": 1.0}, past)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    agree(peak < 20 * past[0][0].nbytes, (peak, past[0][0].nbytes))


class Killed(BaseException):
    """Stands for SIGKILL: nothing catches it."""


@pytest.mark.serial
@pytest.mark.parametrize("name", ["fsync", "replace", "open"])
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
            checkpoint.write(state.functions, {"t": 3.0})
        again = opened(folder)
        t = again.record["t"]
        check(folder, state, t)
        state.set(4.0)
        again.write(state.functions, {"t": 4.0})
        check(folder, state, 4.0)
        agree([path.name for path in folder.iterdir()] == ["state.npz"])
        at += 1
    agree(t == 3.0 and at >= 1)


@pytest.mark.serial
def test_restart_on_another_number_of_processes(tmp_path):
    """One process, then two, then one: the result of one run."""
    for name, legs in {"whole": [(3.0, 1)], "parts": [(1.0, 1), (2.5, 2), (3.0, 1)]}.items():
        for load, processes in legs:
            finish(start("path_run.py", "wall", tmp_path / name, load, processes=processes))
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
        process = start("path_run.py", "loop", folder)
        deadline = time.monotonic() + 60
        while not (folder / "state.npz").exists() and time.monotonic() < deadline:
            time.sleep(0.01)
        time.sleep(random.uniform(0.0, 0.4))
        process.kill()
        process.communicate()
        with zipfile.ZipFile(folder / "state.npz") as file:
            seen = json.loads(file.read("head.json"))["record"]["value"]
        checkpoint = Checkpoint(folder, COMM, parameters={"kappa": 1000.0}, restart=True)
        f = dolfinx.fem.Function(dolfinx.fem.functionspace(cube(2, 3), ("Lagrange", 1)))
        f.x.array[:] = -1.0
        checkpoint.read([f])
        assert checkpoint.record == {"value": seen} and np.all(f.x.array == seen)
