# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The command line of `demo_artery.py`: its own options with two dashes, PETSc's with one."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import IO, NoReturn

from mpi4py import MPI

from meshes.arguments import count, parse_all, positive, without_petsc

__all__ = ["Parser", "parse", "parser"]

EPILOG = """Options with a single dash are PETSc's. Those of the solver, -feti_… -ksp_… -snes_…,
need no prefix (-feti_type classical, -ksp_monitor); all others (-log_view) go to PETSc."""


class Parser(argparse.ArgumentParser):
    """Speaks on the first process alone, and of an error in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message}; --help lists all options\n")

    def _print_message(self, message: str, file: IO[str] | None = None) -> None:
        if MPI.COMM_WORLD.rank == 0:
            super()._print_message(message, file)


parser = Parser("demo_artery.py", epilog=EPILOG, allow_abbrev=False, add_help=False)
source = parser.add_mutually_exclusive_group()
source.add_argument("--mesh", default="vessel", help="vessel, tube, or a file in mm")
source.add_argument("--wall", type=Path, help="TOML file with mesh, layers and conditions")
parser.add_argument("--size", type=positive, help="length of the elements' edges [mm]")
parser.add_argument("--pressure", type=positive, help="[mmHg], 10 or what the file says")
parser.add_argument("--steps", type=count, default=10, help="the first load step is a … of it")
parser.add_argument("--subdomains", type=count, default=64, help="over all processes, 64")
parser.add_argument("--kappa", type=positive, default=1000.0, help="penalty κ [kPa], 1000")
parser.add_argument("--degree", type=int, choices=(1, 2), default=2, help="of displacements, 2")
parser.add_argument("--output", type=Path, default=Path("output/artery"), help="a folder")
parser.add_argument("--help", action="help", help="show this text")


def parse(words: Sequence[str]) -> tuple[argparse.Namespace, dict[str, str | None], list[str]]:
    """Return the demo's own options, the solver's by name, and the others for PETSc."""
    own, petsc = without_petsc(words)
    args = parse_all(parser, own)
    options: dict[str, str | None] = {}
    for word in petsc:
        if word[:1] == "-" and word[1:2].isalpha():
            options[word[1:]] = None
        else:
            options[[*options][-1]] = word
    solver = {k: v for k, v in options.items() if k.startswith(("feti_", "ksp_", "snes_"))}
    rest = [w for k, v in options.items() if k not in solver for w in (f"-{k}", v) if w is not None]
    return args, solver, rest
