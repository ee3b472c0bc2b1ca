# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Paths with checkpoints, as a program that tests start and kill.

    python3 path_run.py wall FOLDER TARGET
    python3 path_run.py loop FOLDER
    python3 path_run.py equilibria|inertia FOLDER [STEPS RANK]

The wall goes to a load [mmHg], the block that is one scalar through time, with all that there is;
both go on from the checkpoint in the folder, if there is one, and write what they have found to
`FOLDER.npz`. After so many of the block's 60 steps, such as 3.7, one process kills itself: four
steps are balanced then, and 0.3 of the time of a step has gone by. The loop writes a growing state
until it is killed.
"""

from __future__ import annotations

import itertools
import os
import signal
import sys
import threading
import time
from pathlib import Path

from mpi4py import MPI

import numpy as np
from mixed import by_place
from one_scalar import Block, Law
from problems import cube
from walls import tube, wall

import dolfinx

from dolfinx_feti import loads
from dolfinx_feti.loading import Checkpoint, Steps, follow_load

COMM = MPI.COMM_WORLD


def opened(folder: Path) -> Checkpoint:
    """Open the checkpoint, to go on from what is there."""
    restart = COMM.bcast((folder / "state.npz").exists())
    return Checkpoint(folder, COMM, parameters={"kappa": 1000.0}, restart=restart)


def run_wall(folder: Path, target: str) -> None:
    """Load a wall from where the checkpoint is."""
    body, checkpoint = wall(tube(around=4, along=2), degree=1), opened(folder)
    path = follow_load(
        body.problem(3, {"snes_rtol": 1e-12, "ksp_rtol": 1e-10}),
        lambda mmhg: setattr(body.load, "value", loads.mmhg(mmhg)),
        [float(target)],
        Steps(first=0.9, least=0.1, growth=1.3),
        checkpoint=checkpoint,
    )
    u, p = by_place(body.u), by_place(body.p)
    if COMM.rank == 0:
        loads_met = [step.load for step in path]
        np.savez(folder.with_suffix(".npz"), u=u, p=p, load=body.load.value, path=loads_met)


def run_loop(folder: Path) -> None:
    """Write state after state, each of one value all over."""
    checkpoint = opened(folder)
    f = dolfinx.fem.Function(dolfinx.fem.functionspace(cube(2, 3), ("Lagrange", 1)))
    for k in itertools.count():
        f.x.array[:] = k
        checkpoint.write([f], {"value": k})


def run_block(kind: str, folder: Path, steps: str = "inf", rank: str = "0") -> None:
    """Go on to the end, or to a sudden one."""
    law = Law(0.8 if kind == "inertia" else None, share=0.5, viscosity=0.3, base=0.1, pressure=0.4)
    block, checkpoint = Block(COMM, law.inertia), opened(folder)
    block.reset(law)
    left, shown = float(steps), [time.monotonic()]

    def on_step(step: object) -> None:
        shown.append(time.monotonic())
        if COMM.rank == int(rank) and left <= len(shown) - 1 < left + 1.0:
            moment = (shown[-1] - shown[-2]) * (len(shown) - 1 - left)
            threading.Timer(moment, lambda: os.kill(os.getpid(), signal.SIGKILL)).start()

    path = block.follow(law, [0.3, 0.6], 0.01, growth=1.0, checkpoint=checkpoint, on_step=on_step)
    found = [*block.face(), *block.remembered()]
    if COMM.rank == 0:
        np.savez(folder.with_suffix(".npz"), found=found, path=[step.load for step in path])


if __name__ == "__main__":
    kind, folder, *rest = sys.argv[1:]
    if kind == "wall":
        run_wall(Path(folder), *rest)
    elif kind == "loop":
        run_loop(Path(folder))
    else:
        run_block(kind, Path(folder), *rest)
