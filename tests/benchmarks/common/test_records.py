# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The file of records: equal on all processes, whole or as it was, and no process waits for it."""

from __future__ import annotations

import errno
import json
import os
import shutil

from collective import COMM, agree, raises
from wall_files import on_first

from benchmarks.common import records as module
from benchmarks.common.records import Records


def test_record_of_the_first_process_counts(tmp_path):
    """Times differ from process to process; what is kept and returned does not."""
    path = tmp_path / "new/records.json"
    records = Records(path, COMM)
    key = {"case": 1}
    stored = records.put(key, key | {"seconds": float(COMM.rank)})
    agree(stored == {"case": 1, "seconds": 0.0} == records.find(key), stored)
    agree(on_first(lambda: json.loads(path.read_text())) == [stored])
    again = records.put(key, key | {"seconds": 7.0})
    agree(on_first(lambda: json.loads(path.read_text())) == [again], "in the place of the old one")
    agree(Records(path, COMM).find(key) == again)


def test_folder_that_is_gone_is_noticed_by_all_processes(tmp_path):
    """The first process alone writes, and fails."""
    records = Records(tmp_path / "folder/records.json", COMM)
    records.put({"case": 1}, {"case": 1})
    on_first(lambda: shutil.rmtree(tmp_path / "folder"))
    with raises(OSError, "folder/records.json' cannot be written .No such file.*make room"):
        records.put({"case": 2}, {"case": 2})


def test_full_disk_leaves_the_file_as_it_was(tmp_path, monkeypatch):
    path = tmp_path / "records.json"
    records = Records(path, COMM)
    records.put({"case": 1}, {"case": 1})
    before = on_first(path.read_text)

    def full(*_places: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(module.os, "replace", full if COMM.rank == 0 else os.replace)
        with raises(OSError, "cannot be written .No space left on device.: make room"):
            records.put({"case": 2}, {"case": 2})
    agree(on_first(path.read_text) == before)
    agree(on_first(lambda: [each.name for each in tmp_path.iterdir()]) == ["records.json"])
    records.put({"case": 3}, {"case": 3})
    agree(len(on_first(lambda: json.loads(path.read_text()))) == 3, "what was found is kept")
