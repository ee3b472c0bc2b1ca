# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tables and numbers as text, and conversion of values to JSON, for reports."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TypeAlias

import numpy as np

__all__ = ["Cell", "format_number", "format_value", "json_value", "text_table"]

#: An entry of a table: text, a number, or None for a dash.
Cell: TypeAlias = str | float | None


def text_table(head: Sequence[str], rows: Sequence[Sequence[Cell]]) -> str:
    """Return a table with aligned columns: text to the left, numbers to the right.

    Args:
        head: Headings of the columns.
        rows: Rows of text, numbers, or None.
    """
    cells = [[_text(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(head, *cells, strict=True)]
    is_text = [_is_text(row[j] for row in rows) for j in range(len(head))]
    lines = []
    for row in (head, *cells):
        padded = (
            cell.ljust(width) if is_left else cell.rjust(width)
            for cell, width, is_left in zip(row, widths, is_text, strict=True)
        )
        lines.append("  ".join(padded).rstrip())
    return "\n".join(lines)


def _text(cell: Cell) -> str:
    """Return a cell of a table as text."""
    return cell if isinstance(cell, str) else format_number(cell)


def _is_text(column: Iterable[Cell]) -> bool:
    """Return True if all cells of a column are text."""
    return all(isinstance(cell, str) for cell in column)


def format_number(value: float | None) -> str:
    """Return a number with four digits, or a dash for None."""
    return "–" if value is None else f"{value:.4g}"


def format_value(symbol: str, value: float) -> str:
    """Return a symbol and its value with four digits, such as λ = 1.2."""
    return f"{symbol} = {value:.4g}"


def json_value(value: object) -> object:
    """Return a value for JSON: numbers of NumPy as those of Python, None for NaN and Inf.

    Args:
        value: A number, text, None, or dicts, lists and tuples of these.
    """
    if isinstance(value, dict):
        return {key: json_value(v) for key, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_value(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
