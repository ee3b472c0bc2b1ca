# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The cell kernels of this package compared with FFCx's: assembly and compilation.

    python3 -m benchmarks.cell_kernels --json build/cell_kernels.json

A quarter of a tube of some 20 000 dofs of u, of one material with two families of fibres and a
condensed pressure, on one process with one thread. FFCx's code is compiled twice: with dolfinx's
flags, and with ``-O3 -march=native``, which the package's code has.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl

from benchmarks.common.pages import Fields, groups
from benchmarks.common.records import Record
from benchmarks.common.study import Arguments, Keep, Study
from dolfinx_feti import kinematics, materials
from dolfinx_feti.fem.assembly import assemble, assemble_vector, create_local_matrix, integrate
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.condensation.cellwise_forms import CellwiseForms
from dolfinx_feti.fem.decomposition import decompose, tear
from dolfinx_feti.fem.split_form import split_form, split_torn_form
from dolfinx_feti.meshes.arguments import count

#: Flags of the C compiler for FFCx's code besides dolfinx's; None for the package's kernels.
CODES: dict[str, list[str] | None] = {
    "kernels": None,
    "FFCx": [],
    "FFCx -O3": ["-O3", "-march=native", "-g0"],
}

#: Forms that are timed.
FORMS = ("tangent", "residual", "energy", "blocks")

#: Subdomains, of some 2000 dofs each.
SUBDOMAINS = 10


@dataclass(frozen=True, slots=True)
class Discretisation:
    """Elements of u and p, and the mesh of the tube.

    Attributes:
        cell: Type of the cells.
        degree: Of the displacement.
        pressure: Element of the pressure.
        cells: Cells through, around and along the wall.
    """

    cell: dolfinx.mesh.CellType
    degree: int
    pressure: tuple[str, int]
    cells: tuple[int, int, int]


#: Discretisations by the name of their elements.
ELEMENTS = {
    "P1–P0": Discretisation(dolfinx.mesh.CellType.tetrahedron, 1, ("DG", 0), (6, 30, 30)),
    "P2–P0": Discretisation(dolfinx.mesh.CellType.tetrahedron, 2, ("DG", 0), (3, 12, 20)),
    "Q2–P1": Discretisation(dolfinx.mesh.CellType.hexahedron, 2, ("DPC", 1), (3, 12, 20)),
}


@dataclass(frozen=True, slots=True)
class ArteryForms:
    """The forms of the body.

    Attributes:
        u: Displacement.
        energy: Π(u, p).
        residual: ∂Π/∂u.
        tangent: ∂²Π/∂u².
        blocks: K_up, K_pu, K_pp and r_p.
    """

    u: dolfinx.fem.Function
    energy: ufl.Form
    residual: ufl.Form
    tangent: ufl.Form
    blocks: list[ufl.Form]


def create_tube_mesh(element: Discretisation) -> dolfinx.mesh.Mesh:
    """Create a quarter of a tube: radii 1 and 1.3 mm, length 3 mm."""
    mesh = dolfinx.mesh.create_box(
        MPI.COMM_SELF, [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]], list(element.cells), element.cell
    )
    through, around, along = mesh.geometry.x.T.copy()
    radius = 1.0 + 0.3 * through
    angle = 0.5 * np.pi * around
    mesh.geometry.x[:, 0] = radius * np.cos(angle)
    mesh.geometry.x[:, 1] = radius * np.sin(angle)
    mesh.geometry.x[:, 2] = 3.0 * along
    return mesh


def create_forms(element: Discretisation) -> ArteryForms:
    """Create the forms at a state in which no strain vanishes."""
    mesh = create_tube_mesh(element)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", element.degree, (3,)))
    u = dolfinx.fem.Function(V)
    u.interpolate(lambda x: 0.02 * np.stack([x[1], x[0] * x[2], x[2]]))
    p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element.pressure))
    vectors = dolfinx.fem.functionspace(mesh, ("DG", 0, (3,)))
    fibres = []
    for sign in (1.0, -1.0):
        a = dolfinx.fem.Function(vectors)
        a.x.array.reshape(-1, 3)[:] = (0.6, 0.0, 0.8 * sign)
        fibres.append(a)
    C = kinematics.right_cauchy_green(kinematics.deformation_gradient(u))
    J = kinematics.jacobian(kinematics.deformation_gradient(u))
    psi = materials.holzapfel_gasser_ogden(C, *fibres, c=3.0, k1=2.3, k2=0.8, J=J)
    dx = ufl.dx(metadata={"quadrature_degree": 2 * element.degree})
    energy = (psi + p * (J - 1) - p**2 / 2000) * dx
    F_u = ufl.derivative(energy, u)
    F_p = ufl.derivative(energy, p)
    blocks = [ufl.derivative(F_u, p), ufl.derivative(F_p, u), ufl.derivative(F_p, p), F_p]
    return ArteryForms(u, energy, F_u, ufl.derivative(F_u, u), blocks)


