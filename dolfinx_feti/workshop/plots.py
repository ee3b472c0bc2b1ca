# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A picture of response curves and of what was measured, if matplotlib is installed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dolfinx_feti.workshop.response import DataSet, Measure, Response, stresses

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["plot_responses"]


def plot_responses(
    responses: Sequence[Response],
    data: Sequence[DataSet] = (),
    *,
    names: Sequence[str] | None = None,
    measure: Measure = "cauchy",
) -> Figure:
    """Draw stresses over stretches or shears: of responses as lines, of data sets as points.

    Args:
        responses: What :func:`~dolfinx_feti.workshop.response.respond` returned.
        data: What was measured, as ``found.data`` of a fit, with its ``found.responses``.
        names: Names of the responses in the legend, by default those of the paths.
        measure: ``cauchy`` or ``piola``, of the responses; data sets have their own.

    Returns:
        A figure of matplotlib, to be saved by its ``savefig``.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: There is no response, the names are more or fewer, or the measure is unknown.
    """
    if not responses:
        raise ValueError("responses is empty: give at least one response.")
    names = [r.path.name for r in responses] if names is None else names
    if len(names) != len(responses):
        raise ValueError(f"names = {names}: give one for each of the {len(responses)} responses.")
    named = zip(names, responses, strict=True)
    curves = [(name, r.path, stresses(r, measure)) for name, r in named]
    try:
        from matplotlib.figure import Figure  # without the windows of pyplot
    except ImportError as error:
        raise ImportError(
            "Pictures need matplotlib: install it (apt install python3-matplotlib, or pip install "
            "matplotlib), or draw the numbers with another tool."
        ) from error
    figure = Figure(figsize=(4.8, 3.8), layout="constrained")
    ax = figure.subplots()
    for parts, style in ((curves, "-"), ([(d.name, d.path, d.stress) for d in data], "o")):
        for name, path, values in parts:
            for (i, j), column in zip(path.measured, values.T, strict=True):
                ax.plot(path.values, column, style, markersize=4, label=f"{name}, {i + 1}{j + 1}")
    ax.set_xlabel(" or ".join(sorted({r.path.symbol for r in responses}, reverse=True)))
    ax.set_ylabel({"cauchy": "Cauchy", "piola": "first Piola"}[measure] + " stress [kPa]")
    ax.legend()
    return figure
