# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pictures of the pages: axes without a box, one legend below all of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

Style = Mapping[str, Any]

COLOURS = ("#1f5a8a", "#b5443a", "#c9962b", "#5b8c4a", "#7d5a8a")

#: The same colours for dark pages, lighter.
COLOURS_ON_DARK = ("#6cb0ea", "#f08a7e", "#e6bd5c", "#9fd08b", "#c9a3d9")

#: Text, and lines of the grid, on light and on dark pages.
INK = "#202020"
INK_ON_DARK = "#f0f0f0"
GRID = "0.92"
GRID_ON_DARK = "0.3"

#: Width and height of axes with their texts in inches, and pixels per inch.
PANEL = (4.5, 3.3)
DPI = 120

#: Open circles, for values of the paper.
OPEN = {"marker": "o", "mfc": "none", "ls": "none", "ms": 7}


@contextmanager
def picture(
    path: Path,
    rows: int,
    columns: int,
    legend: Mapping[str, Style],
    *,
    dark: bool = False,
    panel: tuple[float, float] = PANEL,
    dpi: int = DPI,
    **options: object,
) -> Iterator[npt.NDArray[np.object_]]:
    """Draw into a file; yield the axes, (rows, columns).

    A picture for dark pages has light text, a transparent background, and COLOURS_ON_DARK in place
    of COLOURS.

    Args:
        path: The file.
        rows: Rows of axes.
        columns: Columns of axes.
        legend: Style of each curve, by name; without a colour it is grey.
        dark: Whether the picture is for dark pages.
        panel: Width and height of each of the axes, with its texts, in inches.
        dpi: Pixels per inch.
        options: Those of ``matplotlib.pyplot.subplots``.
    """
    ink = INK_ON_DARK if dark else INK
    text = dict.fromkeys(
        ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), ink
    )
    lines = -(-len(legend) // 5)
    height = panel[1] * rows + 0.3 * lines
    size = (panel[0] * columns, height)
    with matplotlib.rc_context(text):
        fig, axes = plt.subplots(rows, columns, figsize=size, squeeze=False, **options)
        yield axes
        for ax in axes.ravel():
            ax.grid(which="both", color=GRID_ON_DARK if dark else GRID)
            ax.spines[["top", "right"]].set_visible(False)
        handles = [plt.Line2D([], [], **{"color": "0.4", **style}) for style in legend.values()]
        fig.legend(handles, legend, loc="lower center", ncols=min(len(legend), 5), frameon=False)
        if dark:
            lighten(fig)
        fig.tight_layout(rect=(0, 0.3 * lines / height, 1, 1))
        fig.savefig(path, dpi=dpi, transparent=dark)
    plt.close(fig)


def lighten(figure: Figure) -> None:
    """Replace each of COLOURS in the lines of a figure by that of COLOURS_ON_DARK."""
    lighter = dict(zip(COLOURS, COLOURS_ON_DARK, strict=True))
    for line in figure.findobj(Line2D):
        colour = lighter.get(line.get_color(), line.get_color())
        line.set_color(colour)
        if line.get_markerfacecolor() in lighter:
            line.set_markerfacecolor(colour)


def curve(ax: Axes, points: Sequence[tuple[float, float]], **style: object) -> None:
    """Draw a curve through points (x, y); there may be none."""
    ax.plot([x for x, _ in points], [y for _, y in points], **style)
