# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Images side by side in one file, with titles and colour bars, by matplotlib.

Each title is above its image, and each colour bar below the images that share it. All lengths are
in inches; matplotlib takes shares of the figure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dolfinx_feti.output.pictures.colours import ColourScale
from dolfinx_feti.output.pictures.panels import Panel
from dolfinx_feti.output.pictures.rendering import Image

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["write_picture"]

#: Largest width of a picture: 1200 pixels, with text that is legible at half of that.
WIDTH = 6.0

#: Largest height of a picture: two of them fit on a page.
HEIGHT = 4.5

#: Pixels per inch.
DPI = 200

#: Height of the strip of titles: one line of text with margins.
TITLE_HEIGHT = 0.34

#: Distance of the middle of a title from the top, over the height of the strip: a little above its
#: middle, as descenders are shorter than capitals.
TITLE_MIDDLE = 0.45

#: Height of the strip of colour bars: the bar, the line of its ticks, and the label.
BAR_STRIP_HEIGHT = 0.62

#: Distance of a colour bar from the bottom, over the height of the strip: above ticks and label.
BAR_BOTTOM = 0.72

#: Height of a colour bar, about that of a letter.
BAR_HEIGHT = 0.13

#: Length of a colour bar over the width of the images that share it.
BAR_SHARE = 0.84

#: Least length of a colour bar, with room for five numbers.
MIN_BAR_LENGTH = 2.4

#: Space between panels, and at the sides of the picture.
GAP = 0.12

#: Size of titles and labels in points.
FONT_SIZE = 11.0

#: Size of the numbers of colour bars in points.
TICK_SIZE = 9.0

#: Colour of texts on light backgrounds.
DARK_INK = "#202020"

#: Colour of texts on dark backgrounds.
LIGHT_INK = "#f0f0f0"


@dataclass(frozen=True, slots=True)
class _Layout:
    """Lengths of a picture [inches].

    Attributes:
        width: Width of the picture.
        height: Height of the picture.
        top: Height of the strip of titles; 0 without titles.
        bottom: Height of the strip of colour bars; 0 without bars.
        left: Left end of the first image.
        pixel: Size of a pixel of an image.
    """

    width: float
    height: float
    top: float
    bottom: float
    left: float
    pixel: float

    def share(
        self, left: float, bottom: float, width: float, height: float
    ) -> tuple[float, float, float, float]:
        """Return a rectangle in shares of the picture."""
        return left / self.width, bottom / self.height, width / self.width, height / self.height


@dataclass(frozen=True, slots=True)
class _Span:
    """Horizontal range of the images that share a label [inches]."""

    start: float
    end: float


def write_picture(
    path: Path, panels: Sequence[Panel], images: Sequence[Image], scale: ColourScale, *, dark: bool
) -> None:
    """Write titles, images and colour bars to a file.

    Args:
        path: The file.
        panels: The panels, for their titles and labels.
        images: Their images.
        scale: The colours of fields.
        dark: Whether texts are light, for a dark background.
    """
    from matplotlib.figure import Figure

    ink = LIGHT_INK if dark else DARK_INK
    layout = _layout(panels, images)
    figure = Figure(figsize=(layout.width, layout.height), dpi=DPI)
    figure.patch.set_alpha(0.0)
    spans: dict[str, _Span] = {}
    left = layout.left
    for panel, image in zip(panels, images, strict=True):
        right = left + layout.pixel * image.shape[1]
        _add_image(figure, layout, image, left)
        _add_title(figure, layout, panel.title, (left + right) / 2.0, ink)
        if panel.label:
            first = spans.get(panel.label, _Span(left, right))
            spans[panel.label] = _Span(first.start, right)
        left = right + GAP
    for label, span in spans.items():
        _add_colour_bar(figure, layout, label, span, scale, ink)
    figure.savefig(path, transparent=True)


