# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tables of numbers as text, and values as JSON holds them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

Cell: TypeAlias = str | float | None


def table(head: Sequence[str], rows: Sequence[Sequence[Cell]]) -> str:
    """Return lines of aligned columns; words stand to the left and numbers to the right."""
    cells = [[c if isinstance(c, str) else number(c) for c in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(head, *cells, strict=True)]
    words = [all(isinstance(row[j], str) for row in rows) for j in range(len(head))]
    lines = []
    for row in (head, *cells):
        padded = (
            cell.ljust(width) if left else cell.rjust(width)
            for cell, width, left in zip(row, widths, words, strict=True)
        )
        lines.append("  ".join(padded).rstrip())
    return "\n".join(lines)


def number(value: float | None) -> str:
    """Return a number with four digits, or a dash for None."""
    return "–" if value is None else f"{value:.4g}"


def state(symbol: str, value: float) -> str:
    """Return a state of a path, such as λ = 1.2."""
    return f"{symbol} = {value:.4g}"


def json_value(value: object) -> object:
    """Return a value as JSON holds it: NumPy's numbers as Python's, None for NaN and Inf."""
    if isinstance(value, dict):
        return {key: json_value(v) for key, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_value(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
