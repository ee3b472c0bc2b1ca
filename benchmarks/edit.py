# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""From an edited energy to the first equilibrium, beside dolfinx's own problem with MUMPS.

    python3 -m benchmarks.edit --json build/edit.json --figure docs/images/edit.png

A block of 960 tetrahedra (P2) is clamped on one side and pulled by a body force. Each edit changes
a number in the energy, so that no cache has its forms; the first edit of a run is not recorded.
Seconds are those of the processor, with the C compiler, from UFL to the equilibrium, and those of a
second solve. The two fields of the three-field energy are condensed; dolfinx solves for them.
"""

from __future__ import annotations

import argparse
import json
import os
import random
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from time import perf_counter

from mpi4py import MPI

import numpy as np

import basix.ufl
import dolfinx
import dolfinx.fem.petsc
import dolfinx.nls.petsc
import ufl

from benchmarks.common.machine import describe
from benchmarks.common.plots import COLOURS, picture
from dolfinx_feti import NonlinearProblem

__all__ = ["MATERIALS", "main"]

Expr = ufl.core.expr.Expr
Solve = Callable[[], object]

#: PETSc's options for a direct solver.
MUMPS = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}

RTOL = 1e-8
A1, A2 = (ufl.as_vector([0.88, s * 0.475, 0.0]) for s in (1.0, -1.0))


def push(E: Expr, k1: float, k2: float) -> Expr:
    """The energy of fibres that do not push [kPa]."""
    return ufl.conditional(ufl.gt(E, 0.0), k1 / (2 * k2) * (ufl.exp(k2 * E**2) - 1), 0.0)


def hgo(F: Expr, c: float) -> Expr:
    """Holzapfel, Gasser, Ogden."""
    C = isochoric(F)
    return c / 2 * (ufl.tr(C) - 3) + sum(push(ufl.dot(a, C * a) - 1, 2.36, 0.84) for a in (A1, A2))


def dispersed(F: Expr, c: float) -> Expr:
    """Gasser, Ogden, Holzapfel: fibres with a dispersed direction."""
    C, d = isochoric(F), 0.226
    E = [d * (ufl.tr(C) - 3) + (1 - 3 * d) * (ufl.dot(a, C * a) - 1) for a in (A1, A2)]
    return c / 2 * (ufl.tr(C) - 3) + sum(push(E_a, 2.36, 0.84) for E_a in E)


def active(F: Expr, c: float) -> Expr:
    """Holzapfel and Ogden's heart muscle with an active stress along its fibres."""
    C = isochoric(F)
    psi = c / 14.4 * (ufl.exp(7.2 * (ufl.tr(C) - 3)) - 1)
    psi += 0.032 * (ufl.exp(9.5 * ufl.dot(A1, C * A2) ** 2) - 1)
    psi += push(ufl.dot(A1, C * A1) - 1, 15.2, 20.4) + push(ufl.dot(A2, C * A2) - 1, 3.3, 11.2)
    return psi + 0.05 * (ufl.dot(F * A1, F * A1) - 1)


def viscous(F: Expr, c: float, mesh: dolfinx.mesh.Mesh) -> Expr:
    """The first one with three branches, each with the stress that it remembers."""
    space = dolfinx.fem.functionspace(mesh, ("DG", 0, (3, 3)))
    past = [dolfinx.fem.Function(space) for _ in range(3)]
    psi, C = hgo(F, c), isochoric(F)
    return psi + sum(0.1 * i * psi + ufl.inner(Q, C) / 2 for i, Q in enumerate(past, 1))


def isochoric(F: Expr) -> Expr:
    """C̄ = J^(−2/3) Fᵀ F."""
    return ufl.det(F) ** (-2.0 / 3.0) * F.T * F


MATERIALS = {
    "HGO": hgo,
    "HGO, dispersed": dispersed,
    "Holzapfel–Ogden, active": active,
    "viscoelastic": viscous,
    "three fields": hgo,
}


