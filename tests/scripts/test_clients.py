# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tests of other programs: what happens where their packages cannot be installed."""

from __future__ import annotations

import clients
import pytest

pytest.importorskip("pip")

pytestmark = pytest.mark.serial


def test_failed_download_is_a_failure_with_a_message(tmp_path, monkeypatch):
    """An index that cannot be reached ends the run; the message names it and the command."""
    nowhere = "http://127.0.0.1:9/simple"  # the port of discard, on which nothing listens
    monkeypatch.setenv("PIP_INDEX_URL", nowhere)
    monkeypatch.setenv("PIP_RETRIES", "0")
    with pytest.raises(SystemExit) as ended:
        clients.install(tmp_path)
    message = str(ended.value.code)
    assert "no test of fenicsx-pulse has run" in message
    assert "PyPI" in message
    assert "pip install" in message
    assert not (tmp_path / "installed").exists()


def test_finished_folder_is_kept(tmp_path, monkeypatch):
    """A second run installs nothing; other versions are installed anew."""
    called = []
    monkeypatch.setattr(clients, "pip", lambda *arguments: called.append(arguments[0]))
    monkeypatch.setattr(clients, "unpacked", lambda folder, name: make_source(folder / name))
    (tmp_path / "site").mkdir()
    clients.install(tmp_path)
    assert called == ["install", "download"]
    clients.install(tmp_path)
    assert called == ["install", "download"]
    monkeypatch.setattr(clients, "WHEELS", ("pint==1",))
    clients.install(tmp_path)
    assert called == ["install", "download"] * 2


def make_source(folder):
    """Return a folder that looks like scifem's sources."""
    (folder / "src/scifem").mkdir(parents=True, exist_ok=True)
    (folder / "PKG-INFO").write_text("Version: 0")
    return folder
