# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tables as rows of cells, written in Markdown or LaTeX."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

__all__ = ["Table", "count", "number", "percent"]

#: Characters that LaTeX writes in another way.
LATEX = {
    "κ": r"$\kappa$",
    "λ_min": r"$\lambda_{\min}$",
    "λ_max": r"$\lambda_{\max}$",
    "−": "$-$",
    "²": "$^2$",
    "³": "$^3$",
    "×": r"$\times$",
    "–": "--",
    "%": r"\%",
    "_": r"\_",
}


@dataclass(frozen=True, slots=True)
class Table:
    """A table.

    Attributes:
        title: What it shows.
        head: Names of the columns.
        rows: Cells, as many as columns.
        note: Remark below the title.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""

    def markdown(self) -> str:
        """Write it in Markdown, title and note in front; numbers to the right."""
        lines = [list(self.head), ["--:"] * len(self.head), *map(list, self.rows)]
        body = "\n".join("| " + " | ".join(cells) + " |" for cells in lines)
        note = f"{self.note}\n\n" if self.note else ""
        return f"## {self.title}\n\n{note}{body}\n"

    def latex(self) -> str:
        """Write it in LaTeX, for the package booktabs."""
        head, *rows = (" & ".join(map(_latex, cells)) + r" \\" for cells in (self.head, *self.rows))
        return "\n".join(
            [
                r"\begin{table}[t]",
                rf"\caption{{{_latex(self.title)}.}}",
                r"\centering\small",
                rf"\begin{{tabular}}{{{'r' * len(self.head)}}}",
                r"\toprule",
                head,
                r"\midrule",
                *rows,
                r"\bottomrule",
                r"\end{tabular}",
                r"\end{table}",
                "",
            ]
        )


def number(value: float | None) -> str:
    """Return four digits, or a dash for nothing."""
    return "–" if value is None else f"{value:.4g}"


def count(value: float | None) -> str:
    """Return a whole number in groups of three digits, or a dash for nothing."""
    return "–" if value is None else f"{value:,.0f}".replace(",", " ")


def percent(quotient: float) -> str:
    """Return a deviation in per cent."""
    return f"{100 * (quotient - 1.0):+.1f} %".replace("-", "−")


def _latex(text: str) -> str:
    for letters, written in LATEX.items():
        text = text.replace(letters, written)
    return text
