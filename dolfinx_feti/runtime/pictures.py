# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pictures, drawn by matplotlib if that is installed."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["create_figure"]


def create_figure(width: float, height: float) -> Figure:
    """Return an empty figure, apart from the windows of pyplot [inch].

    Raises:
        ImportError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError(
            "Pictures need matplotlib: install it (apt install python3-matplotlib, or pip install "
            "matplotlib), or draw the numbers with another tool."
        ) from error
    return Figure(figsize=(width, height), layout="constrained")
