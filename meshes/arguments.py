# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Numbers on a command line: of the generators, and of the demos and benchmarks that call them."""

from __future__ import annotations

import argparse
import math

__all__ = ["count", "positive"]


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
