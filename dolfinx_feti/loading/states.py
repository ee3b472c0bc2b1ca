# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""States on the disk: a folder in which the last good one is always whole.

The folder holds `step-N` and `latest.json`, which names it. A new state is written into
`step-N.part`, brought to the disk and renamed; then `latest.json` is replaced, and only then the
older state is removed. Each of these is one act of the file system: a run may be killed at any
moment. All of it is work for one process.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

__all__ = [
    "FORMAT",
    "LATEST",
    "check_files",
    "last_number",
    "prepare",
    "publish",
    "read_latest",
    "reserve",
]

LATEST = "latest.json"
FORMAT = 2

#: Bytes that ADIOS2 or HDF5 may write in addition to the numbers.
OVERHEAD = 1 << 20

#: Bytes that are read or written at once.
BLOCK = 1 << 22


def prepare(part: Path, size: int) -> None:
    """Make the folder of a new state, where its bytes have room; clear away half ones."""
    for path in _states(part.parent, suffix=".part"):
        shutil.rmtree(path)
    part.mkdir()
    room = part / "room"
    reserve(room, size + OVERHEAD)
    room.unlink()


def reserve(path: Path, size: int) -> None:
    """Take room on the disk, in bytes; where the system has no call for it (macOS), by zeros.

    Raises:
        OSError: There is not that much.
    """
    with path.open("wb") as file:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file.fileno(), 0, size)
            return
        for first in range(0, size, BLOCK):
            file.write(bytes(min(BLOCK, size - first)))
        file.flush()
        os.fsync(file.fileno())


def publish(part: Path, latest: dict[str, Any]) -> dict[str, Any]:
    """Give a state that is on the disk its name, let `latest.json` name it, remove older ones."""
    files = sorted(path for path in part.rglob("*") if path.is_file())
    for path in [*files, *sorted({path.parent for path in files} | {part})]:
        _sync(path)
    latest["files"] = {str(path.relative_to(part)): _checksum(path) for path in files}
    folder = part.parent
    os.rename(part, part.with_suffix(""))
    _sync(folder)
    whole = folder / f"{LATEST}.part"
    with whole.open("w") as file:
        json.dump(latest, file)
        file.flush()
        os.fsync(file.fileno())
    os.replace(whole, folder / LATEST)
    _sync(folder)
    for path in _states(folder):
        if path.name != latest["state"]:
            shutil.rmtree(path, ignore_errors=True)  # next time, if not now
    return latest


def read_latest(path: Path) -> dict[str, Any]:
    """Read `latest.json`.

    Raises:
        ValueError: It is none.
    """
    keys = {"state", "past", "parameters", "record", "files", "cells", "vertices", "extent"}
    keys |= {"coordinates", "elements"}
    try:
        latest = json.loads(path.read_text())
    except ValueError:
        latest = None
    if not isinstance(latest, dict) or latest.get("format") != FORMAT or not keys <= latest.keys():
        raise ValueError(
            f"{path} is no checkpoint of this version: name another folder, or start again."
        )
    return latest


def check_files(folder: Path, latest: Mapping[str, Any]) -> None:
    """Compare the files with what was written.

    Raises:
        ValueError: One is missing or another.
    """
    for name, expected in latest["files"].items():
        path = folder / latest["state"] / name
        if not path.is_file() or _checksum(path) != expected:
            raise ValueError(f"{path} is missing or damaged: start again in another folder.")


def _states(folder: Path, suffix: str = "") -> list[Path]:
    """List the folders of states."""
    pattern = re.compile(r"step-\d{4,}" + re.escape(suffix))
    return [path for path in folder.iterdir() if pattern.fullmatch(path.name)]


def last_number(folder: Path) -> int:
    """Return the highest number of a state, of one that was never named by `latest.json` too."""
    states = _states(folder) if folder.is_dir() else []
    return max((int(path.name.removeprefix("step-")) for path in states), default=0)


def _checksum(path: Path) -> list[int]:
    """Return size and CRC-32 of a file."""
    size = crc = 0
    with path.open("rb") as file:
        while block := file.read(BLOCK):
            size, crc = size + len(block), zlib.crc32(block, crc)
    return [size, crc]


def _sync(path: Path) -> None:
    """Bring a file or a folder to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
