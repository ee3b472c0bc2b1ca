# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Command lines of the studies: options that they share, types of values, lines of output."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO

from mpi4py import MPI

from dolfinx_feti.meshes.arguments import positive
from dolfinx_feti.meshes.walls import GENERATORS
from dolfinx_feti.runtime.collective import on_root


def add_choices(parser: argparse.ArgumentParser, name: str, choices: Sequence[object]) -> None:
    """Add an option for one or more of the choices.

    Args:
        parser: The parser that gets the option.
        name: Name of the option, with dashes.
        choices: Possible values; the default is all of them.
    """
    values = ",".join(map(str, choices))
    parser.add_argument(name, type=some_of(choices), default=list(choices), help=values)


def add_mesh(parser: argparse.ArgumentParser) -> None:
    """Add the options for the mesh of a wall."""
    parser.add_argument("--geometry", choices=tuple(GENERATORS), default="vessel")
    add_size(parser)


def add_size(parser: argparse.ArgumentParser) -> None:
    """Add the options for the elements of a wall."""
    add = parser.add_argument
    add("--size", type=positive, default=None, help="length of the elements' edges [mm]")
    add("--folder", type=Path, default=Path("build/walls"), help="where meshes are kept")


def say(text: str, comm: MPI.Comm, file: IO[str] | None = None) -> None:
    """Print a line on the first process; an error there is raised on all. Collective."""
    on_root(lambda: print(text, file=file, flush=True), comm)


def several(single: Callable[[str], object]) -> Callable[[str], list[object]]:
    """Return a type for values separated by commas, each once."""

    def read(text: str) -> list[object]:
        values = (single(word.strip()) for word in text.split(","))
        return list(dict.fromkeys(values))

    return read


def some_of(choices: Sequence[object]) -> Callable[[str], list[object]]:
    """Return a type for one or more of the choices, separated by commas."""
    known = {str(choice): choice for choice in choices}

    def read(word: str) -> object:
        if word not in known:
            raise argparse.ArgumentTypeError(f"{word!r} is none of: {', '.join(known)}")
        return known[word]

    return several(read)
