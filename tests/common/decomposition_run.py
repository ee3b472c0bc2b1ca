# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A program that tests start: it cuts two cubes that are alike, and says how.

    mpirun -n 2 python3 decomposition_run.py FILE

The first process writes for each cube, by the cells of the mesh before it was distributed, the
process and the subdomain of each cell; for seeds 0, 0 and 1.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from collective import COMM
from problems import cube

from dolfinx_feti.fem.decomposition import decompose

SEEDS = (0, 0, 1)


def parts(subdomains: int) -> list[list[list[int]]]:
    """Return the (cell, process, subdomain) of all cells of a cube, for each seed."""
    mesh = cube(3, 8)
    n = mesh.topology.index_map(3).size_local
    cell = mesh.topology.original_cell_index[:n]
    found = []
    for seed in SEEDS:
        part = decompose(mesh, subdomains, seed=seed).subdomain
        rows = np.stack([cell, np.full(n, COMM.rank), part], axis=1)
        found.append(sorted(np.concatenate(COMM.allgather(rows)).tolist()))
    return found


if __name__ == "__main__":
    written = [parts(12), parts(12)]
    if COMM.rank == 0:
        Path(sys.argv[1]).write_text(json.dumps(written))
