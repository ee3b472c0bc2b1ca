# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""What a published result of the adventitia strip is worth: its displacement and its volume.

    python3 -m benchmarks.published.result_file result_10000.vtu --json build/published.json

The file is that of svFSI-Tests, 06-ustruct/02-tensile-adventitia_HGO/24-procs_circum-k0.0, on
trilinear bricks, whose J = det F is taken at 2 x 2 x 2 Gauss points, and its mean in each layer of
cells across the strip. Its record is mesh :data:`PUBLISHED` of the case.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mpi4py import MPI

import meshio
import numpy as np

import basix

from benchmarks.common import command
from benchmarks.common.records import Record

__all__ = ["PUBLISHED", "main"]

PUBLISHED = -1
LEVEL = 4  # decimals of z that tell layers of cells apart

#: Nodes of VTK's hexahedron as basix numbers them.
NODES = [0, 1, 3, 2, 4, 5, 7, 6]


def main(argv: Sequence[str] | None = None) -> Record:
    """Measure a file; return its record."""
    comm = MPI.COMM_WORLD
    parser = command.create_parser("result_file", __doc__, comm)
    parser.add_argument("file", type=Path)
    parser.add_argument("--case", default="strip", help="the case that it is of, strip")
    command.add_records(parser)
    args = command.parse_words(parser, argv)
    records = command.open_records(args.json, parser, comm)
    key: Record = {"case": args.case, "mesh": PUBLISHED, "processes": comm.size}
    record = records.keep(key, {"values": _measure(args.file)})
    command.say(str(record["values"]), comm)
    return record


def _measure(path: Path) -> dict[str, float]:
    """Return u_z of the end and its greatest value [mm], and extremes of J and its means."""
    mesh = meshio.read(path)
    x, u = mesh.points.astype(float), mesh.point_data["ST_Displacement"]
    cells = mesh.cells_dict["hexahedron"][:, NODES]
    points, weights = basix.make_quadrature(basix.CellType.hexahedron, 3)
    element = basix.create_element(basix.ElementFamily.P, basix.CellType.hexahedron, 1)
    slopes = element.tabulate(1, points)[1:, :, :, 0]  # (axis, point, node)
    before, after = (np.einsum("cni,aqn->cqia", y[cells], slopes) for y in (x, x + u))
    volume = np.linalg.det(before) * weights
    J = np.linalg.det(after) / np.linalg.det(before)
    height = np.round(x[cells, 2].mean(axis=1), LEVEL)
    means = [
        (J[layer] * volume[layer]).sum() / volume[layer].sum()
        for layer in (height == z for z in np.unique(height))
    ]
    return {
        "end": float(u[np.isclose(x[:, 2], x[:, 2].max()), 2].mean()),
        "greatest": float(u[:, 2].max()),
        "least_J": float(J.min()),
        "greatest_J": float(J.max()),
        "least_mean": float(min(means)),
        "greatest_mean": float(max(means)),
    }


if __name__ == "__main__":
    main()
