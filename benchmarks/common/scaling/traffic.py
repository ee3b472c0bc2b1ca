# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Messages, bytes, neighbours and reductions of each process, counted below PETSc and mpi4py.

PETSc's own log does not see the messages of mpi4py, so those of both are counted in MPI. A small C
library (``traffic.c``) replaces MPI's functions through the profiling interface of the standard. It
is compiled when it is needed, and loaded by ``LD_PRELOAD``; a run without it sends the same
messages. Messages of MUMPS are sent from Fortran and not counted. MUMPS sends few: each subdomain
is factored on one process, and so is the coarse matrix up to 4000 unknowns.
"""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

from mpi4py import MPI

import numpy as np

from dolfinx_feti.runtime.arrays import Array

SOURCE = Path(__file__).with_name("traffic.c")

#: Names of the counters; ``traffic.c`` says what counts.
COUNTERS = ("messages", "bytes", "neighbours", "reductions", "contributed", "others")

# Parameters that several functions share: send and receive buffer (_B, _RB), destination (_TO),
# receive buffer with an operation (_OP), buffers with counts and displacements for each process
# (_BV, _RBV). Then statements that count a collective call by what this process puts in: its buffer
# unless it is MPI_IN_PLACE (_OWN), always its buffer (_ALL), a message to each neighbour
# (_NEIGHBOURS).
_B = "const void *b, N n, MPI_Datatype t"
_RB = "void *rb, N rn, MPI_Datatype rt"
_TO = "int to, int tag, MPI_Comm c"
_OP = "void *rb, N n, MPI_Datatype t, MPI_Op o"
_BV = "const void *b, const N *n, const D *d, MPI_Datatype t"
_RBV = "void *rb, const N *rn, const D *rd, MPI_Datatype rt"
_OWN = "collective(b == MPI_IN_PLACE ? 0 : size_of(n, t), c)"
_ALL = "collective(size_of(n, t), c)"
_NEIGHBOURS = (
    "int *to, out = neighbours(c, &to); for (int i = 0; i < out; i++) "
    "sent({}, world_rank(to[i], c)); free(to)"
)

#: Functions, their parameters, and the statement that counts them. N and D stand for int; in the
#: functions that end in _c, new in MPI 4, for MPI_Count and MPI_Aint. R stands for a request.
FUNCTIONS = (
    ("Send Ssend Bsend Rsend", f"{_B}, {_TO}", "message(size_of(n, t), to, c)"),
    ("Isend Issend Ibsend Irsend", f"{_B}, {_TO}, R", "message(size_of(n, t), to, c)"),
    (
        "Send_init Ssend_init Rsend_init Bsend_init",
        f"{_B}, {_TO}, R",
        "persistent(*r, size_of(n, t), to, c)",
    ),
    (
        "Sendrecv",
        f"{_B}, int to, int tag, {_RB}, int from, int rtag, MPI_Comm c, MPI_Status *s",
        "message(size_of(n, t), to, c)",
    ),
    ("Allreduce Scan Exscan", f"const void *b, {_OP}, MPI_Comm c", _ALL),
    ("Iallreduce", f"const void *b, {_OP}, MPI_Comm c, R", _ALL),
    ("Reduce", f"const void *b, {_OP}, int root, MPI_Comm c", _ALL),
    (
        "Reduce_scatter_block",
        f"const void *b, {_OP}, MPI_Comm c",
        "collective(ranks(c) * size_of(n, t), c)",
    ),
    (
        "Bcast",
        "void *b, N n, MPI_Datatype t, int root, MPI_Comm c",
        "collective(rank(c) == root ? size_of(n, t) : 0, c)",
    ),
    ("Gather Scatter", f"{_B}, {_RB}, int root, MPI_Comm c", _OWN),
    (
        "Gatherv",
        f"{_B}, void *rb, const N *rn, const D *d, MPI_Datatype rt, int root, MPI_Comm c",
        _OWN,
    ),
    ("Allgather", f"{_B}, {_RB}, MPI_Comm c", _OWN),
    ("Allgatherv", f"{_B}, void *rb, const N *rn, const D *d, MPI_Datatype rt, MPI_Comm c", _OWN),
    ("Iallgather", f"{_B}, {_RB}, MPI_Comm c, R", _OWN),
    (
        "Iallgatherv",
        f"{_B}, void *rb, const N *rn, const D *d, MPI_Datatype rt, MPI_Comm c, R",
        _OWN,
    ),
    (
        "Alltoall",
        f"{_B}, {_RB}, MPI_Comm c",
        "collective(b == MPI_IN_PLACE ? 0 : ranks(c) * size_of(n, t), c)",
    ),
    (
        "Alltoallv",
        f"{_BV}, {_RBV}, MPI_Comm c",
        "double sum = 0; for (int i = 0; b != MPI_IN_PLACE && i < ranks(c); i++) "
        "sum += size_of(n[i], t); collective(sum, c)",
    ),
    ("Neighbor_alltoall", f"{_B}, {_RB}, MPI_Comm c", _NEIGHBOURS.format("size_of(n, t)")),
    ("Neighbor_alltoallv", f"{_BV}, {_RBV}, MPI_Comm c", _NEIGHBOURS.format("size_of(n[i], t)")),
    (
        "Ineighbor_alltoallv",
        f"{_BV}, {_RBV}, MPI_Comm c, R",
        _NEIGHBOURS.format("size_of(n[i], t)"),
    ),
)
BARRIERS = (
    ("Barrier", "MPI_Comm c", "collective(0, c)"),
    ("Ibarrier", "MPI_Comm c, R", "collective(0, c)"),
)


def compile_library(folder: Path) -> Path:
    """Compile the library for the MPI of this machine into a folder, and return its path."""
    library = folder / "libtraffic.so"
    if shutil.which("mpicc") is None:
        raise FileNotFoundError("mpicc is missing, which counting messages needs")
    folder.mkdir(parents=True, exist_ok=True)
    lines = [*_functions(BARRIERS + FUNCTIONS, "", "int", "int"), "#if MPI_VERSION >= 4"]
    lines += [*_functions(FUNCTIONS, "_c", "MPI_Count", "MPI_Aint"), "#endif", ""]
    (folder / "functions.h").write_text("\n".join(lines))
    words = ["mpicc", "-std=c11", "-O2", "-Wall", "-shared", "-fPIC", f"-I{folder}"]
    subprocess.run([*words, "-o", str(library), str(SOURCE)], check=True)
    return library.resolve()


def _functions(
    table: tuple[tuple[str, str, str], ...], ending: str, count: str, displacement: str
) -> Iterator[str]:
    """Yield C functions that call those of MPI (``PMPI_…``) and count, one on each line.

    Args:
        table: Names, parameters and counting statement of functions, as in :data:`FUNCTIONS`.
        ending: Ending of the names, empty or ``_c``.
        count: C type of counts.
        displacement: C type of displacements.
    """
    types = {"N": count, "D": displacement, "R": "MPI_Request *r"}
    for names, parameters, statement in table:
        typed = re.sub(r"\b[NDR]\b", lambda found: types[found[0]], parameters)
        words = ", ".join(re.findall(r"(\w+)(?=,|$)", typed))
        for name in names.split():
            yield (
                f"int MPI_{name}{ending}({typed}) {{ int error = PMPI_{name}{ending}({words}); "
                f"{statement}; return error; }}"
            )


def counted(work: Callable[[], object], comm: MPI.Comm) -> Array:
    """Do some work; return the counters of each process, (processes, counters). Collective."""
    (named,) = (word for word in os.environ["LD_PRELOAD"].split(":") if "libtraffic" in word)
    library = ctypes.CDLL(named)  # already in the process: LD_PRELOAD has loaded it
    values = np.zeros(len(COUNTERS))
    library.traffic_reset()
    work()
    library.traffic_read(values.ctypes.data_as(ctypes.POINTER(ctypes.c_double)))
    return np.array(comm.allgather(values))
