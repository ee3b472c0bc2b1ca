# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The command line of `demo_artery.py`: its own options with two dashes, PETSc's with one."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, NoReturn

from mpi4py import MPI

from meshes.arguments import count, positive

__all__ = ["input_errors", "parse"]

#: What a wall file says in their place, and their values without one.
OF_WALL_FILE = {"geometry": "vessel", "mesh": None, "pressure": 10.0, "c": 3.0}

#: Options of the solver, which may be given without its prefix.
SOLVER = ("feti_", "ksp_", "snes_")

EPILOG = """Options with a single dash are PETSc's. Those of the solver, -feti_… -ksp_… -snes_…,
need no prefix (-feti_type classical, -ksp_monitor); all others (-log_view) go to PETSc."""


def parse(
    arguments: Sequence[str],
) -> tuple[argparse.Namespace, dict[str, str | None], list[str]]:
    """Read the command line.

    Args:
        arguments: The command line without the program's name.

    Returns:
        The demo's own options, the solver's without dash (None for a flag), and the rest for
        `petsc4py.init`.
    """
    own, solver, rest = _split(arguments)
    parser = _Parser(
        "demo_artery.py",
        description="Inflate the wall of an artery with all-floating FETI.",
        epilog=EPILOG,
        allow_abbrev=False,
    )
    parser.add_argument("--geometry", choices=("vessel", "tube"), help="vessel")
    parser.add_argument("--mesh", type=Path, metavar="FILE", help="a wall of your own, in mm")
    parser.add_argument(
        "--wall", type=Path, metavar="FILE", help="mesh, layers and conditions in a TOML file"
    )
    parser.add_argument("--size", type=positive, help="length of the elements' edges [mm]")
    parser.add_argument("--pressure", type=positive, help="[mmHg], 10")
    parser.add_argument("--steps", type=count, default=10, help="the first load step is a … of it")
    parser.add_argument("--subdomains", type=count, default=64, help="over all processes, 64")
    parser.add_argument("--kappa", type=positive, default=1000.0, help="penalty κ [kPa], 1000")
    parser.add_argument("--c", type=positive, help="stiffness c [kPa], 3")
    parser.add_argument("--degree", type=int, choices=(1, 2), default=2, help="of displacements, 2")
    parser.add_argument("--output", type=Path, default=Path("output/artery"), metavar="FOLDER")
    parser.add_argument("--checkpoint", type=Path, metavar="FOLDER", help="keep each load step")
    parser.add_argument("--restart", action="store_true", help="continue from the checkpoint")
    args = parser.parse_args(own)
    if args.restart and args.checkpoint is None:
        parser.error("argument --restart: it needs --checkpoint FOLDER, the run to continue")
    for name, value in OF_WALL_FILE.items():
        if getattr(args, name) is None:
            setattr(args, name, value)
        elif args.wall is not None:
            parser.error(f"argument --{name}: the file of --wall says it; leave one of them out")
    return args, solver, rest


class _Parser(argparse.ArgumentParser):
    """Speaks on the first process alone, and of an error in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message}; --help lists all options\n")

    def _print_message(self, message: str, file: IO[str] | None = None) -> None:
        if MPI.COMM_WORLD.rank == 0:
            super()._print_message(message, file)


@contextmanager
def input_errors(comm: MPI.Comm) -> Iterator[None]:
    """Answer what is wrong with the input in one line, with exit status 2 and no traceback.

    Args:
        comm: Communicator; all processes raise the error, or none.

    Raises:
        SystemExit: In place of an error about a file, a folder, an option or a value.
    """
    try:
        yield
    except (OSError, ValueError, ImportError, ArithmeticError) as error:
        if comm.rank == 0:
            print(f"demo_artery.py: error: {' '.join(str(error).split())}", file=sys.stderr)
        raise SystemExit(2) from error


def _split(arguments: Sequence[str]) -> tuple[list[str], dict[str, str | None], list[str]]:
    """Separate PETSc's options, a dash and a letter with or without a value, from the demo's."""
    own: list[str] = []
    solver: dict[str, str | None] = {}
    rest: list[str] = []
    waiting = list(arguments)
    while waiting:
        word = waiting.pop(0)
        if not _is_petsc(word):
            own.append(word)
            continue
        has_value = waiting and not waiting[0].startswith("--") and not _is_petsc(waiting[0])
        value = waiting.pop(0) if has_value else None
        if word[1:].startswith(SOLVER):
            solver[word[1:]] = value
        else:
            rest += [word] if value is None else [word, value]
    return own, solver, rest


def _is_petsc(word: str) -> bool:
    return len(word) > 2 and word[0] == "-" and word[1].isalpha()
