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
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dolfinx_feti.meshes.arguments import count, exit_on_errors, positive
from dolfinx_feti.meshes.files import write_wall_arrays
from dolfinx_feti.meshes.layers import Rim, create_sheets, grow_wall
from dolfinx_feti.meshes.quality import MeshQuality, measure_quality
from dolfinx_feti.meshes.tags import SURFACE_TAGS, tags_of
from dolfinx_feti.runtime.arrays import Array, Numbers

__all__ = ["Counts", "count_around", "element_counts", "unit_tube", "write_tube"]

#: Radius of the lumen [mm]: a rabbit's carotid artery (Holzapfel, Gasser, Ogden 2000).
INNER_RADIUS = 0.71

#: Thickness of the media of the same artery [mm].
MEDIA = 0.26

#: Thickness of its adventitia [mm].
ADVENTITIA = 0.13

#: Fewest elements around a whole tube if their number follows from their size: a coarser tube is
#: not round.
MIN_AROUND = 8

#: Coordinates of a unit tube below this size are rounding errors, such as 6e-17 for cos 90°. They
#: become zero, so that points lie in the symmetry planes. The smallest true coordinate other than
#: zero is about one over the number of elements.
ZERO_ATOL = 1e-15

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Counts:
    """Numbers of elements of a tube.

    Attributes:
        through: Through the media and through the adventitia.
        around: Around the circumference, or a quarter of it for a quarter.
        along: Along the axis.
    """

    through: tuple[int, int]
    around: int
    along: int


def write_tube(
    path: Path | str,
    *,
    length: float = 3.0,
    size: float = 0.13,
    quarter: bool = False,
    through: tuple[int, int] | None = None,
    around: int | None = None,
    along: int | None = None,
) -> MeshQuality:
    """Write the two-layer tube with named layers and surfaces. Serial.

    Args:
        path: The file, `*.msh` for Gmsh's format, `*.xdmf` for one that all processes can read.
        length: Length [mm].
        size: Wanted length of the edges [mm]; the numbers below follow from it if not given.
        quarter: Only the part with x ≥ 0 and y ≥ 0.
        through: Elements through the media and through the adventitia.
        around: Elements around the circumference (a quarter of it for the quarter).
        along: Elements along the axis.

    Returns:
        Size and quality of the mesh.

    Raises:
        ValueError: An argument is out of its range, or the path has another ending.
    """
    counts = element_counts(
        length, size, quarter=quarter, through=through, around=around, along=along
    )
    unit_points, t, rim = unit_tube(counts.around, counts.along, quarter=quarter)
    outer_radius = INNER_RADIUS + MEDIA + ADVENTITIA
    lengths = np.array([1, 1, length])
    x = unit_points * [INNER_RADIUS, INNER_RADIUS, 1] * lengths
    y = unit_points * [outer_radius, outer_radius, 1] * lengths
    sheets = create_sheets({"media": MEDIA, "adventitia": ADVENTITIA}, counts.through)
    arrays = grow_wall(x, y, t, sheets=sheets, rim=rim)
    write_wall_arrays(Path(path), arrays)
    quality = measure_quality(arrays.points, arrays.cells)
    log.info("%s", quality)
    return quality


def element_counts(
    length: float,
    size: float,
    *,
    quarter: bool,
    through: tuple[int, int] | None = None,
    around: int | None = None,
    along: int | None = None,
) -> Counts:
    """Return the numbers of elements of a tube, as given or for edges of about one length.

    Args:
        length: Length of the tube [mm].
        size: Wanted length of the edges [mm].
        quarter: Only the part with x ≥ 0 and y ≥ 0.
        through: Elements through the media and through the adventitia, if given.
        around: Elements around the circumference (a quarter of it for the quarter), if given.
        along: Elements along the axis, if given.

    Raises:
        ValueError: An argument is out of its range.
    """
    for name, value in (("length", length), ("size", size)):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name}={value} is not a positive number of millimetres")
    if through is None:
        through = (_elements_along(MEDIA, size), _elements_along(ADVENTITIA, size))
    if around is None:
        around = count_around(size, quarter=quarter)
    if along is None:
        along = _elements_along(length, size)
    fewest_around = 1 if quarter else 3
    if min(*through, along) < 1 or around < fewest_around:
        raise ValueError(
            f"through={through}, around={around}, along={along}: take one element or more in each "
            "direction, three or more around a whole tube"
        )
    return Counts(through, around, along)


