# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The two-layer tube with a semi-analytical solution, whole or a quarter of it.

Inner radius 0.71 mm, media 0.26 mm, adventitia 0.13 mm (the carotid artery of a rabbit, Holzapfel,
Gasser, Ogden 2000); the axis is z, from 0 to the length.

    python3 -m dolfinx_feti.meshes.tube tube.xdmf --size 0.13 --length 3 [--quarter]

The lumen is a structured triangulation, on which :mod:`dolfinx_feti.meshes.layers` grows the
layers. Surfaces: `lumen`, `outer`, `opening_1` (z = 0), `opening_2` (z = length), and for the
quarter `symmetry_x` (in the plane x = 0) and `symmetry_y` (in the plane y = 0).
"""

from __future__ import annotations

import argparse
import logging
from pathlib import Path

import numpy as np

from dolfinx_feti.meshes.arguments import count, positive, refusals
from dolfinx_feti.meshes.layers import grow, sheets
from dolfinx_feti.meshes.surface import Indices, Points
from dolfinx_feti.meshes.wall_mesh import TAGS, Quality, measure_quality, write_mesh

__all__ = ["count_around", "create_tube"]

#: Inner radius of the lumen, thickness of the media and of the adventitia [mm]: a rabbit's carotid
#: artery (Holzapfel, Gasser, Ogden 2000).
INNER_RADIUS = 0.71
MEDIA = 0.26
ADVENTITIA = 0.13

log = logging.getLogger(__name__)


def create_tube(
    path: Path | str,
    *,
    length: float = 3.0,
    size: float = 0.13,
    quarter: bool = False,
    through: tuple[int, int] | None = None,
    around: int | None = None,
    along: int | None = None,
) -> Quality:
    """Write the two-layer tube with named layers and surfaces.

    Args:
        path: The file, `*.msh` for Gmsh's format, `*.xdmf` for one that all processes read.
        length: Length [mm].
        size: Wanted length of the edges [mm]; the numbers below follow from it if not given.
        quarter: Only the part with x ≥ 0 and y ≥ 0.
        through: Elements through the media and through the adventitia.
        around: Elements around the circumference (a quarter of it for the quarter).
        along: Elements along the axis.

    Returns:
        Numbers and the histogram of the quality.

    Raises:
        ValueError: An argument is out of its range.

    Note:
        Serial: call it on one process.
    """
    for name, value in (("length", length), ("size", size)):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name}={value} is not a positive number of millimetres")
    around = count_around(size, quarter=quarter) if around is None else around
    along = _count(length, size) if along is None else along
    through = (_count(MEDIA, size), _count(ADVENTITIA, size)) if through is None else through
    if min(*through, along, around) < 1 or (around < 3 and not quarter):
        raise ValueError(
            f"through={through}, around={around}, along={along}: take one element or more in each "
            "direction, three or more around a whole tube"
        )
    unit_points, t, rim = _lumen(around, along, quarter=quarter)
    outer = INNER_RADIUS + MEDIA + ADVENTITIA
    scale = np.array([1, 1, length])
    x, y = (unit_points * [radius, radius, 1] * scale for radius in (INNER_RADIUS, outer))
    layers = sheets((MEDIA, ADVENTITIA), through, (TAGS["media"], TAGS["adventitia"]))
    mesh = grow(x, y, t, through=layers, rim=rim)
    write_mesh(Path(path), mesh)
    quality = measure_quality(mesh)
    log.info("%s", quality)
    return quality


def count_around(size: float, *, quarter: bool) -> int:
    """Return the number of elements around a tube, or a quarter of it.

    Args:
        size: Wanted length of the edges in the middle of the wall [mm].
        quarter: Only the part with x ≥ 0 and y ≥ 0.
    """
    # at least 8 elements around the tube: a coarser one is not round
    circumference = 2 * np.pi * (INNER_RADIUS + (MEDIA + ADVENTITIA) / 2)
    return _count(circumference / 4, size, 2) if quarter else _count(circumference, size, 8)


def _count(extent: float, size: float, minimum: int = 1) -> int:
    """Return the number of elements of about one size along an extent."""
    return max(minimum, round(extent / size))


def _lumen(
    around: int, along: int, *, quarter: bool
) -> tuple[Points, Indices, tuple[Indices, Indices]]:
    """Return points, triangles facing outwards, and the tagged rim of a unit tube.

    Radius and length are 1. Squares are cut along alternating diagonals; point (i, j) is the i-th
    around and the j-th along.
    """
    columns = around + 1 if quarter else around
    angle = np.arange(columns) * (np.pi / 2 if quarter else 2 * np.pi) / around
    z, angle = np.meshgrid(np.linspace(0, 1, along + 1), angle, indexing="ij")
    x = np.column_stack([np.cos(angle).ravel(), np.sin(angle).ravel(), z.ravel()])
    x[np.abs(x) < 1e-15] = 0  # without rounding, so that points lie in the symmetry planes
    j, i = (k.ravel() for k in np.meshgrid(np.arange(along), np.arange(around), indexing="ij"))
    right = (i + 1) % columns
    a = j * columns + i
    b = j * columns + right
    c = b + columns
    d = a + columns
    even = ((i + j) % 2 == 0)[:, None]
    first = np.where(even, np.column_stack([a, b, c]), np.column_stack([a, b, d]))
    second = np.where(even, np.column_stack([a, c, d]), np.column_stack([b, c, d]))
    bottom = np.column_stack([a, b])[j == 0]
    top = np.column_stack([d, c])[j == along - 1]
    rims = [(bottom, "opening_1"), (top, "opening_2")]
    if quarter:
        rims.append((np.column_stack([a, d])[i == 0], "symmetry_y"))
        rims.append((np.column_stack([b, c])[i == around - 1], "symmetry_x"))
    tags = np.repeat([TAGS[name] for _, name in rims], [len(edges) for edges, _ in rims])
    return x, np.vstack([first, second]), (np.vstack([edges for edges, _ in rims]), tags)


def main() -> None:
    """Write a tube from the command line."""
    parser = argparse.ArgumentParser(
        "python3 -m dolfinx_feti.meshes.tube", description="A two-layer tube."
    )
    parser.add_argument("file", type=Path, help="the file to write, *.msh or *.xdmf")
    parser.add_argument("--length", type=positive, default=3.0, help="[mm]")
    parser.add_argument("--size", type=positive, default=0.13, help="of the elements [mm]")
    parser.add_argument("--quarter", action="store_true", help="only a quarter")
    parser.add_argument("--through", type=count, nargs=2, help="elements in media and adventitia")
    parser.add_argument("--around", type=count, help="elements around")
    parser.add_argument("--along", type=count, help="elements along")
    options = vars(parser.parse_args())
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    if options["through"]:
        options["through"] = tuple(options["through"])
    with refusals(parser):
        create_tube(options.pop("file"), **options)


if __name__ == "__main__":
    main()
