# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Numbers on a command line: of the generators, and of the demos and benchmarks that call them."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["count", "positive", "refusals", "share"]


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