def count_around(size: float, *, quarter: bool) -> int:
    """Return the number of elements around a tube, or around a quarter of it.

    Args:
        size: Wanted length of the edges in the middle of the wall [mm].
        quarter: Only the part with x ≥ 0 and y ≥ 0.
    """
    circumference = 2 * np.pi * (INNER_RADIUS + (MEDIA + ADVENTITIA) / 2)
    if quarter:
        return _elements_along(circumference / 4, size, MIN_AROUND // 4)
    return _elements_along(circumference, size, MIN_AROUND)


def _elements_along(extent: float, size: float, minimum: int = 1) -> int:
    """Return the number of elements of about one size along an extent."""
    return max(minimum, round(extent / size))


def unit_tube(around: int, along: int, *, quarter: bool) -> tuple[Array, Numbers, Rim]:
    """Return points, triangles facing outwards, and the rim of a tube of radius and length 1.

    Point (i, j) is the i-th around and the j-th along. The squares between the points are cut along
    alternating diagonals.

    Args:
        around: Squares around the tube, or around a quarter of it.
        along: Squares along the axis.
        quarter: Only the part with x ≥ 0 and y ≥ 0.

    Returns:
        Points, (n, 3), triangles, (m, 3), and the rim.
    """
    columns = around + 1 if quarter else around
    whole_angle = np.pi / 2 if quarter else 2 * np.pi
    angle = np.arange(columns) * whole_angle / around
    z, angle = np.meshgrid(np.linspace(0, 1, along + 1), angle, indexing="ij")
    x = np.column_stack([np.cos(angle).ravel(), np.sin(angle).ravel(), z.ravel()])
    x[np.abs(x) < ZERO_ATOL] = 0

    # corners a, b, c, d of each square, counter-clockwise seen from outside
    j, i = (k.ravel() for k in np.meshgrid(np.arange(along), np.arange(around), indexing="ij"))
    a = j * columns + i
    b = j * columns + (i + 1) % columns
    c = b + columns
    d = a + columns
    is_even = ((i + j) % 2 == 0)[:, None]
    first = np.where(is_even, np.column_stack([a, b, c]), np.column_stack([a, b, d]))
    second = np.where(is_even, np.column_stack([a, c, d]), np.column_stack([b, c, d]))

    rims = {
        "opening_1": np.column_stack([a, b])[j == 0],
        "opening_2": np.column_stack([d, c])[j == along - 1],
    }
    if quarter:
        rims["symmetry_y"] = np.column_stack([a, d])[i == 0]
        rims["symmetry_x"] = np.column_stack([b, c])[i == around - 1]
    rim = Rim(np.vstack(list(rims.values())), tags_of(rims, SURFACE_TAGS))
    return x, np.vstack([first, second]), rim


def main() -> None:
    """Write a tube from the command line."""
    parser = argparse.ArgumentParser(
        "python3 -m dolfinx_feti.meshes.tube", description="A two-layer tube."
    )
    parser.add_argument("file", type=Path, help="the file to write, *.msh or *.xdmf")
    parser.add_argument("--length", type=positive, default=3.0, help="length of the tube [mm]")
    parser.add_argument("--size", type=positive, default=0.13, help="length of the edges [mm]")
    parser.add_argument("--quarter", action="store_true", help="only the part with x, y ≥ 0")
    parser.add_argument("--through", type=count, nargs=2, help="elements in media and adventitia")
    parser.add_argument("--around", type=count, help="elements around")
    parser.add_argument("--along", type=count, help="elements along")
    options = vars(parser.parse_args())
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    if options["through"]:
        options["through"] = tuple(options["through"])
    with exit_on_errors(parser):
        write_tube(options.pop("file"), **options)


if __name__ == "__main__":
    main()
