# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A run with checkpoints, as a program that tests start and kill: a small wall, or a loop.

    python3 checkpoint_run.py wall FOLDER TARGET [restart] [small]
    python3 checkpoint_run.py loop FOLDER

The wall goes to a load [mmHg], and writes its state by place to `FOLDER.npz`; with `small`
no file may grow beyond some bytes. The loop writes a growing state until it is killed.
"""

from __future__ import annotations

import itertools
import resource
import signal
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np
from mixed import by_place
from problems import cube
from walls import tube, wall

import dolfinx

from dolfinx_feti import loads
from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.loading.load_steps import follow_load
from dolfinx_feti.loading.steps import Steps

COMM = MPI.COMM_WORLD
PARAMETERS = {"kappa": 1000.0}
STEPS = Steps(first=0.9, least=0.1, growth=1.3)


def run_wall(folder: Path, target: float, *words: str) -> None:
    """Load a wall from where the checkpoint is."""
    checkpoint = Checkpoint(folder, COMM, parameters=PARAMETERS, restart="restart" in words)
    body = wall(tube(around=4, along=2), degree=1)
    if "small" in words:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 12, 1 << 12))
    steps = follow_load(
        body.problem(3, {"snes_rtol": 1e-12, "ksp_rtol": 1e-10}),
        lambda mmhg: setattr(body.load, "value", loads.mmhg(mmhg)),
        [target],
        STEPS,
        state=[body.u, body.p],
        checkpoint=checkpoint,
    )
    u, p = by_place(body.u), by_place(body.p)
    if COMM.rank == 0:
        path = [step.load for step in steps]
        np.savez(folder.with_suffix(".npz"), u=u, p=p, load=body.load.value, path=path)


def run_loop(folder: Path) -> None:
    """Write state after state, each of one value all over."""
    checkpoint = Checkpoint(folder, COMM, parameters=PARAMETERS)
    f = dolfinx.fem.Function(dolfinx.fem.functionspace(cube(2, 3), ("Lagrange", 1)))
    for k in itertools.count():
        f.x.array[:] = k
        checkpoint.write([f], {"value": k})


if __name__ == "__main__":
    kind, folder, *rest = sys.argv[1:]
    if kind == "wall":
        run_wall(Path(folder), float(rest[0]), *rest[1:])
    else:
        run_loop(Path(folder))