def _layout(panels: Sequence[Panel], images: Sequence[Image]) -> _Layout:
    """Return the largest layout within WIDTH and HEIGHT."""
    top = TITLE_HEIGHT if any(panel.title for panel in panels) else 0.0
    bottom = BAR_STRIP_HEIGHT if any(panel.label for panel in panels) else 0.0
    pixels_wide = sum(image.shape[1] for image in images)
    pixels_high = max(image.shape[0] for image in images)
    inner_gaps = GAP * (len(panels) - 1)
    gaps = inner_gaps + 2.0 * GAP
    pixel = min((WIDTH - gaps) / pixels_wide, (HEIGHT - top - bottom) / pixels_high)
    width = max(pixel * pixels_wide + gaps, WIDTH / 2.0)
    left = (width - pixel * pixels_wide - inner_gaps) / 2.0
    return _Layout(width, pixel * pixels_high + top + bottom, top, bottom, left, pixel)


def _add_image(figure: Figure, layout: _Layout, image: Image, left: float) -> None:
    """Add an image, in the middle between the strips of titles and colour bars.

    Args:
        figure: The figure.
        layout: Its lengths.
        image: The image.
        left: Its left end [inches].
    """
    height = layout.pixel * image.shape[0]
    width = layout.pixel * image.shape[1]
    bottom = layout.bottom + (layout.height - layout.top - layout.bottom - height) / 2.0
    axes = figure.add_axes(layout.share(left, bottom, width, height))
    axes.imshow(image, interpolation="antialiased", aspect="auto")
    axes.set_axis_off()


def _add_title(figure: Figure, layout: _Layout, title: str, middle: float, ink: str) -> None:
    """Add a title.

    Args:
        figure: The figure.
        layout: Its lengths.
        title: The text.
        middle: Its middle from the left [inches].
        ink: Its colour.
    """
    figure.text(
        middle / layout.width,
        1.0 - TITLE_MIDDLE * TITLE_HEIGHT / layout.height,
        title,
        color=ink,
        fontsize=FONT_SIZE,
        ha="center",
        va="center",
    )


def _add_colour_bar(
    figure: Figure, layout: _Layout, label: str, span: _Span, scale: ColourScale, ink: str
) -> None:
    """Add a colour bar with four to five numbers; a power of ten follows the label.

    Args:
        figure: The figure.
        layout: Its lengths.
        label: Text below the bar.
        span: Range of the images that share the bar.
        scale: The colours of fields.
        ink: Colour of texts.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.ticker import MaxNLocator, ScalarFormatter

    margin = 2.0 * GAP
    length = max(BAR_SHARE * (span.end - span.start), MIN_BAR_LENGTH)
    length = min(length, layout.width - 2.0 * margin)
    left = (span.start + span.end - length) / 2.0
    left = min(max(left, margin), layout.width - margin - length)
    bottom = BAR_BOTTOM * BAR_STRIP_HEIGHT
    axes = figure.add_axes(layout.share(left, bottom, length, BAR_HEIGHT))
    mappable = ScalarMappable(Normalize(*scale.ranges[label]), scale.name)
    bar = figure.colorbar(mappable, cax=axes, orientation="horizontal", extend="both")
    bar.locator = MaxNLocator(4)
    formatter = ScalarFormatter(useMathText=True)
    formatter.set_powerlimits((-2, 4))
    bar.formatter = formatter
    bar.update_ticks()
    bar.ax.xaxis.offsetText.set_visible(False)  # its default place is on top of the label
    formatter.set_locs([float(tick) for tick in bar.get_ticks()])
    factor = formatter.get_offset()  # a power of ten, or empty
    bar.set_label(f"{label} {factor}".rstrip(), fontsize=FONT_SIZE, color=ink, labelpad=1)
    bar.ax.tick_params(labelsize=TICK_SIZE, colors=ink)
    outline: Any = bar.outline
    outline.set_edgecolor(ink)
