# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What an edit of a material costs: an equilibrium, kernels, a check and a fit.

    python3 -m benchmarks.edit --json build/edit.json

Each edit changes a number in the energy, so that no cache has its forms. Seconds are those of the
processor, with the C compiler. *Equilibria*: a block of 960 tetrahedra (P2) is clamped on one side
and pulled by a body force, beside dolfinx's own problem with MUMPS, and solved once more; an edit
before compiles what all energies share. The two fields of the three-field energy are condensed;
dolfinx solves for them. *Kernels*: residual and tangent on other elements, beside dolfinx's
compiled forms. *Steps*: the workshop's check and fit.
"""

from __future__ import annotations

import os
import random
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

import basix.ufl
import dolfinx
import dolfinx.fem.petsc
import dolfinx.nls.petsc
import ufl

from benchmarks.common.pages import Fields, groups
from benchmarks.common.plots import COLOURS, picture
from benchmarks.common.records import Record
from benchmarks.common.study import Keep, Study
from dolfinx_feti import NonlinearProblem
from dolfinx_feti.fem.assembly import split_form
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.workshop import DataSet, check, compile_material, fit, respond, uniaxial
from meshes.arguments import count

__all__ = ["STUDY"]

Expr = ufl.core.expr.Expr
Solve = Callable[[], object]

#: PETSc's options for a direct solver.
MUMPS = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}

RTOL = 1e-8

#: What is given, its name in the picture, and its colour.
ROUTES = {
    "dolfinx": ("dolfinx and MUMPS", COLOURS[0]),
    "residual": ("residual given", COLOURS[1]),
    "energy": ("energy given", COLOURS[2]),
}


#: Elements of the kernels: cell, degree, degree of the quadrature.
ELEMENTS = {
    "P1, 2D": ("triangle", 1, 1),
    "P2, 2D": ("triangle", 2, 4),
    "Q2, 2D": ("quadrilateral", 2, 4),
    "P1, 3D": ("tetrahedron", 1, 1),
    "P2, 3D": ("tetrahedron", 2, 4),
    "Q2, 3D": ("hexahedron", 2, 4),
}


def fibres(F: Expr) -> tuple[Expr, Expr]:
    """Two directions, in two or three dimensions."""
    d = F.ufl_shape[0]
    a, b = (ufl.as_vector([0.88, s * 0.475, 0.0][:d]) for s in (1.0, -1.0))
    return a, b


def push(E: Expr, k1: float, k2: float) -> Expr:
    """The energy of fibres that do not push [kPa]."""
    return ufl.conditional(ufl.gt(E, 0.0), k1 / (2 * k2) * (ufl.exp(k2 * E**2) - 1), 0.0)


def hgo(F: Expr, c: float) -> Expr:
    """Holzapfel, Gasser, Ogden."""
    C = isochoric(F)
    return c / 2 * (ufl.tr(C) - 3) + sum(push(ufl.dot(a, C * a) - 1, 2.36, 0.84) for a in fibres(F))


def dispersed(F: Expr, c: float) -> Expr:
    """Gasser, Ogden, Holzapfel: fibres with a dispersed direction."""
    C, d = isochoric(F), 0.226
    E = [d * (ufl.tr(C) - 3) + (1 - 3 * d) * (ufl.dot(a, C * a) - 1) for a in fibres(F)]
    return c / 2 * (ufl.tr(C) - 3) + sum(push(E_a, 2.36, 0.84) for E_a in E)


def active(F: Expr, c: float) -> Expr:
    """Holzapfel and Ogden's heart muscle with an active stress along its fibres."""
    C, (a, b) = isochoric(F), fibres(F)
    psi = c / 14.4 * (ufl.exp(7.2 * (ufl.tr(C) - 3)) - 1)
    psi += 0.032 * (ufl.exp(9.5 * ufl.dot(a, C * b) ** 2) - 1)
    psi += push(ufl.dot(a, C * a) - 1, 15.2, 20.4) + push(ufl.dot(b, C * b) - 1, 3.3, 11.2)
    return psi + 0.05 * (ufl.dot(F * a, F * a) - 1)