def problem_of(material: str, solver: str, mesh: dolfinx.mesh.Mesh) -> Callable[[], Solve]:
    """Return what makes a problem of an edited energy, and that what solves it from rest."""
    three = material == "three fields"
    P2 = basix.ufl.element("Lagrange", mesh.basix_cell(), 2, shape=(3,))
    P0 = basix.ufl.element("DG", mesh.basix_cell(), 0)
    mixed = three and solver == "dolfinx"
    W = dolfinx.fem.functionspace(mesh, basix.ufl.mixed_element([P2, P0, P0]) if mixed else P2)
    V = W.sub(0).collapse()[0] if mixed else W
    sides = dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[0], 0.0))
    if mixed:
        dofs = dolfinx.fem.locate_dofs_topological((W.sub(0), V), 2, sides)
        bc = dolfinx.fem.dirichletbc(dolfinx.fem.Function(V), dofs, W.sub(0))
    else:
        dofs = dolfinx.fem.locate_dofs_topological(W, 2, sides)
        bc = dolfinx.fem.dirichletbc(np.zeros(3), dofs, W)
    w = dolfinx.fem.Function(W)
    fields = [dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, P0)) for _ in range(2 * three)]
    load = dolfinx.fem.Constant(mesh, (0.005, 0.02, 0.0))

    def rest() -> None:
        w.x.array[:] = 0.0
        for f in fields:
            f.x.array[:] = 0.0
        if three:
            theta = w.sub(2) if mixed else fields[1]
            theta.interpolate(lambda x: np.ones(x.shape[1]))

    def edited() -> Solve:
        c = 3.0 + 1e-6 * random.random()
        u, *others = ufl.split(w) if mixed else (w, *fields)
        F = ufl.Identity(3) + ufl.grad(u)
        psi = viscous(F, c, mesh) if material == "viscoelastic" else MATERIALS[material](F, c)
        if three:
            p, theta = others
            psi += p * (ufl.det(F) - theta) + 50.0 * (theta - 1) ** 2
        else:
            psi += 50.0 * (ufl.det(F) - 1) ** 2
        energy = (psi - ufl.inner(load, u)) * ufl.dx(degree=4)
        unknowns = [w, *fields]
        forms = [ufl.derivative(energy, f, ufl.TestFunction(f.function_space)) for f in unknowns]
        rest()
        if solver == "dolfinx":
            return dolfinx_problem(forms[0], w, bc)
        return NonlinearProblem(
            energy if solver == "energy" else forms if three else forms[0],
            w,
            bcs=[bc],
            condense=fields or None,
            petsc_options={"snes_rtol": RTOL},
        ).solve

    def prepared() -> Solve:
        solve = edited()

        def solve_from_rest() -> object:
            rest()
            return solve()

        return solve_from_rest

    return prepared


def dolfinx_problem(F: ufl.Form, u: dolfinx.fem.Function, bc: dolfinx.fem.DirichletBC) -> Solve:
    """Return what solves dolfinx's own problem; its class is another one from 0.10 on."""
    options = {"snes_rtol": RTOL, "snes_linesearch_type": "none", **MUMPS}
    own = dolfinx.fem.petsc.NonlinearProblem
    if hasattr(dolfinx.fem.petsc, "NewtonSolverNonlinearProblem"):
        prefix = f"edit_{random.randrange(10**9)}_"
        return own(F, u, bcs=[bc], petsc_options_prefix=prefix, petsc_options=options).solve
    newton = dolfinx.nls.petsc.NewtonSolver(u.function_space.mesh.comm, own(F, u, [bc]))
    newton.rtol = RTOL
    newton.krylov_solver.setType("preonly")
    newton.krylov_solver.getPC().setType("lu")
    newton.krylov_solver.getPC().setFactorSolverType("mumps")
    return partial(newton.solve, u)


def seconds() -> float:
    """Return the time of this process and of the compilers that it has started."""
    return float(sum(os.times()[:4]))


def measure(material: str, edits: int) -> list[dict[str, object]]:
    """Let all three solve each edit in turn; the first one is not recorded."""
    mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_SELF, 5, 4, 8)
    routes = {name: problem_of(material, name, mesh) for name in ("dolfinx", "residual", "energy")}
    records: list[dict[str, object]] = []
    for edit in range(edits + 1):
        for name, prepare in routes.items():
            start, clock = seconds(), perf_counter()
            solve = prepare()
            solve()
            first, wall = seconds() - start, perf_counter() - clock
            start = seconds()
            solve()
            found = {"material": material, "given": name, "edit": edit, "first": first}
            if edit:
                records.append({**found, "wall": wall, "again": seconds() - start})
                print(", ".join(f"{k} {v}" for k, v in records[-1].items()), flush=True)
    return records


def draw(records: Sequence[dict[str, object]], path: Path) -> None:
    """Draw the seconds of each material, the least of all edits."""
    routes = {"dolfinx": "dolfinx and MUMPS", "residual": "residual", "energy": "energy"}
    colours = dict(zip(routes, COLOURS, strict=False))
    legend = {text: {"color": colours[name], "lw": 6} for name, text in routes.items()}
    names = list(dict.fromkeys(str(r["material"]) for r in records))
    with picture(path, 1, 2, legend) as axes:
        for ax, key, title in zip(
            axes[0], ("first", "again"), ("an edited energy", "once more"), strict=True
        ):
            for i, name in enumerate(routes):
                own = [r for r in records if r["given"] == name]
                least = [min(float(str(r[key])) for r in own if r["material"] == m) for m in names]
                ax.barh(np.arange(len(names)) + 0.27 * (i - 1), least, 0.25, color=colours[name])
            ax.set(yticks=range(len(names)), yticklabels=names, xlabel="CPU seconds", title=title)
            ax.invert_yaxis()


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser("edit", description=__doc__)
    parser.add_argument("--material", choices=MATERIALS, action="append", help="all if not given")
    parser.add_argument("--edits", type=int, default=2, help="2")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--figure", type=Path, metavar="FILE")
    args = parser.parse_args(argv)
    names = args.material or list(MATERIALS)
    records = [record for name in names for record in measure(name, args.edits)]
    if args.json:
        text = json.dumps({"machine": describe(), "records": records}, indent=1)
        args.json.write_text(text + "\n", encoding="utf-8")
    if args.figure:
        draw(records, args.figure)


if __name__ == "__main__":
    main()
