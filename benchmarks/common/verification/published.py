# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Published numbers, computed again on refined meshes.

FETI follows the load to its end. MUMPS then solves the last step again, from the state at the load
factor :data:`LAST_BUT_ONE`: by dolfinx's Newton method, with displacement and pressure in one
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
from benchmarks.common.verification.cases import CASES, Case
from benchmarks.common.verification.part import Part
from dolfinx_feti.loading import LoadStep
from dolfinx_feti.meshes.arguments import count

#: Load factor from which MUMPS continues. It is close to one, so that Newton's method converges
#: without load steps in between.
LAST_BUT_ONE = 0.995


def _options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this part."""
    add = parser.add_argument
    command.add_choices(parser, "--case", list(CASES))
    add("--mesh", type=command.several(count), default=[1, 2, 3], help="refinements; 1,2,3")


def _cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    """Yield the cases on all meshes."""
    for case, mesh in itertools.product(args.case, args.mesh):
        yield {"case": case, "mesh": mesh, "processes": comm.size}


def _run(key: Record, keep: Keep, _args: Arguments, comm: MPI.Comm) -> None:
    """Load a body to its whole load by FETI, and repeat the last step by MUMPS. Collective."""
    started = time.perf_counter()
    case = CASES[key["case"]]
    body = case.create(comm, key["mesh"])
    earlier: list[np.ndarray] = []  # u and p at LAST_BUT_ONE

    def remember(step: LoadStep) -> None:
        if step.load == LAST_BUT_ONE:
            earlier.extend(f.x.array.copy() for f in (body.u, body.p))

    load_steps = body.inflate([LAST_BUT_ONE, 1.0], case.steps, on_step=remember)
    newton_steps = [step for load_step in load_steps for step in load_step.all_steps]
    seconds = time.perf_counter() - started
    values = body.measure()
    body.u.x.array[:], body.p.x.array[:] = earlier
    _solve_by_mumps(body)
    compared = {
        "values": values,
        "mumps": body.measure(),
        "dofs": body.dofs,
        "subdomains": comm.allreduce(body.problem.decomposition.count),
        "load_steps": len(load_steps),
        "newton": len(newton_steps),
        "iterations": sum(step.linear_iterations for step in newton_steps),
        "method": newton_steps[-1].linear_method,
        "seconds": seconds,
    }
    keep({}, compared)


def _fields(records: Sequence[Record]) -> Fields:
    """Return a section for each case, and a row for each quantity that is judged."""
    sections = []
    quantities: list[Fields] = []
    for name, case in CASES.items():
        of_case = sorted((r for r in records if r["case"] == name), key=lambda r: r["mesh"])
        if of_case:
            rows = [row for record in of_case for row in _mesh_rows(case, record)]
            sections.append({"name": case.name, "source": case.source, "rows": rows})
            judged = next((r for r in of_case if r["mesh"] == case.judged), of_case[-1])
            quantities += _judged_rows(case, judged)
    return {"cases": sections, "quantities": quantities}


def _mesh_rows(case: Case, record: Record) -> Iterator[Fields]:
    """Yield a row for each quantity on one mesh; the first has the cost as well."""
    cost = record
    for key, quantity in case.quantities.items():
        value = record["values"][key]
        mumps = record["mumps"][key]
        yield cost | {
            "mesh": record["mesh"],
            "quantity": quantity.name,
            "value": value,
            "mumps": mumps,
            "apart": abs(mumps / value - 1),
            "sources": [record],
        }
        cost = {}


def _judged_rows(case: Case, record: Record) -> Iterator[Fields]:
    """Yield a row for each quantity: its value, and whether the published range has it."""
    for key, quantity in case.quantities.items():
        value = record["values"][key]
        yield asdict(quantity) | {
            "name": case.name,
            "source": case.source,
            "quantity": quantity.name,
            "value": value,
            "holds": quantity.low <= value <= quantity.high,
            "sources": [record],
        }


def _solve_by_mumps(body: Body) -> None:
    """Solve for u and p by MUMPS from the state of the body, and update this state. Collective."""
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


PUBLISHED = Part(key="case", values=CASES, options=_options, cases=_cases, run=_run, fields=_fields)