def viscous(F: Expr, c: float, mesh: dolfinx.mesh.Mesh) -> Expr:
    """The first one with three branches, each with the stress that it remembers."""
    space = dolfinx.fem.functionspace(mesh, ("DG", 0, F.ufl_shape))
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


def density(material: str, mesh: dolfinx.mesh.Mesh, u: Expr, fields: Sequence[Expr]) -> Expr:
    """Return an edited energy of u and, with three fields, of p and θ."""
    F, c = ufl.Identity(len(u)) + ufl.grad(u), 3.0 + 1e-6 * random.random()
    psi = viscous(F, c, mesh) if material == "viscoelastic" else MATERIALS[material](F, c)
    if fields:
        p, theta = fields
        return psi + p * (ufl.det(F) - theta) + 50.0 * (theta - 1) ** 2
    return psi + 50.0 * (ufl.det(F) - 1) ** 2


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
        u, *others = ufl.split(w) if mixed else (w, *fields)
        psi = density(material, mesh, u, others)
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


def equilibria(case: Record, keep: Keep, edits: int) -> None:
    """Solve each edit, and once more; ours has had one before, for what all energies share."""
    mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_SELF, 5, 4, 8)
    given = str(case["given"])
    prepare = problem_of(str(case["material"]), given, mesh)
    if given != "dolfinx":
        prepare()()
    for edit in range(1, edits + 1):
        start = seconds()
        solve = prepare()
        solve()
        first = seconds() - start
        solve()
        keep({"edit": edit}, {"first": first, "again": seconds() - start - first})


def kernels(case: Record, keep: Keep) -> None:
    """Let both make the residual and the tangent of an edit; ours has had one before."""
    material = str(case["material"])
    cell, degree, quadrature = ELEMENTS[str(case["element"])]
    kind = getattr(dolfinx.mesh.CellType, cell)
    if cell in ("triangle", "quadrilateral"):
        mesh = dolfinx.mesh.create_unit_square(MPI.COMM_SELF, 2, 2, kind)
    else:
        mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_SELF, 2, 2, 2, kind)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (mesh.geometry.dim,)))
    Q = dolfinx.fem.functionspace(mesh, ("DG", 0))
    u, compiler = dolfinx.fem.Function(V), Compiler(MPI.COMM_SELF)
    fields = [dolfinx.fem.Function(Q) for _ in range(2 * (material == "three fields"))]

    def edited() -> list[ufl.Form]:
        psi = density(material, mesh, u, fields) * ufl.dx(degree=quadrature)
        F = ufl.derivative(psi, u)
        return [F, ufl.derivative(F, u)]

    for form in edited():
        split_form(form, mesh, compiler)
    forms, start = edited(), seconds()
    parts = [split_form(form, mesh, compiler) for form in forms]
    own = seconds() - start
    tapes = [tape for part in parts for k in part.kernels for tape in k.generated.tapes]
    forms, start = edited(), seconds()
    dolfinx.fem.form(forms)
    found = {"kernels": own, "numbers": sum(map(len, tapes)), "dolfinx": seconds() - start}
    keep({}, found)


def step(case: Record, keep: Keep) -> None:
    """Take a step of the workshop with an edited energy."""
    c0 = 3.0 + 1e-6 * random.random()

    def psi(F: Expr, c: Expr | float) -> Expr:
        return hgo(F, c) + 1e-9 * c0 * (ufl.det(F) - 1) ** 2

    stretch = np.linspace(1.0, 1.3, 20)
    if case["step"] == "check":
        start = seconds()
        check(compile_material(partial(psi, c=c0)))
    else:
        sigma = respond(compile_material(psi, parameters={"c": 3.0}), uniaxial(stretch)).sigma
        data = [DataSet(uniaxial(stretch), sigma[:, 0, 0], measure="cauchy")]
        c0 += 1e-6
        start = seconds()
        fit(psi, data, start={"c": 1.0})
    keep({}, {"took": seconds() - start})


