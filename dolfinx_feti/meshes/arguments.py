# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Command lines of the mesh generators, and of the demos and benchmarks that call them."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn

from mpi4py import MPI

__all__ = [
    "RootParser",
    "count",
    "exit_on_errors",
    "layer_share",
    "parse_all",
    "positive",
    "split_petsc_options",
]


class RootParser(argparse.ArgumentParser):
    """A parser that prints on the first process only, and each error in one line."""

    def error(self, message: str) -> NoReturn:
        """Print the message and exit with status 2."""
        self.exit(2, f"{self.prog}: error: {message}; --help lists all options\n")

    def _print_message(self, message: str, file: Any = None) -> None:
        if MPI.COMM_WORLD.rank == 0:
            super()._print_message(message, file)


def count(text: str) -> int:
    """Return a positive integer from its text, for ``type=`` of an argument.

    Raises:
        argparse.ArgumentTypeError: The text contains something else.
    """
    if not (text.isdecimal() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number 1, 2, 3, …")
    return int(text)


def positive(text: str) -> float:
    """Return a positive, finite number from its text, for ``type=`` of an argument.

    Raises:
        argparse.ArgumentTypeError: The text contains something else.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
    return value


def layer_share(text: str) -> tuple[str, float]:
    """Return the name and the share of a layer, ("media", 2.0) of ``media=2``.

    The share of ``media`` is 1.

    Raises:
        argparse.ArgumentTypeError: The name is missing, or the number is not positive.
    """
    name, _, number = text.partition("=")
    if not name:
        raise argparse.ArgumentTypeError(f"{text!r} has no name: give it as in media=2")
    return name, positive(number or "1")


def split_petsc_options(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split a command line into the arguments of the program and those of PETSc.

    PETSc's are options with one dash, except ``-h``, each with at most one value behind it. The
    other words belong to the program, such as ``50`` in ``-log_view --pressures 10 50``.

    Args:
        words: The command line without the name of the program.

    Returns:
        The program's arguments and PETSc's, each in their order.
    """
    program: list[str] = []
    petsc: list[str] = []
    follows_petsc_option = False
    for word in words:
        is_petsc_option = word[:1] == "-" and word[1:2].isalpha() and word != "-h"
        is_petsc_value = follows_petsc_option and word[:2] != "--"
        if is_petsc_option or is_petsc_value:
            petsc.append(word)
        else:
            program.append(word)
        follows_petsc_option = is_petsc_option
    return program, petsc


def parse_all(parser: argparse.ArgumentParser, words: Sequence[str]) -> argparse.Namespace:
    """Parse a command line completely; unknown words end the program with status 2.

    Args:
        parser: The parser.
        words: The program's arguments, see :func:`split_petsc_options`.

    Returns:
        The values of the arguments.
    """
    args, unknown = parser.parse_known_args(words)
    if unknown:
        before = words[: words.index(unknown[0])]
        options = [word for word in before if word[:2] == "--"]
        hint = ""
        if options and unknown[0][:2] != "--":
            hint = f" after {options[-1]}: it takes no more than one word"
        parser.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")
    return args


@contextmanager
def exit_on_errors(parser: argparse.ArgumentParser) -> Iterator[None]:
    """Turn errors of the user's input into one line on the terminal and exit status 2.

    Args:
        parser: The parser, which prints the line.

    Raises:
        SystemExit: The code inside raised an OSError, ValueError or ArithmeticError.
    """
    try:
        yield
    except (OSError, ValueError, ArithmeticError) as error:
        parser.exit(2, f"{parser.prog}: error: {' '.join(str(error).split())}\n")
