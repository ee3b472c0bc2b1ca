# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Published numbers, computed again on refined meshes.

FETI follows the load to its end. MUMPS then solves the last step again, from the state at
:data:`BEFORE` of the load: by Newton's method of dolfinx, with displacement and pressure in one
matrix. Only the energy comes from this package.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict

from mpi4py import MPI

import numpy as np

import basix.ufl
import dolfinx
import ufl

from benchmarks.common import command
from benchmarks.common.bodies import Body
from benchmarks.common.direct import create_newton
from benchmarks.common.pages import Fields
from benchmarks.common.records import Record
from benchmarks.common.study import Arguments, Keep
from benchmarks.common.verification.cases import CASES
from dolfinx_feti.loading import LoadStep
from dolfinx_feti.meshes.arguments import count

#: Share of the load from which MUMPS continues. It is close to one, so that Newton's method
#: converges without load steps in between.
BEFORE = 0.995


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this part."""
    add = parser.add_argument
    command.add_choices(parser, "--case", list(CASES))
    add("--mesh", type=command.several(count), default=[1, 2, 3], help="refinements; 1,2,3")


def cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    """Yield the cases on all meshes."""
    for case, mesh in itertools.product(args.case, args.mesh):
        yield {"case": case, "mesh": mesh, "processes": comm.size}


def run(key: Record, keep: Keep, _args: Arguments, comm: MPI.Comm) -> None:
    """Load a body by both solvers."""
    begun = time.perf_counter()
    case = CASES[key["case"]]
    body = case.create(comm, key["mesh"])
    last: list[list[np.ndarray]] = []

    def remember(step: LoadStep) -> None:
        if step.load == BEFORE:
            last.append([f.x.array.copy() for f in (body.u, body.p)])

    accepted = body.inflate([BEFORE, 1.0], case.steps, on_step=remember)
    newton = [step for load_step in accepted for step in load_step.all_steps]
    seconds = time.perf_counter() - begun
    values = body.measure()
    u_before, p_before = last[0]
    body.u.x.array[:] = u_before
    body.p.x.array[:] = p_before
    _solve_by_mumps(body)
    found = {
        "values": values,
        "mumps": body.measure(),
        "dofs": body.dofs,
        "subdomains": comm.allreduce(body.problem.decomposition.count),
        "load_steps": len(accepted),
        "newton": len(newton),
        "iterations": sum(step.linear_iterations for step in newton),
        "method": newton[-1].linear_method,
        "seconds": seconds,
    }
    keep({}, found)


def fields(records: Sequence[Record]) -> Fields:
    """Return the cases in their order, with their meshes, and what is judged."""
    sections = []
    summary = []
    for name, case in CASES.items():
        meshes = sorted((r for r in records if r["case"] == name), key=lambda r: r["mesh"])
        if not meshes:
            continue
        about = {"name": case.name, "source": case.source}
        rows = []
        for record in meshes:
            cost = dict(record)  # on the first line of a mesh alone
            for key, quantity in case.quantities.items():
                value, mumps = (record[by][key] for by in ("values", "mumps"))
                row = {"mesh": record["mesh"], "quantity": quantity.name, "value": value}
                compared = {"mumps": mumps, "apart": abs(mumps / value - 1), "sources": [record]}
                rows.append(cost | row | compared)
                cost = {}
        sections.append(about | {"rows": rows})
        judged = next((r for r in meshes if r["mesh"] == case.judged), meshes[-1])
        for key, quantity in case.quantities.items():
            value = judged["values"][key]
            ours = {"value": value, "holds": quantity.low <= value <= quantity.high}
            ours["sources"] = [judged]
            summary.append(asdict(quantity) | about | {"quantity": quantity.name} | ours)
    return {"cases": sections, "quantities": summary}


def _solve_by_mumps(body: Body) -> None:
    """Solve by MUMPS from the state of the body, which gets the solution. Collective."""
    V = body.u.function_space
    Q = body.p.function_space
    elements = [space.ufl_element() for space in (V, Q)]
    W = dolfinx.fem.functionspace(V.mesh, basix.ufl.mixed_element(elements))
    w = dolfinx.fem.Function(W)
    w.sub(0).interpolate(body.u)
    w.sub(1).interpolate(body.p)
    parts = ufl.split(w)
    tests = ufl.TestFunctions(W)
    F = sum(
        ufl.replace(form, {body.u: parts[0], body.p: parts[1], form.arguments()[0]: test})
        for form, test in zip(body.residuals, tests, strict=True)
    )
    bcs = []
    for component, facets in body.supports:
        part = W.sub(0) if component is None else W.sub(0).sub(component)
        space, _ = part.collapse()
        dofs = dolfinx.fem.locate_dofs_topological((part, space), 2, facets)
        bcs.append(dolfinx.fem.dirichletbc(dolfinx.fem.Function(space), dofs, part))
    create_newton(F, w, bcs)()
    body.u.interpolate(w.sub(0).collapse())
    body.p.interpolate(w.sub(1).collapse())
