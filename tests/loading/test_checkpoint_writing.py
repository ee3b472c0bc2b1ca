# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checkpoints: writing fails, or the run is killed."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import random
import shutil
import subprocess
import time
import zipfile
from types import SimpleNamespace

import numpy as np
import pytest
from collective import COMM, agree, raises
from problems import cube
from programs import finish, start
from states import check, opened, written

import dolfinx

from dolfinx_feti import loads
from dolfinx_feti.loading import checkpoint as module
from dolfinx_feti.loading.checkpoint import Checkpoint


@pytest.mark.parametrize("name", ["writestr", "open"])
def test_full_disk(tmp_path, state, monkeypatch, name):
    """Met by the first process alone: all raise, and the last state stays what it is."""
    none = opened(tmp_path / "none", restart=False)
    checkpoint = written(tmp_path / "one", state, 1.0)

    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(zipfile.ZipFile, name, full)
        state.set(2.0)
        with raises(OSError, r"state.npz cannot be written \(No space left.*one before it is"):
            checkpoint.write(state.functions, {"t": 2.0})
        with raises(OSError, r"state.npz cannot be written \(No space left.*there is none yet"):
            none.write(state.functions, {"t": 2.0})
    agree(checkpoint.record == {"t": 1.0} and none.record is None)
    agree([path.name for path in (tmp_path / "one").iterdir()] == ["state.npz"])
    agree(list((tmp_path / "none").iterdir()) == [])
    check(tmp_path / "one", state, 1.0)
    state.set(3.0)  # there is room again
    checkpoint.write(state.functions, {"t": 3.0})
    check(tmp_path / "one", state, 3.0)


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


def program(*words: object, processes: int = 1) -> subprocess.Popen[str]:
    """Start the run with checkpoints."""
    return start("checkpoint_run.py", *words, processes=processes)


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


@pytest.mark.serial
@pytest.mark.parametrize("processes", [1, 2])
def test_files_that_may_not_grow(tmp_path, processes):
    """A failure of the system and not of a stand-in; all processes end by themselves."""
    said = finish(program("wall", tmp_path / "run", 4.0, "small", processes=processes), status=1)
    assert said.count("OSError: The checkpoint") == processes, said
    assert "File too large" in said and "there is none yet" in said
    assert list((tmp_path / "run").iterdir()) == []
