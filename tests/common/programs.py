# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Programs that tests start: a path that is killed and continued, and partitions of two cubes.

    python3 programs.py equilibria|inertia FOLDER [STEPS RANK]
    mpirun -n 2 python3 programs.py cut FILE

The first program follows the block of ``one_scalar.py`` through 60 steps, with memory, dashpots, a
moving base and pressure. It continues from a checkpoint in the folder if there is one. At the end
it writes its results to `FOLDER.npz`. With STEPS the process RANK kills itself: with 3.7 after four
steps, once 0.3 times the duration of the last step has passed.

The second program meshes and decomposes two equal cubes. The file has, for each cube and each of
``SEEDS``, the process and the subdomain of each cell, by its number in the mesh before this was
distributed.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

from mpi4py import MPI

import numpy as np
from one_scalar import Block, Law
from problems import cube
from wall_files import ROOT

from dolfinx_feti.fem.decomposition import decompose
from dolfinx_feti.loading import Checkpoint
from dolfinx_feti.runtime.scotch import repeatable_partitions

COMM = MPI.COMM_WORLD
SEEDS = (0, 0, 1)

#: Beginnings of the environment variables that MPI sets in its processes; a program that starts
#: mpirun must not pass them on.
LAUNCHERS = ("OMPI_", "PMIX_", "PRTE_", "PMI_")


def start(*words: object, processes: int = 1, script: object = __file__) -> subprocess.Popen[str]:
    """Start this program, or another script, with ``words`` as its command line."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith((*LAUNCHERS, "SCOTCH_"))}
    environment |= {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    environment |= {
        "OMPI_MCA_rmaps_base_oversubscribe": "1",
        "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    }
    environment |= {"OMPI_MCA_mpi_yield_when_idle": "1"}
    launch = ["mpirun", "-n", str(processes)] if processes > 1 else []
    command = [*launch, sys.executable, str(script), *map(str, words)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    return subprocess.Popen(command, cwd=ROOT, env=environment, **pipes)


def finish(process: subprocess.Popen[str]) -> None:
    """Wait for a program, and assert that it succeeds; a failure shows its output."""
    try:
        output, _ = process.communicate(timeout=300)
    finally:
        process.kill()
    assert process.returncode == 0, output


def run_block(kind: str, folder: Path, steps: str = "inf", rank: str = "0") -> None:
    """Follow the block to the end, or until this process kills itself."""
    law = Law(0.8 if kind == "inertia" else None, share=0.5, viscosity=0.3, base=0.1, pressure=0.4)
    restart = COMM.bcast((folder / "state.npz").exists())
    block = Block(COMM, law.inertia)
    checkpoint = Checkpoint(folder, COMM, restart=restart)
    block.reset(law)
    steps_before_kill = float(steps)
    step_times = [time.monotonic()]

    def on_step(step: object) -> None:
        step_times.append(time.monotonic())
        if (
            COMM.rank == int(rank)
            and steps_before_kill <= len(step_times) - 1 < steps_before_kill + 1.0
        ):
            moment = (step_times[-1] - step_times[-2]) * (len(step_times) - 1 - steps_before_kill)
            threading.Timer(moment, lambda: os.kill(os.getpid(), signal.SIGKILL)).start()

    path = block.follow(law, [0.3, 0.6], 0.01, growth=1.0, checkpoint=checkpoint, on_step=on_step)
    results = [*block.face(), *block.remembered()]
    if COMM.rank == 0:
        np.savez(folder.with_suffix(".npz"), found=results, path=[step.load for step in path])


def parts(subdomains: int) -> list[list[list[int]]]:
    """Return the (cell, process, subdomain) of all cells of a cube, for each seed."""
    with repeatable_partitions():
        mesh = cube(3, 8)
    cell = mesh.topology.original_cell_index[: mesh.topology.index_map(3).size_local]
    by_seed = []
    for seed in SEEDS:
        part = decompose(mesh, subdomains, seed=seed).subdomain
        rows = np.stack([cell, np.full(len(cell), COMM.rank), part], axis=1)
        by_seed.append(sorted(np.concatenate(COMM.allgather(rows)).tolist()))
    return by_seed


if __name__ == "__main__":
    kind, place, *rest = sys.argv[1:]
    if kind != "cut":
        run_block(kind, Path(place), *rest)
    else:
        written = [parts(12), parts(12)]
        if COMM.rank == 0:
            Path(place).write_text(json.dumps(written))
