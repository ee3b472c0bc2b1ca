# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The libraries that write states: each that is there writes what it reads, and is remembered."""

from __future__ import annotations

import json
import os
import sys

import numpy as np
import pytest
from collective import COMM, agree, raises, small
from states import ROUNDING
from wall_files import on_first

from dolfinx_feti.loading import Checkpoint, states, storage


@pytest.fixture(params=storage.LIBRARIES)
def library(request, monkeypatch) -> str:
    """The name of a library that is there, and the only one that is taken."""
    try:
        storage.choose_storage(COMM, request.param)
    except ModuleNotFoundError as error:
        pytest.skip(str(error))
    monkeypatch.setattr(storage, "LIBRARIES", (request.param,))
    return request.param


def test_library_writes_what_it_reads(library, tmp_path, state):
    """Present and past, in a second state, too."""
    checkpoint = Checkpoint(tmp_path, COMM)
    for value in (1.0, 2.0):
        state.set(value)
        past = [[f.x.array.copy() for f in state.functions]]
        checkpoint.write(state.functions, {"t": value}, past)
    state.set(7.0)
    found = Checkpoint(tmp_path, COMM, restart=True).read(state.functions)
    for f, array, before in zip(state.functions, past[0], found[0], strict=True):
        for read in (f.x.array, before):
            small(np.abs(read - array).max(initial=0.0), ROUNDING)


def test_state_is_read_by_the_library_that_wrote_it(library, tmp_path, monkeypatch, state):
    state.set(1.0)
    Checkpoint(tmp_path, COMM).write(state.functions, {})
    latest = on_first(lambda: json.loads((tmp_path / states.LATEST).read_text()))
    agree(latest["storage"] == library, latest)
    monkeypatch.setitem(sys.modules, library.split()[0], None)
    with raises(ModuleNotFoundError, f"Checkpoints need {library}, which cannot be imported"):
        Checkpoint(tmp_path, COMM, restart=True)


@pytest.mark.serial
def test_room_where_the_system_has_no_call_for_it(tmp_path, monkeypatch):
    """As on macOS: by zeros."""
    monkeypatch.delattr(os, "posix_fallocate")
    monkeypatch.setattr(states, "BLOCK", 10)
    states.reserve(tmp_path / "room", 25)
    assert (tmp_path / "room").read_bytes() == bytes(25)
