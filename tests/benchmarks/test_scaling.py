# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Strong scaling: its records, the model of them, and counted messages."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import shutil
import subprocess
import sys

import pytest

from benchmarks import scaling
from benchmarks.common import paper
from benchmarks.common.scaling.model import (
    BANDWIDTH,
    BUS,
    CELLS,
    LATENCY,
    SCATTER,
    STREAM,
    create_model,
    efficiency,
)
from benchmarks.common.scaling.traffic import COUNTERS, compile_library

pytest.importorskip("gmsh")
pytest.importorskip("matplotlib")
pytestmark = pytest.mark.serial

SMALL = "--geometry tube --subdomains 4 --layers 2 --choices paper".split()
main = scaling.STUDY.main


@pytest.mark.skipif(not shutil.which("mpicc"), reason="there is no mpicc")
def test_small_case_is_measured_and_counted(tmp_path, capsys):
    file = tmp_path / "scaling.json"
    folder = tmp_path / "walls"
    shared = f"--count 2 --folder {folder}".split()
    words = [*SMALL, *shared, *f"--size 1 --processes 1 --json {file}".split()]
    main(words)
    counted, measured = json.loads(file.read_text())
    assert (counted["task"], counted["processes"]) == ("count", 2)
    assert counted["neighbours"] == 1
    assert min(counted["iteration"][sent]["max"] for sent in ("messages", "reductions")) >= 1
    assert counted["coarse_solves"] >= 1
    assert (counted["coarse_entries"] > 0) == (counted["coarse_size"] > 0)
    assert counted["messages_to_each"] == counted["iteration"]["messages"]["mean"]  # a neighbour
    assert counted["reading"]["messages"]["max"] >= 1
    (of_own_size,) = main([*SMALL, *shared, "--task", "count"])
    assert of_own_size["dofs"] > counted["dofs"]
    size = (folder / "tube_1.h5").stat().st_size
    assert 0 < counted["reading_bytes"] < 1.2 * size  # half of it, and its layers' points again
    parts = [measured[f"seconds_{part}"] for part in ("local", "krylov", "coarse", "reading")]
    assert min(parts) > 0.0 and sum(parts) <= measured["seconds_total"]
    assert len(measured["linear_iterations_per_newton"]) == measured["newton_iterations"] >= 2
    capsys.readouterr()
    main(words)
    assert capsys.readouterr().out.count("in the records already") == 2
    assert scaling.RECORDS.is_file()
    main(["--predict", "3000000", "512", "--json", str(file)])
    said = capsys.readouterr().out.splitlines()
    assert len(said) == 3 and "classical, the paper's choices: " in said[-1], said


def test_other_tasks_processes_do_not_count():
    """64 processes are counted by default; if the task is to measure, they need no subdomains."""
    study = dataclasses.replace(scaling.STUDY, run=lambda _case, keep, *_: keep({}, {}))
    words = "--task measure --processes 1 --subdomains 16 --layers 2 --choices paper"
    (record,) = study.main(words.split())
    assert (record["task"], record["processes"]) == ("measure", 1)


BASE = {"processes": 1, "subdomains_in_all": 512, "coarse_size": 3072, "newton_iterations": 5}
BASE |= {"linear_iterations_per_newton": [300] * 5, "seconds_local": 400.0, "seconds_total": 2000.0}
BASE |= {"seconds_krylov": 1300.0, "seconds_coarse": 20.0, "seconds_reading": 3.0}
BASE |= {"seconds_fixed": 2.0}
SENT = {"processes": 64, "coarse_solves": 2.0, "coarse_entries": 1e6, "coarse_flops": 1e9}
SENT |= {
    kind: {name: {"mean": 10.0, "max": 10.0} for name in COUNTERS}
    for kind in ("iteration", "reading")
} | {"reading_bytes": 1e6}


def test_papers_efficiencies():
    """Closed form: the printed efficiencies of the paper's last rows."""
    for layers, krylov, total in ((1, 0.606, 0.394), (2, 0.497, 0.305)):
        first, last = (paper.TIMES[layers][P] for P in (paper.FIRST, 512))
        found = [efficiency(16, first[part], 512, last[part]) for part in ("krylov", "total")]
        assert found == pytest.approx([krylov, total], abs=5e-4)


def test_model_gives_back_what_it_begins_with():
    model = create_model([BASE], [SENT])
    first = model.predict(1)
    for part in ("local", "krylov", "coarse", "reading", "fixed", "total"):
        assert first[part] == pytest.approx(BASE[f"seconds_{part}"], rel=1e-12)


def test_work_shrinks_and_what_is_sent_does_not():
    model = create_model([BASE], [SENT])
    two, many, beyond = (model.predict(P) for P in (2, 512, 1024))
    w = SCATTER * math.sqrt(2 * math.log(512))  # for the subdomain with the most work
    assert two["local"] == pytest.approx(200.0 * (1 + SCATTER * math.sqrt(2 * math.log(2) / 256)))
    assert many["local"] == pytest.approx(400.0 / 512 * (1 + w) * 16 / BUS)
    of_cells = 1 + CELLS * math.sqrt(2 * math.log(512))
    assert many["rest"] == pytest.approx(275.0 / 512 * of_cells * 16 / BUS)
    assert many["messages"] == two["messages"] > 0.0
    assert many["reductions"] == pytest.approx(9 * two["reductions"])  # log₂ P
    solves = 1500 * SENT["coarse_solves"]
    assert two["gathering"] == pytest.approx(solves * 16 * 3072 / BANDWIDTH)  # there and back
    assert two["coarse_solves"] == pytest.approx(solves * 16 * SENT["coarse_entries"] / STREAM)
    for found, K, P in ((many, 3072, 512), (beyond, 6144, 1024)):
        each = 2 * LATENCY * math.log2(P) + 8 * K / BANDWIDTH
        assert found["gathering"] == pytest.approx(solves * each)
    assert model.predict(3)["local"] > 400.0 / 3  # 171 of 512 subdomains


@pytest.mark.parametrize(("processes", "measured"), [(4, 0.92), (8, 1.02), (16, 1.44)])
def test_work_on_a_shared_bus_slows_down_as_measured(processes, measured):
    """Against seconds of the tube on a Xeon of 16 cores, without those of the coarse problem.

    50 000 dofs a process in 25 subdomains: 1.80 − 0.42, 1.66 − 0.39, 1.98 − 0.57, 3.59 − 1.60 s.
    """
    model = create_model([BASE | {"subdomains_in_all": 25 * processes}], [SENT])
    slowed = processes * model.predict(processes)["local"] / model.predict(1)["local"]
    assert slowed == pytest.approx(measured, rel=0.16)


PROGRAM = """
import json, sys
from dataclasses import asdict
from mpi4py import MPI
from petsc4py import PETSc
import numpy as np
from benchmarks.common.scaling.traffic import counted as traffic

comm = MPI.COMM_WORLD
right, left = (comm.rank + 1) % comm.size, (comm.rank - 1) % comm.size
found = {}

def counted(name, work):
    found[name] = traffic(work, comm).tolist()

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


@pytest.mark.skipif(not shutil.which("mpicc"), reason="there is no mpicc")
def test_known_messages(tmp_path):
    library = compile_library(tmp_path)
    environment = {k: v for k, v in os.environ.items() if not k.startswith(scaling.INHERITED)}
    environment |= scaling.SHARED_CORES
    words = ["mpirun", "-n", "3", "env", f"LD_PRELOAD={library}", sys.executable, "-c", PROGRAM]
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