def _cases(args: Any, *_: object) -> Iterator[Record]:
    materials = args.material or list(MATERIALS)
    yield from ({"material": m, "given": given} for m in materials for given in ROUTES)
    yield from ({"material": m, "element": e} for m in materials for e in ELEMENTS)
    yield from ({"step": name} for name in ("check", "fit"))


def _run(case: Record, keep: Keep, args: Any, _: MPI.Comm) -> None:
    if "given" in case:
        equilibria(case, keep, args.edits)
    elif "element" in case:
        kernels(case, keep)
    else:
        step(case, keep)


def _options(parser: Any) -> None:
    parser.add_argument("--material", choices=MATERIALS, action="append", help="all if not given")
    parser.add_argument("--edits", type=count, default=1, help="1")


def _line(record: Record) -> str:
    known = ("material", "given", "element", "step", "first", "again", "kernels", "dolfinx", "took")
    return ", ".join(f"{name} {record[name]}" for name in known if name in record)


def _equilibria(records: Sequence[Record]) -> list[dict[str, Any]]:
    """Return a row for each material: the least seconds of all edits, and their quotients."""
    rows = []
    for (material,), mine in groups((r for r in records if "first" in r), "material"):
        row: dict[str, Any] = {"material": material}
        for (given,), same in groups(mine, "given"):
            for name in ("first", "again"):
                row[f"{given}_{name}"] = min(float(str(r[name])) for r in same)
        for given in ("residual", "energy"):
            for name in ("first", "again"):
                row[f"{given}_{name}_ratio"] = row[f"{given}_{name}"] / row[f"dolfinx_{name}"]
        rows.append(row)
    return rows


def _fields(records: Sequence[Record]) -> Fields:
    """Return a row for each material, for each of its kernels, and for each step."""
    kernels = [
        r | {"ratio": float(str(r["kernels"])) / float(str(r["dolfinx"]))}
        for r in _kernels(records)
    ]
    steps = {r["step"]: r["took"] for r in records if "step" in r}
    return {"rows": _equilibria(records), "kernels": kernels, "steps": [steps] * bool(steps)}


def _kernels(records: Sequence[Record]) -> list[Record]:
    return [r for r in records if "kernels" in r]


def _draw(records: Sequence[Record], folder: Path) -> list[Fields]:
    """Draw the seconds of each material, and of kernels over the length of their tapes."""
    rows, legend = _equilibria(records), {n: {"color": c, "lw": 6} for n, c in ROUTES.values()}
    with picture(folder / "edit.png", 1, 3, legend) as axes:
        titles = {"first": "an edited energy", "again": "once more"}
        for ax, (name, title) in zip(axes[0], titles.items(), strict=False):
            for i, (given, (_, colour)) in enumerate(ROUTES.items()):
                at = np.arange(len(rows)) + 0.27 * (i - 1)
                ax.barh(at, [row[f"{given}_{name}"] for row in rows], 0.25, color=colour)
            names = [row["material"] for row in rows]
            ax.set(yticks=range(len(rows)), yticklabels=names, xlabel="CPU seconds", title=title)
            ax.invert_yaxis()
        ax = axes[0, 2]
        for name, colour in (("dolfinx", COLOURS[0]), ("kernels", COLOURS[1])):
            points = [(r["numbers"], r[name]) for r in _kernels(records)]
            ax.plot(*zip(*points, strict=True), "o", color=colour) if points else None
        ax.set(xscale="log", yscale="log", xlabel="numbers on the tapes")
        ax.set_title("kernels [CPU seconds]")
    return [{"picture": "edit.png"}]


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="edit",
    known=lambda r: "step" in r or "kernels" in r or r.get("given") in ROUTES,
    options=_options,
    cases=_cases,
    run=_run,
    line=_line,
    fields=_fields,
    draw=_draw,
)

if __name__ == "__main__":
    STUDY.main()
