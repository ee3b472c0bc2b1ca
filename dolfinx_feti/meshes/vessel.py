# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The wall of a real vessel, grown on the surface of Gmsh's own example.

The lumen is `aneurysm_data.stl`, a cerebral artery with a sac and three openings, in millimetres.
It comes with Debian's package gmsh-doc and with the Python wheel of gmsh, and is read from there.

    python3 -m dolfinx_feti.meshes.vessel vessel.xdmf --size 1.2 --thickness 1.0

Another lumen with open ends is read from an STL file, and ``--layers`` names the layers:

    python3 -m dolfinx_feti.meshes.vessel wall.msh --surface lumen.stl --layers wall --thickness 1.0

1. remesh the surface to triangles of one size (:mod:`dolfinx_feti.meshes.remesh`),
2. grow the layers outwards along averaged normals, by default the media (two thirds) and the
   adventitia (one third),
3. move the tops of the columns that degenerate in the crotches (:mod:`dolfinx_feti.meshes.layers`),
4. tag: the first sheet is the lumen, the last one the outer wall, and the faces above the rims are
   the openings, the longest rim first.
"""

from __future__ import annotations

import argparse
import importlib.util
import logging
import site
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph

from dolfinx_feti.meshes.arguments import count, positive, refusals, share
from dolfinx_feti.meshes.layers import grow, improve_tops, sheets
from dolfinx_feti.meshes.remesh import remesh
from dolfinx_feti.meshes.surface import (
    Indices,
    Points,
    edge_lengths,
    find_edges,
    read_stl,
    unit,
    vertex_normals,
)
from dolfinx_feti.meshes.wall_mesh import TAGS, Quality, measure_quality, write_mesh

__all__ = ["create_vessel", "find_surface"]

#: File of Gmsh's example.
SURFACE = "aneurysm_data.stl"

#: Folders with it, below the root of an installation: those of the wheel and of Debian's package.
FOLDERS = ("share/doc/gmsh/examples/api", "share/doc/gmsh-doc/doc/gmsh/examples/api")

#: Lowest quality (minSICN) of a tetrahedron in a wall that is written: walls of the default size
#: have 0.24 and more (meshes/README.md); flatter tetrahedra degrade the stresses first.
MIN_QUALITY = 0.1

#: The layers of an artery and their shares of the thickness.
LAYERS = {"media": 2 / 3, "adventitia": 1 / 3}

log = logging.getLogger(__name__)


def create_vessel(
    path: Path | str,
    *,
    size: float = 1.2,
    thickness: float = 1.0,
    layers: Mapping[str, float] = LAYERS,
    through: Sequence[int] | None = None,
    surface: Path | str | None = None,
    scale: float = 1.0,
) -> Quality:
    """Write the wall of a vessel with named layers and surfaces.

    Args:
        path: The file, `*.msh` for Gmsh's format, `*.xdmf` for one that all processes read.
        size: Length of the triangles' edges on the lumen [mm]; 1.2 gives 40 000 tetrahedra.
        thickness: Thickness of the wall [mm].
        layers: The names of the layers from the inside out, and their shares of the thickness.
        through: Elements through each layer; None for one.
        surface: An STL file of a lumen with open ends; None for Gmsh's example.
        scale: Millimetres in its unit of length.

    Returns:
        Numbers and the histogram of the quality.

    Raises:
        FileNotFoundError: There is no surface.
        ValueError: The surface is closed or damaged, an argument is out of its range, or an
            element is worse than 0.1.

    Note:
        Serial: call it on one process.
    """
    path = Path(path)
    through = [1] * len(layers) if through is None else list(through)
    _check(layers, through, size=size, thickness=thickness, scale=scale)
    source = find_surface() if surface is None else Path(surface)
    log.info("remeshing %s with edges of %g mm", source, size)
    corners, triangles = read_stl(source)
    x, t = remesh(*_outward(scale * corners, triangles), size=size)
    rim = _rims(x, t)
    log.info("growing a wall of %g mm on %d triangles", thickness, len(t))
    tags = layer_tags(layers)
    heights, between = sheets(list(layers.values()), through, list(tags.values()))
    y = x + thickness * _directions(x, t, rim)
    y = improve_tops(x, y, t, heights=heights)
    mesh = grow(x, y, t, through=(heights, between), rim=rim)
    quality = measure_quality(mesh)
    log.info("%s", quality)
    if quality.minimum < MIN_QUALITY:
        raise ValueError(
            f"With size={size:g} and thickness={thickness:g} the worst of {quality.cells} "
            f"tetrahedra has a quality of {quality.minimum:.3f}, less than {MIN_QUALITY}: take a "
            "size of one to two times the thickness, or a thinner wall"
        )
    write_mesh(path, mesh, {name: TAGS[name] for name in TAGS if name not in LAYERS} | tags)
    return quality


def find_surface(folders: Sequence[Path] | None = None) -> Path:
    """Return the path of Gmsh's example surface.

    Args:
        folders: Where to look; None for where Debian's gmsh-doc and the gmsh wheel put it.

    Raises:
        FileNotFoundError: It is in none of them.
    """
    if folders is None:
        spec = importlib.util.find_spec("gmsh")
        above = list(Path(spec.origin).resolve().parents)[:5] if spec and spec.origin else []
        bases = [sys.prefix, sys.base_prefix, site.getuserbase(), "/usr", "/usr/local"]
        roots = [*above, *(Path(base) for base in bases)]
        folders = [root / folder for root in roots for folder in FOLDERS]
    for folder in folders:
        for name in (SURFACE, SURFACE + ".gz"):
            if (folder / name).is_file():
                return folder / name
    raise FileNotFoundError(
        f"Gmsh's example surface {SURFACE} is not on this machine. Install it with `apt install "
        "gmsh-doc` (Debian, Ubuntu) or `pip install gmsh`, or name an STL file of your own with "
        "surface= (--surface)."
    )


def layer_tags(names: Iterable[str]) -> dict[str, int]:
    """Return the tags of layers: those that media and adventitia always have, others from 101."""
    return {name: TAGS[name] if name in LAYERS else 100 + i for i, name in enumerate(names, 1)}


def _check(layers: Mapping[str, float], through: Sequence[int], **lengths: float) -> None:
    """Check the arguments of :func:`create_vessel`.

    Raises:
        ValueError: One is out of its range.
    """
    for name, value in lengths.items():
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name}={value} is not a positive number of millimetres")
    for name, value in layers.items():
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"layers: the share {value} of {name!r} is not a positive number")
        if not name or '"' in name or name in TAGS.keys() - LAYERS.keys():
            raise ValueError(f"layers: {name!r} is the name of a surface or none: take another one")
    if not layers:
        raise ValueError("layers is empty: name a layer, as in {'wall': 1.0}")
    if len(through) != len(layers) or min(through) < 1:
        raise ValueError(
            f"through={tuple(through)}: each of the {len(layers)} layers needs an element or more"
        )


def _outward(x: Points, t: Indices) -> tuple[Points, Indices]:
    """Return a surface whose triangles face outwards: all are turned if they face inwards.

    They do if the volume inside, with each rim closed by a cone, is negative.

    Args:
        x: Points, (n, 3).
        t: Triangles, (m, 3).

    Raises:
        ValueError: The surface is closed, or two triangles at an edge face different sides.
    """
    # each edge of a triangle as one number, and of the triangle on its other side
    half = t[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    key = half @ [len(x), 1]
    reverse = half[:, ::-1] @ [len(x), 1]
    if len(np.unique(key)) < len(key):
        raise ValueError("The triangles of the surface do not face one way: repair the surface")
    rim = half[~np.isin(key, reverse)]
    if not len(rim):
        raise ValueError("The surface is closed: a vessel needs open ends")
    loop = _loops(rim, len(x))
    # tips of the cones, the centres of the rims; then six times the volume
    sums = np.column_stack([np.bincount(loop, x[rim[:, 0], k]) for k in range(3)])
    tips = (sums / np.bincount(loop)[:, None])[loop]
    a, b, c = np.moveaxis(x[t], 1, 0)
    volume = np.sum(a * np.cross(b, c)) + np.sum(x[rim[:, 1]] * np.cross(x[rim[:, 0]], tips))
    return (x, t) if volume > 0 else (x, t[:, ::-1])


def _loops(rim: Indices, n: int) -> Indices:
    """Return the number of the loop on which each edge of the rim lies; n vertices in all."""
    graph = scipy.sparse.coo_matrix((np.ones(len(rim)), tuple(rim.T)), shape=(n, n))
    _, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    return np.asarray(np.unique(label[rim[:, 0]], return_inverse=True)[1])


def _rims(x: Points, t: Indices) -> tuple[Indices, Indices]:
    """Return the edges of the rims and the tags of their openings, the longest rim first."""
    rim = find_edges(t).rim
    loop = _loops(rim, len(x))
    length = np.bincount(loop, edge_lengths(x, rim))
    rank = np.argsort(np.argsort(-length))
    return rim, TAGS["opening_1"] + rank[loop]


def _directions(x: Points, t: Indices, rim: tuple[Indices, Indices]) -> Points:
    """Return the directions to grow: the normals, on a rim within its plane, so cuts are flat."""
    direction = vertex_normals(x, t)
    edges, tags = rim
    for tag in np.unique(tags):
        loop = np.unique(edges[tags == tag])
        axis = np.linalg.svd(x[loop] - x[loop].mean(axis=0), full_matrices=False)[2][2]
        flat = direction[loop] - (direction[loop] @ axis)[:, None] * axis
        direction[loop] = unit(flat)
    return direction


def main() -> None:
    """Write a vessel from the command line."""
    parser = argparse.ArgumentParser(
        "python3 -m dolfinx_feti.meshes.vessel", description="A vessel's wall."
    )
    parser.add_argument("file", type=Path, help="the file to write, *.msh or *.xdmf")
    parser.add_argument("--size", type=positive, default=1.2, help="edges on the lumen [mm]")
    parser.add_argument("--thickness", type=positive, default=1.0, help="of the wall [mm]")
    parser.add_argument(
        "--layers",
        type=share,
        nargs="+",
        metavar="NAME=SHARE",
        default=list(LAYERS.items()),
        help="from the inside out, and their shares of the thickness, media=2 adventitia=1",
    )
    parser.add_argument("--through", type=count, nargs="+", help="elements in each layer, 1")
    parser.add_argument("--surface", type=Path, help="an STL file of a lumen with open ends")
    parser.add_argument("--scale", type=positive, default=1.0, help="mm in its unit of length, 1")
    options = vars(parser.parse_args())
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    with refusals(parser):
        create_vessel(options.pop("file"), **options | {"layers": dict(options["layers"])})


if __name__ == "__main__":
    main()
