# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Command lines of the benchmarks: a parser that prints on one process, and types of words.

Numbers are read by :mod:`meshes.arguments`.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

from benchmarks.common.records import Record, Records
from dolfinx_feti.loading import Checkpoint
from meshes.arguments import positive

__all__ = [
    "add_records",
    "count_or_zero",
    "create_parser",
    "names",
    "one_of",
    "open_checkpoint",
    "open_records",
    "parse_words",
    "several",
]


def create_parser(name: str, description: str, comm: MPI.Comm) -> argparse.ArgumentParser:
    """Create a parser; only the first process prints."""
    parser = _Parser(
        name,
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.rank = comm.rank
    return parser


def add_records(parser: argparse.ArgumentParser) -> None:
    """Add the options for the file of records, repeated cases and the memory."""
    add = parser.add_argument
    add("--json", type=Path, metavar="FILE", help="records, added to what the file holds")
    add("--again", action="store_true", help="also run cases that the file has")
    add("--memory", type=positive, default=math.inf, metavar="MIB", help="take no more than this")


def parse_words(parser: argparse.ArgumentParser, argv: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line; words with a single dash are left to PETSc."""
    args, petsc = parser.parse_known_args(argv)
    unknown = [word for word in petsc if word.startswith("--")]
    if unknown:
        parser.error(f"unrecognized arguments: {' '.join(unknown)}")
    return args


def open_records(
    path: Path | None,
    parser: argparse.ArgumentParser,
    comm: MPI.Comm,
    *,
    known: Callable[[Record], bool] = lambda _record: True,
    writer: str = "",
) -> Records:
    """Open the file of ``--json``, or end with the parser's error.

    Args:
        path: The file, or None.
        parser: Reports a file that cannot be used.
        comm: The first of its processes reads and writes.
        known: Tells whether a record is one of the study's own.
        writer: The benchmark of the study.

    Raises:
        SystemExit: The file cannot be written, or holds something else. On all processes.

    Note:
        Collective.
    """
    try:
        records = Records(path, comm)
    except ValueError as error:
        parser.error(str(error))
    if not all(map(known, records)):
        parser.error(f"--json '{path}' holds records of another study than {writer}: name another")
    return records


def open_checkpoint(
    folder: Path | None,
    parser: argparse.ArgumentParser,
    comm: MPI.Comm,
    *,
    parameters: Record,
    restart: bool,
) -> Checkpoint | None:
    """Open the folder of ``--checkpoint`` if one is named, or end with the parser's error.

    Args:
        folder: The folder, or None.
        parser: Reports a folder that cannot be used.
        comm: Communicator of the mesh.
        parameters: Parameters that a continued run must share with the earlier one.
        restart: Continue from the state in the folder.

    Raises:
        SystemExit: The folder cannot be written, or holds something else. On all processes.

    Note:
        Collective.
    """
    if folder is None:
        return None
    try:
        return Checkpoint(folder, comm, parameters=parameters, restart=restart)
    except (OSError, ValueError) as error:
        parser.error(str(error))


def several(single: Callable[[str], object]) -> Callable[[str], list[object]]:
    """Return a type for values separated by commas."""
    return lambda text: list(dict.fromkeys(single(word.strip()) for word in text.split(",")))


def one_of(choices: Sequence[object]) -> Callable[[str], object]:
    """Return a type for one of some values."""

    def read(text: str) -> object:
        for choice in choices:
            if text == str(choice):
                return choice
        raise argparse.ArgumentTypeError(f"{text!r} is none of: {names(choices)}")

    return read


def count_or_zero(text: str) -> int:
    """Read a number 0, 1, 2, …."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a number 0, 1, 2, …")
    return int(text)


def names(choices: Sequence[object]) -> str:
    """List some values."""
    return ", ".join(map(str, choices))


class _Parser(argparse.ArgumentParser):
    """A parser that prints on the first process only."""

    rank = 0

    def _print_message(self, message: str, file: Any = None) -> None:
        if self.rank == 0:
            super()._print_message(message, file)
