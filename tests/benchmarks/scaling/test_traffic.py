# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The counts of messages: held against what a small program is known to send."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys

import pytest

from benchmarks.scaling.run import INHERITED
from benchmarks.scaling.traffic import compile_library

pytestmark = [
    pytest.mark.serial,
    pytest.mark.skipif(not shutil.which("mpicc"), reason="there is no mpicc"),
]

PROGRAM = """
import json, sys
from dataclasses import asdict
from mpi4py import MPI
from petsc4py import PETSc
import numpy as np
from benchmarks.scaling.traffic import gather, since_reset, start_count

comm = MPI.COMM_WORLD
right, left = (comm.rank + 1) % comm.size, (comm.rank - 1) % comm.size
found = {}

def counted(name, work):
    start_count()
    work()
    found[name] = gather(since_reset(), comm).tolist()

counted("ring", lambda: comm.Sendrecv(np.ones(5), dest=right, recvbuf=np.ones(5), source=left))
counted("sum", lambda: comm.Allreduce(MPI.IN_PLACE, np.ones(3)))
counted("alone", lambda: MPI.COMM_SELF.Allreduce(MPI.IN_PLACE, np.ones(3)))
half = comm.Split(comm.rank == 0)
counted("pair", half.Barrier)
request = comm.Send_init(np.ones(2), dest=right)

def again():
    for _ in range(3):
        request.Start()
        comm.Recv(np.ones(2), source=left)
        request.Wait()

counted("persistent", again)
x = PETSc.Vec().createMPI((4, None), comm=comm)
x.set(1.0)
counted("dot", lambda: x.dot(x))
if comm.rank == 0:
    print(json.dumps(found))
"""


def test_known_messages(tmp_path):
    library = compile_library(tmp_path)
    environment = {k: v for k, v in os.environ.items() if not k.startswith(INHERITED)}
    words = ["mpirun", "-n", "3", "--oversubscribe", "-x", f"LD_PRELOAD={library}"]
    words += [sys.executable, "-c", PROGRAM]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    # messages, bytes, neighbours, reductions, contributed, others
    assert found["ring"] == [[1, 40, 1, 0, 0, 0]] * 3
    assert found["sum"] == [[0, 0, 0, 1, 24, 0]] * 3
    assert found["alone"] == [[0] * 6] * 3
    assert [each[3:] for each in found["pair"]] == [[0, 0, 0], [0, 0, 1], [0, 0, 1]]
    assert found["persistent"] == [[3, 48, 1, 0, 0, 0]] * 3
    assert [each[3] for each in found["dot"]] == [1, 1, 1]