def shortest(work: Callable[[], object], rounds: int) -> float:
    """Return the shortest CPU time of several rounds [s]."""
    seconds = np.inf
    for _ in range(rounds):
        start = time.process_time()
        work()
        seconds = min(seconds, time.process_time() - start)
    return seconds


def _run(case: Record, keep: Keep, args: Arguments, _: MPI.Comm) -> None:
    """Compile the forms with an empty cache, assemble them, and keep the seconds of both."""
    artery = create_forms(ELEMENTS[case["element"]])
    V = artery.u.function_space
    flags = CODES[case["code"]]
    jit_options: dict[str, object] = {}
    if flags:
        jit_options["cffi_extra_compile_args"] = flags
    with tempfile.TemporaryDirectory() as cache:
        if flags is not None:
            jit_options["cache_dir"] = cache
        compiler = Compiler(MPI.COMM_SELF, None, jit_options, allow_kernels=flags is None)
        space = tear(V, decompose(V.mesh, SUBDOMAINS))
        K = create_local_matrix(space, compiler)
        start = time.perf_counter()
        tangent = split_torn_form(artery.tangent, space, compiler)
        residual = split_form(artery.residual, V.mesh, compiler)
        energy = split_form(artery.energy, V.mesh, compiler)
        blocks = CellwiseForms(artery.blocks, V.mesh, compiler)
        seconds_compile = time.perf_counter() - start
        values: Record = {
            "dofs": V.dofmap.index_map.size_global * V.dofmap.index_map_bs,
            "seconds_compile": seconds_compile,
            "seconds_tangent": shortest(lambda: assemble(K, tangent), args.rounds),
            "seconds_residual": shortest(lambda: assemble_vector(residual, V), args.rounds),
            "seconds_energy": shortest(lambda: integrate(energy), args.rounds),
            "seconds_blocks": shortest(blocks.assemble, args.rounds),
            "norm_K": float(np.linalg.norm(np.asarray(K.csr.data, dtype=np.float64))),
        }
        K.mat.destroy()
    keep({}, values)


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--rounds", type=count, default=10, help="10, of which the shortest counts")


def _cases(*_: object) -> Iterator[Record]:
    for element in ELEMENTS:
        for code in CODES:
            yield {"element": element, "code": code}


def _fields(records: Sequence[Record]) -> Fields:
    """Return a row for each element and code, with the quotients of the codes and the kernels."""
    rows: list[Record] = []
    gains: dict[str, list[float]] = {name: [] for name in ("compile", *FORMS)}
    for (element,), of_element in groups(records, "element"):
        by_code = {record["code"]: record for record in of_element}
        if set(by_code) != set(CODES):
            continue
        for code in CODES:
            record = by_code[code]
            row = {"element": element, "code": code, "dofs": record["dofs"], "sources": [record]}
            row["compile_s"] = record["seconds_compile"]
            row |= {f"{name}_ms": 1e3 * record[f"seconds_{name}"] for name in FORMS}
            rows.append(row)
        for name, of_name in gains.items():
            key = f"seconds_{name}"
            fastest = min(by_code[code][key] for code in ("FFCx", "FFCx -O3"))
            of_name.append(fastest / by_code["kernels"][key])
    ranges: dict[str, float] = {}
    for name, of_name in gains.items():
        ranges[f"{name}_least"] = min(of_name, default=math.nan)
        ranges[f"{name}_greatest"] = max(of_name, default=math.nan)
    return {"rows": rows, **ranges}


def _is_known(record: Record) -> bool:
    """Return True if a record is one of this study."""
    return record.get("code") in CODES and record.get("element") in ELEMENTS


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="cell_kernels",
    known=_is_known,
    options=_options,
    cases=_cases,
    run=_run,
    fields=_fields,
)

if __name__ == "__main__":
    STUDY.main()
