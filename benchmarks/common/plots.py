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

Style = Mapping[str, Any]

COLOURS = ("#1f5a8a", "#b5443a", "#c9962b", "#5b8c4a", "#7d5a8a")

#: Open circles: what the paper has.
OPEN = {"marker": "o", "mfc": "none", "ls": "none", "ms": 7}


@contextmanager
def picture(
    path: Path, rows: int, columns: int, legend: Mapping[str, Style], **options: object
) -> Iterator[npt.NDArray[np.object_]]:
    """Draw into a file; yield the axes, (rows, columns).

    The legend tells how what is drawn looks, by name; grey if it has no colour. The options are
    those of ``matplotlib.pyplot.subplots``.
    """
    lines = -(-len(legend) // 5)
    height = 3.3 * rows + 0.3 * lines
    size = (4.5 * columns, height)
    fig, axes = plt.subplots(rows, columns, figsize=size, squeeze=False, **options)
    yield axes
    for ax in axes.ravel():
        ax.grid(which="both", color="0.92")
        ax.spines[["top", "right"]].set_visible(False)
    handles = [plt.Line2D([], [], **{"color": "0.4", **style}) for style in legend.values()]
    fig.legend(handles, legend, loc="lower center", ncols=min(len(legend), 5), frameon=False)
    fig.tight_layout(rect=(0, 0.3 * lines / height, 1, 1))
    fig.savefig(path, dpi=120)
    plt.close(fig)


def curve(ax: Axes, points: Sequence[tuple[float, float]], **style: object) -> None:
    """Draw points (x, y), of which there may be none."""
    ax.plot([x for x, _ in points], [y for _, y in points], **style)
