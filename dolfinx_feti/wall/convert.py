# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A wall in any format becomes one that all processes read.

    python3 -m dolfinx_feti.wall.convert wall.msh wall.xdmf
    mpirun -n 8 python3 -m dolfinx_feti.wall.convert metres.vtu wall.xdmf --scale 1000

It writes `wall.xdmf` and `wall.h5`, in millimetres. The formats are those of ``read_wall``.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from mpi4py import MPI

from dolfinx_feti.wall.reading import read_wall
from dolfinx_feti.wall.xdmf import write_wall

__all__: list[str] = []


def main(argv: Sequence[str] | None = None) -> None:
    """Read the wall that the command line names, and write it. Collective.

    Raises:
        SystemExit: The wall cannot be read or written; one line says why.
    """
    name = "python3 -m dolfinx_feti.wall.convert"
    parser = argparse.ArgumentParser(name, description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("source", type=Path, help="a wall in a format of read_wall")
    parser.add_argument("target", type=Path, help="the file to write, *.xdmf")
    parser.add_argument("--scale", type=float, default=1.0, help="mm in the source's unit, 1")
    args = parser.parse_args(argv)
    try:
        write_wall(args.target, read_wall(args.source, MPI.COMM_WORLD, scale=args.scale))
    except (ImportError, OSError, ValueError) as error:
        first = MPI.COMM_WORLD.rank == 0
        parser.exit(2, f"{name}: error: {' '.join(str(error).split())}\n" if first else None)


if __name__ == "__main__":
    main()
