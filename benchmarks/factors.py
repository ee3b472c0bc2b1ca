# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The multifrontal factorisation of this package compared with MUMPS, on one subdomain.

    python3 -m benchmarks.factors --json build/factors.json

The subdomain is a cube of tetrahedra (P1, linear elasticity, n³ · 6 cells) with springs that make
its matrix K definite, on one process with one thread. Two tasks are timed, as the solver has them:

- ``eliminate``: factor K_II and form S for the interface Γ, the whole surface of the cube; MUMPS
  solves for the columns of K_IΓ,
- ``keep``: factor K, and solve for one right-hand side.

MUMPS analyses each matrix anew. The fronts are created once for a pattern, which takes
``seconds_analysis``.
"""

from __future__ import annotations

import argparse
import itertools
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import dolfinx
import dolfinx.fem.petsc
import ufl

from benchmarks.common import command
from benchmarks.common.pages import Fields, groups
from benchmarks.common.records import Record
from benchmarks.common.study import Arguments, Keep, Study
from dolfinx_feti.feti.subdomain.blocks import sparse_block
from dolfinx_feti.feti.subdomain.factors.multifrontal import (
    FrontElimination,
    Fronts,
    create_fronts,
    load_fronts,
)
from dolfinx_feti.feti.subdomain.factors.petsc_factor import factor_by_petsc
from dolfinx_feti.feti.subdomain.factors.petsc_solver import FactorOptions
from dolfinx_feti.feti.subdomain.factors.protocol import Factor
from dolfinx_feti.feti.subdomain.factors.work_space import WorkSpace, pack
from dolfinx_feti.feti.subsolver_options import DirectOptions
from dolfinx_feti.meshes.arguments import count
from dolfinx_feti.runtime.arrays import Array, Indices
from dolfinx_feti.runtime.petsc_library import csr_of
from dolfinx_feti.torn.connectivity import block_graph

T = TypeVar("T")

#: Compared factorisations.
METHODS = ("multifrontal", "mumps")

#: What is done with the interior dofs.
TASKS = ("eliminate", "keep")

#: Cells on an edge: 1029, 3000 and 10 125 dofs.
SIZES = (6, 9, 14)

#: Stiffness of the springs, relative to the shear modulus times the volume of a node.
SPRINGS = 1e-3

#: Columns that MUMPS solves for at once, as the solver sets it for the two tasks.
RIGHT_HAND_SIDES = {"eliminate": 256, "keep": 32}


@dataclass(frozen=True, slots=True)
class CubeSubdomain:
    """The matrix of the subdomain, and its interface.

    Attributes:
        K: Sequential matrix, (n, n).
        interface: Dofs on the surface, ascending.
        interior: The other dofs, ascending.
    """

    K: PETSc.Mat
    interface: Indices
    interior: Indices


def create_subdomain(cells: int) -> CubeSubdomain:
    """Assemble the matrix of a unit cube with the given number of cells on an edge."""
    mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_SELF, cells, cells, cells)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    strain = ufl.sym(ufl.grad(u))
    stress = 2.0 * strain + 3.0 * ufl.tr(strain) * ufl.Identity(3)
    a = (ufl.inner(stress, ufl.sym(ufl.grad(v))) + SPRINGS * ufl.inner(u, v)) * ufl.dx
    K = dolfinx.fem.petsc.assemble_matrix(dolfinx.fem.form(a))
    K.assemble()
    x = V.tabulate_dof_coordinates()
    on_surface = np.any(np.isclose(x, 0.0) | np.isclose(x, 1.0), axis=1)
    is_interface = np.repeat(on_surface, 3)
    return CubeSubdomain(
        K,
        np.flatnonzero(is_interface).astype(np.int32),
        np.flatnonzero(~is_interface).astype(np.int32),
    )


def timed(work: Callable[[], T], rounds: int) -> tuple[T, float]:
    """Return the result of some work, and its shortest time in a number of rounds [s]."""
    seconds = np.inf
    for _ in range(rounds):
        start = time.perf_counter()
        result = work()
        seconds = min(seconds, time.perf_counter() - start)
    return result, seconds


def schur_by_solves(cube: CubeSubdomain, factor: Factor) -> Array:
    """Return S, packed, by solves with a factor of K_II."""
    coupling = sparse_block(cube.K, cube.interior, cube.interface)
    X = factor.solve(coupling.toarray(order="F"))  # K_II⁻¹ K_IΓ
    K_ΓΓ = sparse_block(cube.K, cube.interface, cube.interface).toarray(order="F")
    return pack(K_ΓΓ - coupling.T @ X)


def find_fronts(cube: CubeSubdomain, task: str) -> Fronts:
    """Create the fronts of the interior for ``eliminate``, those of all dofs for ``keep``."""
    n = cube.K.getSize()[0]
    all_dofs = np.arange(n, dtype=np.int32)
    interface = cube.interface if task == "eliminate" else all_dofs[:0]
    with csr_of(cube.K) as rows:
        graph = block_graph(rows, 3)
    return create_fronts(load_fronts(MPI.COMM_SELF), graph, all_dofs, all_dofs, 3, interface)


def measure_multifrontal(
    cube: CubeSubdomain, task: str, rounds: int
) -> tuple[Factor, Array, Record]:
    """Factor by fronts.

    Args:
        cube: Matrix of the subdomain.
        task: One of :data:`TASKS`.
        rounds: Number of repetitions; the shortest time counts.

    Returns:
        Factor of K_II for ``eliminate``, of K for ``keep``; S, packed, empty for ``keep``; and the
        times [s].
    """
    fronts, analysis = timed(lambda: find_fronts(cube, task), rounds)
    work = WorkSpace()

    def factor() -> FrontElimination:
        with csr_of(cube.K) as rows:
            eliminated = fronts.factor(rows, work)
        assert eliminated is not None
        return eliminated

    eliminated, seconds = timed(factor, rounds)
    times: Record = {"seconds_analysis": analysis, "seconds_factor": seconds}
    return eliminated.factor, eliminated.schur, times


def measure_mumps(cube: CubeSubdomain, task: str, rounds: int) -> tuple[Factor, Array, Record]:
    """Factor by MUMPS; see :func:`measure_multifrontal` for arguments and results."""
    rows = cube.interior if task == "eliminate" else np.arange(cube.K.getSize()[0], dtype=np.int32)
    options = FactorOptions(DirectOptions("factors_"), True, RIGHT_HAND_SIDES[task])

    def factor() -> tuple[Factor, Array]:
        K_II = factor_by_petsc(cube.K, rows, options)
        return K_II, schur_by_solves(cube, K_II) if task == "eliminate" else np.zeros(0)

    (K_II, S), seconds = timed(factor, rounds)
    return K_II, S, {"seconds_analysis": 0.0, "seconds_factor": seconds}


def _run(case: Record, keep: Keep, args: Arguments, _: MPI.Comm) -> None:
    """Factor and solve, and compare the solution with its right-hand side."""
    task = case["task"]
    cube = create_subdomain(case["cells"])
    measure = measure_mumps if case["method"] == "mumps" else measure_multifrontal
    factor, S, times = measure(cube, task, args.rounds)
    n = len(cube.interior) if task == "eliminate" else cube.K.getSize()[0]
    b = np.random.default_rng(1).standard_normal(n)
    x, solve = timed(lambda: factor.solve(b), 10 * args.rounds)
    rows = cube.interior if task == "eliminate" else np.arange(n, dtype=np.int32)
    residual = sparse_block(cube.K, rows, rows) @ x - b
    keep(
        {},
        {
            "dofs": cube.K.getSize()[0],
            "interface": len(cube.interface),
            **times,
            "seconds_solve": solve,
            "mib": factor.memory(),
            "residual": float(np.linalg.norm(residual) / np.linalg.norm(b)),
            "norm_S": float(np.linalg.norm(S)),
        },
    )


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--cells", type=command.several(count), default=list(SIZES), help="on an edge; 6,9,14"
    )
    parser.add_argument("--rounds", type=count, default=5, help="5, of which the shortest counts")


def _cases(args: Arguments, *_: object) -> Iterator[Record]:
    for cells, task, method in itertools.product(args.cells, TASKS, METHODS):
        yield {"cells": cells, "task": task, "method": method}


def _fields(records: Sequence[Record]) -> Fields:
    """Return a row for each size and task, with the quotients of MUMPS and the fronts."""
    rows = []
    for (cells, task), of_row in groups(records, "cells", "task"):
        by_method = {record["method"]: record for record in of_row}
        if set(by_method) != set(METHODS):
            continue
        fronts = by_method["multifrontal"]
        mumps = by_method["mumps"]
        row: Record = {
            "cells": cells,
            "task": task,
            "dofs": fronts["dofs"],
            "analysis_ms": 1e3 * fronts["seconds_analysis"],
            "mib": fronts["mib"],
            "mib_mumps": mumps["mib"],
            "sources": of_row,
        }
        for name in ("factor", "solve"):
            seconds_fronts = fronts[f"seconds_{name}"]
            seconds_mumps = mumps[f"seconds_{name}"]
            row[f"{name}_ms"] = 1e3 * seconds_fronts
            row[f"{name}_mumps_ms"] = 1e3 * seconds_mumps
            row[f"{name}_gain"] = seconds_mumps / seconds_fronts
        rows.append(row)
    factor_gains = [row["factor_gain"] for row in rows] or [math.nan]
    solve_gains = [row["solve_gain"] for row in rows] or [math.nan]
    return {
        "rows": rows,
        "least": min(factor_gains),
        "greatest": max(factor_gains),
        "least_solve": min(solve_gains),
        "greatest_solve": max(solve_gains),
    }


def _is_known(record: Record) -> bool:
    """Return True if a record is one of this study."""
    return record.get("method") in METHODS and record.get("task") in TASKS


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="factors",
    known=_is_known,
    options=_options,
    cases=_cases,
    run=_run,
    fields=_fields,
)

if __name__ == "__main__":
    STUDY.main()
