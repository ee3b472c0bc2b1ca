# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checkpoints: writing fails, or the run is killed."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import zipfile
from types import SimpleNamespace

import pytest
from collective import agree, raises
from programs import finish, start
from states import check, opened, written

from dolfinx_feti.loading import checkpoint as module


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


@pytest.mark.serial
@pytest.mark.parametrize("processes", [1, 2])
def test_files_that_may_not_grow(tmp_path, processes):
    """A failure of the system and not of a stand-in; all processes end by themselves."""
    said = finish(start("checkpoint_run.py", tmp_path / "run", 4.0, processes=processes), status=1)
    assert said.count("OSError: The checkpoint") == processes, said
    assert "File too large" in said and "there is none yet" in said
    assert list((tmp_path / "run").iterdir()) == []
