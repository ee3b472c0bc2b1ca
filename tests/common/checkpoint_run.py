# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A run with checkpoints that ends as no file may grow: a small wall goes to a load [mmHg].

python3 checkpoint_run.py FOLDER TARGET
"""

from __future__ import annotations

import resource
import signal
import sys

from mpi4py import MPI

from walls import tube, wall

from dolfinx_feti import loads
from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.loading.load_steps import follow_load
from dolfinx_feti.loading.steps import Steps

COMM = MPI.COMM_WORLD
STEPS = Steps(first=0.9, least=0.1, growth=1.3)


if __name__ == "__main__":
    folder, target = sys.argv[1:]
    checkpoint = Checkpoint(folder, COMM)
    body = wall(tube(around=4, along=2), degree=1)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 12, 1 << 12))
    follow_load(
        body.problem(3),
        lambda mmhg: setattr(body.load, "value", loads.mmhg(mmhg)),
        [float(target)],
        STEPS,
        state=[body.u, body.p],
        checkpoint=checkpoint,
    )
