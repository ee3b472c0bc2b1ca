# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI beside MUMPS and GAMG on the same matrix.

The two-layer tube, P2–P0, first Newton step at 1 mmHg:

    python3 -m benchmarks.compare --kappa 1000 --dofs 180000 --json build/compare.json

Under ``mpirun`` the memory is the sum over the processes. FETI gets the torn matrix; MUMPS
(Cholesky) and GAMG (CG, six rigid body modes) the assembled one that PETSc converts from it.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import petsc4py

petsc4py.init(sys.argv)

from mpi4py import MPI  # noqa: E402
from petsc4py import PETSc  # noqa: E402

from benchmarks.tube_problem import TubeProblem, create_tube_problem  # noqa: E402
from dolfinx_feti import loads  # noqa: E402

RTOL = 1e-8


class PeakMemory:
    """Sample the resident memory of this process; ``mib`` is the largest value seen."""

    def __enter__(self) -> PeakMemory:
        """Give free memory back and begin."""
        ctypes.CDLL(None).malloc_trim(0)
        self.mib = 0.0
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._sample, daemon=True)
        self._thread.start()
        return self

    def _sample(self) -> None:
        while not self._done.wait(0.02):
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            self.mib = max(self.mib, pages * 4096 / 2**20)

    def __exit__(self, *_: object) -> None:
        """Stop sampling."""
        self._done.set()
        self._thread.join()


def measure(
    name: str, tube: TubeProblem, create: Callable[[], PETSc.KSP], r: PETSc.Vec
) -> tuple[dict[str, object], PETSc.Vec]:
    """Time set-up and solve of one solver for K ΔU = −r."""
    comm = r.comm.tompi4py()
    comm.Barrier()
    with PeakMemory() as peak:
        started = time.perf_counter()
        ksp = create()
        ksp.setUp()
        comm.Barrier()
        set_up = time.perf_counter() - started
        x = r.duplicate()
        started = time.perf_counter()
        ksp.solve(r, x)
        comm.Barrier()
        solved = time.perf_counter() - started
    record: dict[str, object] = {
        "solver": name,
        "iterations": ksp.getIterationNumber(),
        "seconds_setup": set_up,
        "seconds_solve": solved,
        "peak_mib": comm.allreduce(peak.mib),
        "converged_reason": ksp.getConvergedReason(),
    }
    if name == "feti":
        ksp.view()
    ksp.destroy()
    return record, x


def create_feti(tube: TubeProblem) -> PETSc.KSP:
    """Return the KSP of the problem."""
    ksp = tube.problem.solver.getKSP()
    ksp.setOperators(tube.problem.A)
    ksp.incRef()
    return ksp


def create_mumps(K: PETSc.Mat) -> PETSc.KSP:
    """Return a Cholesky factorisation by MUMPS."""
    ksp = PETSc.KSP().create(K.comm)
    ksp.setOptionsPrefix("mumps_")
    ksp.setOperators(K)
    ksp.setType("preonly")
    ksp.getPC().setType("cholesky")
    ksp.getPC().setFactorSolverType("mumps")
    ksp.getPC().setFactorSetUpSolverType()
    ksp.getPC().getFactorMatrix().setMumpsIcntl(
        14, 50
    )  # more work space, or it fails on 2 processes
    ksp.setFromOptions()
    return ksp


def create_gamg(K: PETSc.Mat) -> PETSc.KSP:
    """Return CG with smoothed aggregation and the rigid body modes."""
    ksp = PETSc.KSP().create(K.comm)
    ksp.setOptionsPrefix("gamg_")
    ksp.setOperators(K)
    ksp.setType("cg")
    ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
    ksp.setTolerances(rtol=RTOL, max_it=2000)
    ksp.getPC().setType("gamg")
    ksp.setFromOptions()
    return ksp


def assembled(tube: TubeProblem) -> PETSc.Mat:
    """Convert the torn matrix to the assembled one, with the Dirichlet rows and columns of I."""
    A = tube.problem.A
    K = PETSc.Mat()
    A.convert("aij", K)
    K.setBlockSize(3)
    K.setOption(PETSc.Mat.Option.SPD, True)
    K.zeroRowsColumns(A.query("dirichlet").getIndices(), 1.0)
    K.setNearNullSpace(A.getNearNullSpace())
    return K


def main() -> None:
    """Run the comparison."""
    parser = argparse.ArgumentParser("compare", description=__doc__.splitlines()[0])
    parser.add_argument("--kappa", type=float, default=1000.0, help="[kPa]")
    parser.add_argument("--dofs", type=int, default=180_000)
    parser.add_argument("--subdomains", type=int, default=96)
    parser.add_argument("--solvers", default="feti,mumps,gamg")
    parser.add_argument("--json", type=Path)
    args, _ = parser.parse_known_args()
    comm = MPI.COMM_WORLD
    if args.json is not None and comm.rank == 0:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        args.json.touch()
    options: dict[str, object] = {"ksp_rtol": RTOL}
    tube = create_tube_problem(
        comm, dofs=args.dofs, kappa=args.kappa, subdomains=args.subdomains, options=options
    )
    tube.pressure.value = loads.mmhg(1.0)
    system = tube.problem._system
    r = tube.problem.A.createVecLeft()
    r.array[:] = -system.residual()
    system.linearise()
    records, solutions = [], {}
    names = args.solvers.split(",")
    if "feti" in names:
        record, solutions["feti"] = measure("feti", tube, lambda: create_feti(tube), r)
        records.append(record)
    K = assembled(tube)
    for name, create in (("mumps", create_mumps), ("gamg", create_gamg)):
        if name in names:
            record, solutions[name] = measure(name, tube, lambda make=create: make(K), r)
            records.append(record)
    y = r.duplicate()
    for record in records:
        x = solutions[record["solver"]]
        K.mult(x, y)
        y.axpy(-1.0, r)
        record["relative_residual"] = y.norm() / r.norm()
        if "mumps" in solutions:
            solutions["mumps"].copy(y)
            y.axpy(-1.0, x)
            record["difference_to_mumps"] = y.norm() / solutions["mumps"].norm()
        record |= {"kappa": args.kappa, "dofs": r.getSize(), "processes": comm.size}
        if comm.rank == 0:
            print(json.dumps(record))
    if comm.rank == 0 and args.json is not None:
        args.json.write_text(json.dumps(records, indent=1))


if __name__ == "__main__":
    main()
