# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pictures of response curves and fits, drawn by matplotlib if that is installed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dolfinx_feti.runtime.pictures import create_figure
from dolfinx_feti.workshop.fitting import Fit
from dolfinx_feti.workshop.response import Measure, Response, stresses

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["plot_fit", "plot_responses"]

LETTERS = {"cauchy": ("σ", "Cauchy stress"), "piola": ("P", "first Piola stress")}


def plot_responses(
    responses: Sequence[Response],
    *,
    names: Sequence[str] | None = None,
    measure: Measure = "cauchy",
) -> Figure:
    """Draw the measured stresses of several responses over their stretches or shears.

    Args:
        responses: What :func:`~dolfinx_feti.workshop.response.respond` returned.
        names: Their names in the legend, by default those of the paths.
        measure: ``cauchy`` or ``piola``.

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
    letter, title = _letter(measure)
    figure = create_figure(4.8, 3.8)
    ax = figure.subplots()
    for name, response in zip(names, responses, strict=True):
        for column, (i, j) in zip(
            stresses(response, measure).T, response.path.measured, strict=True
        ):
            label = f"{name}, {letter}$_{{{i + 1}{j + 1}}}$"
            ax.plot(response.path.values, column, label=label)
    ax.set_xlabel(" or ".join(sorted({r.path.symbol for r in responses}, reverse=True)))
    ax.set_ylabel(f"{title} [kPa]")
    ax.legend()
    return figure


def plot_fit(fit: Fit) -> Figure:
    """Draw each data set with its fitted curve.

    Args:
        fit: What :func:`~dolfinx_feti.workshop.fitting.fit` returned.

    Returns:
        A figure of matplotlib with a panel per data set.

    Raises:
        ImportError: matplotlib is not installed.
    """
    panels = len(fit.data)
    figure = create_figure(4.8 * panels, 3.8)
    figure.subplots(1, panels)
    for ax, data, curve in zip(figure.axes, fit.data, fit.curves(), strict=True):
        letter, title = _letter(data.measure)
        computed = stresses(curve, data.measure)
        for k, (i, j) in enumerate(data.path.measured):
            (points,) = ax.plot(data.path.values, data.stress[:, k], "o", markersize=4)
            label = f"{letter}$_{{{i + 1}{j + 1}}}$"
            ax.plot(curve.path.values, computed[:, k], color=points.get_color(), label=label)
        ax.set_title(data.name)
        ax.set_xlabel(data.path.symbol)
        ax.set_ylabel(f"{title} [kPa]")
        ax.legend()
    return figure


def _letter(measure: Measure) -> tuple[str, str]:
    """Return letter and name of a stress.

    Raises:
        ValueError: The measure is unknown.
    """
    if measure not in LETTERS:
        raise ValueError(f"measure = {measure!r}: choose 'cauchy' or 'piola'.")
    return LETTERS[measure]
