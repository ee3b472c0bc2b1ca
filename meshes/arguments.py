# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The words of a command line: of generators, and of demos and benchmarks that call them."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import IO, NoReturn

from mpi4py import MPI

__all__ = ["Parser", "count", "parse_all", "positive", "refusals", "share", "without_petsc"]


class Parser(argparse.ArgumentParser):
    """Speaks on the first process alone, and of an error in one line."""

    def error(self, message: str) -> NoReturn:
        """End with status 2."""
        self.exit(2, f"{self.prog}: error: {message}; --help lists all options\n")

    def _print_message(self, message: str, file: IO[str] | None = None) -> None:
        if MPI.COMM_WORLD.rank == 0:
            super()._print_message(message, file)


def count(text: str) -> int:
    """Read a number 1, 2, 3, ….

    Raises:
        argparse.ArgumentTypeError: It is none.
    """
    if not (text.isdecimal() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number 1, 2, 3, …")
    return int(text)


def positive(text: str) -> float:
    """Read a positive, finite number.

    Raises:
        argparse.ArgumentTypeError: It is none.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
    return value


def share(text: str) -> tuple[str, float]:
    """Read a name and a positive number, ``media=2``; the number is 1 if there is none.

    Raises:
        argparse.ArgumentTypeError: It is neither.
    """
    name, _, number = text.partition("=")
    if not name:
        raise argparse.ArgumentTypeError(f"{text!r} has no name: give it as in media=2")
    return name, positive(number or "1")


def without_petsc(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return a command's own words and PETSc's: those with a single dash, and a value after each.

    A word that follows neither is the command's own, ``50`` in ``-log_view --pressures 10 50``; so
    is ``-h``.
    """
    own: list[str] = []
    petsc: list[str] = []
    may_follow = False
    for word in words:
        option = word[:1] == "-" and word[1:2].isalpha() and word != "-h"
        of_petsc = option or (may_follow and word[:2] != "--")
        (petsc if of_petsc else own).append(word)
        may_follow = option
    return own, petsc


def parse_all(parser: argparse.ArgumentParser, own: Sequence[str]) -> argparse.Namespace:
    """Parse words of which none may be left over, or end with the parser's error."""
    args, left = parser.parse_known_args(own)
    if left:
        options = [word for word in own[: own.index(left[0])] if word[:2] == "--"]
        stray = options and left[0][:2] != "--"
        after = f" after {options[-1]}: it takes no more than one word" if stray else ""
        parser.error(f"unrecognized arguments: {' '.join(left)}{after}")
    return args


@contextmanager
def refusals(parser: argparse.ArgumentParser) -> Iterator[None]:
    """Answer wrong input in one line, with exit status 2 and no traceback.

    Raises:
        SystemExit: In place of an error about a file or a value.
    """
    try:
        yield
    except (OSError, ValueError, ArithmeticError) as error:
        parser.exit(2, f"{parser.prog}: error: {' '.join(str(error).split())}\n")
