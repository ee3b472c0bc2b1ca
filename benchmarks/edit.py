# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Time from an edit of a material's energy to an equilibrium: compilation and solve.

    python3 -m benchmarks.edit --json build/edit.json

Each edit changes a number in the energy, so that no cache has its forms. Seconds are processor
time, including that of the C compiler. The body is a block of 960 tetrahedra (P2), clamped on one
side and pulled by a body force. It is solved twice for each edit, by this package and by dolfinx's
own problem with MUMPS. An edit that is not timed comes first: it compiles the code that all
energies share. The three-field energy has two more fields, which this package condenses; dolfinx
solves for them.
"""

from __future__ import annotations

import argparse
import itertools
import math
import os
import random
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

import basix.ufl
import dolfinx
import ufl

from benchmarks.common.bodies import create_zero_bc
from benchmarks.common.direct import create_newton
from benchmarks.common.pages import Fields, groups
from benchmarks.common.plots import COLOURS, picture
from benchmarks.common.records import Record
from benchmarks.common.study import Arguments, Keep, Study
from dolfinx_feti import NonlinearProblem, kinematics, materials
from dolfinx_feti.meshes.arguments import count

Expr = ufl.core.expr.Expr
Solve = Callable[[], object]

#: Relative tolerance of Newton's method, in both packages.
RTOL = 1e-8

#: By ``given`` of a record, what form the problem is given: name and colour in the picture.
ROUTES = {
    "dolfinx": ("dolfinx and MUMPS", COLOURS[0]),
    "residual": ("residual given", COLOURS[1]),
    "energy": ("energy given", COLOURS[2]),
}

#: Two directions of fibres.
FIBRES = [ufl.as_vector([0.88, sign * 0.475, 0.0]) for sign in (1.0, -1.0)]
#: Parameters of the fibres of arteries [kPa, -].
STIFFNESS = {"k1": 2.36, "k2": 0.84}
#: Parameters of heart muscle by Holzapfel and Ogden [kPa or -].
HEART = {"b": 7.2, "a_f": 15.2, "b_f": 20.4, "a_s": 3.3, "b_s": 11.2, "a_fs": 0.6, "b_fs": 9.5}


def hgo(C: Expr, J: Expr, c: float) -> Expr:
    """Return the energy of Holzapfel, Gasser, Ogden [kPa]."""
    return materials.holzapfel_gasser_ogden(C, *FIBRES, c=c, **STIFFNESS, J=J)


def dispersed(C: Expr, J: Expr, c: float) -> Expr:
    """Return the energy of Gasser, Ogden, Holzapfel, with dispersed fibres [kPa]."""
    return materials.gasser_ogden_holzapfel(C, *FIBRES, c=c, **STIFFNESS, dispersion=0.226, J=J)


def active(C: Expr, J: Expr, c: float) -> Expr:
    """Return the energy of heart muscle with an active stress along its fibres [kPa]."""
    psi = materials.holzapfel_ogden(C, *FIBRES, a=c, **HEART, J=J)
    return psi + materials.active_tension(C, FIBRES[0], tension=0.1)


def viscous(C: Expr, J: Expr, c: float) -> Expr:
    """Return the energy of Holzapfel, Gasser, Ogden with three viscoelastic branches [kPa].

    Each branch has the stress of the last time step as a coefficient.
    """
    (u,) = ufl.algorithms.extract_coefficients(C)
    psi = hgo(C, J, c)
    space = dolfinx.fem.functionspace(u.function_space.mesh, ("DG", 0, C.ufl_shape))
    last_stresses = [dolfinx.fem.Function(space) for _ in range(3)]
    return psi + sum(0.1 * i * psi + ufl.inner(Q, C) / 2 for i, Q in enumerate(last_stresses, 1))


#: Functions Ψ(C, J, c) by the name of the material on the page.
MATERIALS = {
    "HGO": hgo,
    "HGO, dispersed": dispersed,
    "Holzapfel–Ogden, active": active,
    "viscoelastic": viscous,
    "three fields": hgo,
}


def density(material: str, u: Expr, fields: Sequence[Expr]) -> Expr:
    """Return an edited energy [kPa]: its c differs from 3 kPa by a random number below 1e-6.

    Args:
        material: A key of :data:`MATERIALS`.
        u: Displacement.
        fields: p and θ of the three-field energy; none otherwise.
    """
    F = kinematics.deformation_gradient(u)
    C = kinematics.right_cauchy_green(F)
    J = kinematics.jacobian(F)
    psi = MATERIALS[material](C, J, 3.0 + 1e-6 * random.random())
    if fields:
        p, theta = fields
        return psi + p * (J - theta) + 50.0 * (theta - 1) ** 2
    return psi + 50.0 * (J - 1) ** 2


def problem_of(material: str, given: str, mesh: dolfinx.mesh.Mesh) -> Callable[[], Solve]:
    """Return a function that edits the energy and compiles its problem.

    That function returns another one, which solves from rest.

    Args:
        material: A key of :data:`MATERIALS`.
        given: A key of :data:`ROUTES`.
        mesh: The block.
    """
    has_three_fields = material == "three fields"
    P2 = basix.ufl.element("Lagrange", mesh.basix_cell(), 2, shape=(3,))
    P0 = basix.ufl.element("DG", mesh.basix_cell(), 0)
    is_mixed = has_three_fields and given == "dolfinx"
    W = dolfinx.fem.functionspace(mesh, basix.ufl.mixed_element([P2, P0, P0]) if is_mixed else P2)
    side = dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[0], 0.0))
    if is_mixed:
        V = W.sub(0).collapse()[0]
        dofs = dolfinx.fem.locate_dofs_topological((W.sub(0), V), 2, side)
        bc = dolfinx.fem.dirichletbc(dolfinx.fem.Function(V), dofs, W.sub(0))
    else:
        bc = create_zero_bc(W, None, side)
    w = dolfinx.fem.Function(W)
    Q = dolfinx.fem.functionspace(mesh, P0)
    number_of_condensed = 2 if has_three_fields and not is_mixed else 0  # p and θ
    fields = [dolfinx.fem.Function(Q) for _ in range(number_of_condensed)]
    load = dolfinx.fem.Constant(mesh, (0.005, 0.02, 0.0))

    def set_to_rest() -> None:
        for f in (w, *fields):
            f.x.array[:] = 0.0
        if has_three_fields:
            theta = w.sub(2) if is_mixed else fields[1]
            theta.interpolate(lambda x: np.ones(x.shape[1]))

    def edit_and_compile() -> Solve:
        set_to_rest()
        u, *others = ufl.split(w) if is_mixed else (w, *fields)
        energy = (density(material, u, others) - ufl.inner(load, u)) * ufl.dx(degree=4)
        forms = [
            ufl.derivative(energy, f, ufl.TestFunction(f.function_space)) for f in (w, *fields)
        ]
        if given == "dolfinx":
            solve = create_newton(forms[0], w, [bc], rtol=RTOL)
        else:
            if given == "energy":
                F = energy
            elif has_three_fields:
                F = forms
            else:
                F = forms[0]
            settings = {"condense": fields or None, "petsc_options": {"snes_rtol": RTOL}}
            solve = NonlinearProblem(F, w, bcs=[bc], **settings).solve

        def solve_from_rest() -> object:
            set_to_rest()
            return solve()

        return solve_from_rest

    return edit_and_compile


def seconds() -> float:
    """Return the processor time of this process and of the compilers that it has started."""
    return float(sum(os.times()[:4]))


def _run(case: Record, keep: Keep, args: Arguments, _: MPI.Comm) -> None:
    """Solve twice for each edit, after an edit that is not timed; see the module."""
    mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_SELF, 5, 4, 8)
    edit_and_compile = problem_of(case["material"], case["given"], mesh)
    if case["given"] != "dolfinx":
        solve = edit_and_compile()
        solve()
    for edit in range(1, args.edits + 1):
        start = seconds()
        solve = edit_and_compile()
        solve()
        first = seconds() - start
        solve()
        keep({"edit": edit}, {"first": first, "again": seconds() - start - first})


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--material", choices=MATERIALS, action="append", help="all if not given")
    parser.add_argument("--edits", type=count, default=1, help="1")


def _cases(args: Arguments, *_: object) -> Iterator[Record]:
    for material, given in itertools.product(args.material or MATERIALS, ROUTES):
        yield {"material": material, "given": given}


def _rows(records: Sequence[Record]) -> list[dict[str, Any]]:
    """Return a row for each material: the least seconds of all edits, and their quotients."""
    rows = []
    for (material,), of_material in groups(records, "material"):
        row: dict[str, Any] = {"material": material, "sources": of_material}
        for (given,), of_route in groups(of_material, "given"):
            for name in ("first", "again"):
                least = min(record[name] for record in of_route)
                row[f"{given}_{name}"] = least
                row[f"{given}_{name}_ratio"] = least / row.get(f"dolfinx_{name}", math.nan)
        rows.append(row)
    return rows


def _fields(records: Sequence[Record]) -> Fields:
    """Return the rows, and the least and greatest quotients of all materials."""
    rows = _rows(records)
    fields: dict[str, Any] = {"rows": rows, "edits": max(record["edit"] for record in records)}
    for name in ("first", "again"):
        keys = [f"{given}_{name}_ratio" for given in ("residual", "energy")]
        ratios = [row[key] for row in rows for key in keys if key in row] or [math.nan]
        fields |= {f"{name}_least": min(ratios), f"{name}_most": max(ratios)}
    return fields


def _draw(records: Sequence[Record], folder: Path) -> list[Fields]:
    """Draw the seconds of each material."""
    rows = _rows(records)
    legend = {name: {"color": colour, "lw": 6} for name, colour in ROUTES.values()}
    with picture(folder / "edit.png", 1, 2, legend) as axes:
        titles = {"first": "an edited energy", "again": "once more"}
        for ax, (name, title) in zip(axes[0], titles.items(), strict=True):
            for i, (given, (_, colour)) in enumerate(ROUTES.items()):
                places = np.arange(len(rows)) + 0.27 * (i - 1)
                seconds_of_rows = [row.get(f"{given}_{name}", math.nan) for row in rows]
                ax.barh(places, seconds_of_rows, 0.25, color=colour)
            names = [row["material"] for row in rows]
            ax.set(yticks=range(len(rows)), yticklabels=names, xlabel="CPU seconds", title=title)
            ax.invert_yaxis()
    return [{"picture": "edit.png"}]


def _is_known(record: Record) -> bool:
    """Return True if a record is one of this study."""
    return record.get("given") in ROUTES and record.get("material") in MATERIALS


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="edit",
    known=_is_known,
    options=_options,
    cases=_cases,
    run=_run,
    fields=_fields,
    draw=_draw,
)

if __name__ == "__main__":
    STUDY.main()
