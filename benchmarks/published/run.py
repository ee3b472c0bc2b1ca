# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Published numbers, computed again on refined meshes.

    python3 -m benchmarks.published --case land-1,land-2 --mesh 1,2 --json build/published.json

The load is followed to its end by FETI. From the state at :data:`BEFORE` of the load MUMPS goes to
the end, too, by Newton's method in dolfinx alone: displacement and pressure in one matrix, and
nothing of this package but the energy. A case that is in the file is not run again.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import basix.ufl
import dolfinx
import dolfinx.fem.petsc
import ufl

from benchmarks.common import command
from benchmarks.common.records import Record
from benchmarks.published.cases import CASES, Body
from dolfinx_feti.loading import LoadStep, Steps, follow_load
from meshes.arguments import count

__all__ = ["main", "solve_by_mumps"]

#: Share of the load from which MUMPS goes on, its least relative step, and its most.
BEFORE, STEP, MOST = 0.995, 1e-9, 20


def main(argv: Sequence[str] | None = None) -> list[Record]:
    """Compute the cases; return their records, also those that the file had."""
    comm = MPI.COMM_WORLD
    parser = command.create_parser("published", __doc__, comm)
    add = parser.add_argument
    add("--case", type=command.some_of(list(CASES)), default=list(CASES), help=",".join(CASES))
    add("--mesh", type=command.several(count), default=[1, 2, 3], help="refinements; 1,2,3")
    command.add_records(parser)
    args = command.parse_words(parser, argv)
    file = command.open_records(args.json, parser, comm)
    found = []
    for case, mesh in itertools.product(args.case, args.mesh):
        key: Record = {"case": case, "mesh": mesh, "processes": comm.size}
        record = None if args.again else file.find(key)
        if record is None:
            record = file.keep(key, _compute(case, mesh, comm))
        found.append(record)
        command.say(
            f"{case:<8} mesh {mesh}: {record['value']:.5f}, by MUMPS {record['mumps']:.5f}, "
            f"{record['dofs']} dofs, {record['newton']} Newton steps",
            comm,
        )
    return found


def _compute(case: str, mesh: int, comm: MPI.Comm) -> Record:
    """Load a body by both solvers."""
    begun = time.perf_counter()
    body = CASES[case].create(comm, mesh)
    last: list[list[np.ndarray]] = []

    def keep(step: LoadStep) -> None:
        if step.load == BEFORE:
            last.append([f.x.array.copy() for f in (body.u, body.p)])

    first = CASES[case].first
    accepted = follow_load(
        body.problem, body.set_load, [BEFORE, 1.0], Steps(first, least=first / 64),
        state=[body.u, body.p], on_step=keep,
    )  # fmt: skip
    newton = [step for load_step in accepted for step in load_step.all_steps]
    seconds = time.perf_counter() - begun
    value = body.measure(body.u)
    body.u.x.array[:], body.p.x.array[:] = last[0]
    again = solve_by_mumps(body)
    dofmap = body.u.function_space.dofmap
    return {
        "value": value,
        "mumps": body.measure(again),
        "dofs": dofmap.index_map.size_global * dofmap.index_map_bs,
        "subdomains": comm.allreduce(body.problem.decomposition.count),
        "load_steps": len(accepted),
        "newton": len(newton),
        "iterations": sum(step.linear_iterations for step in newton),
        "method": newton[-1].linear_method,
        "seconds": seconds,
    }


def solve_by_mumps(body: Body) -> dolfinx.fem.Function:
    """Solve from the body's state by dolfinx and MUMPS, u and p in one matrix; return u.

    Raises:
        RuntimeError: Newton's method does not converge.
    """
    V, Q = body.u.function_space, body.p.function_space
    mesh = V.mesh
    elements = [space.ufl_element() for space in (V, Q)]
    W = dolfinx.fem.functionspace(mesh, basix.ufl.mixed_element(elements))
    w = dolfinx.fem.Function(W)
    w.sub(0).interpolate(body.u)
    w.sub(1).interpolate(body.p)
    F_u, F_p = (form.arguments()[0] for form in body.residuals)
    parts = [*ufl.split(w), *ufl.TestFunctions(W)]
    F = sum(
        ufl.replace(form, dict(zip((body.u, body.p, argument), (*parts[:2], test), strict=True)))
        for form, argument, test in zip(body.residuals, (F_u, F_p), parts[2:], strict=True)
    )
    space, _ = W.sub(0).collapse()
    held = dolfinx.fem.locate_dofs_topological((W.sub(0), space), 2, body.held)
    bc = dolfinx.fem.dirichletbc(dolfinx.fem.Function(space), held, W.sub(0))
    residual, tangent = (dolfinx.fem.form(form) for form in (F, ufl.derivative(F, w)))
    A = dolfinx.fem.petsc.create_matrix(tangent)
    ksp = PETSc.KSP().create(mesh.comm)
    ksp.setOperators(A)
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    ksp.getPC().setFactorSolverType("mumps")
    dw = dolfinx.fem.Function(W)
    fixed = bc.dof_indices()[0]
    for _ in range(MOST):
        A.zeroEntries()
        dolfinx.fem.petsc.assemble_matrix(A, tangent, bcs=[bc])
        A.assemble()
        r = dolfinx.fem.assemble_vector(residual)
        r.scatter_reverse(dolfinx.la.InsertMode.add)
        r.array[fixed] = 0.0
        b, x = A.createVecLeft(), A.createVecRight()
        b.array[:] = -r.array[: b.getLocalSize()]
        ksp.solve(b, x)
        dw.x.array[: x.getLocalSize()] = x.array
        dw.x.scatter_forward()
        w.x.array[:] += dw.x.array
        size = dolfinx.la.norm(dw.sub(0).collapse().x) / dolfinx.la.norm(w.sub(0).collapse().x)
        if size < STEP:
            u = dolfinx.fem.Function(V)
            u.interpolate(w.sub(0).collapse())
            return u
    raise RuntimeError(f"MUMPS: no convergence in {MOST} Newton steps, the last one {size:.0e}.")
