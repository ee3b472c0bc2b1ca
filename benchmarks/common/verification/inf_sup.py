# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The inf-sup constants of pairs of elements on refined cubes.

The constant of a pair on the unit cube, with u = 0 on the whole boundary, is β > 0 in

    min over q of  max over v of  ∫ q div v / (‖∇v‖ ‖q‖) = β,

over the q without a mean. β² is the least eigenvalue of B A⁻¹ Bᵀ q = β² M q with the stiffness A
of v, the mass M of q and the coupling B. A pair locks or oscillates if its β decreases as the cells
get smaller. A pressure q ≠ 0 without a mean is *spurious* if ∫ q div v = 0 for all v; such
pressures are counted. One process computes.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg

import basix.ufl
import dolfinx
import dolfinx.fem.petsc
import ufl

from benchmarks.common import command
from benchmarks.common.pages import Fields, groups
from benchmarks.common.records import Record
from benchmarks.common.study import Arguments, Keep
from benchmarks.common.verification.part import Part
from dolfinx_feti.fem.elements import quadratic_with_bubbles
from dolfinx_feti.meshes.arguments import count
from dolfinx_feti.runtime.collective import on_root

#: Eigenvalues β² below this one are zero to rounding: their pressures are spurious. All others on
#: record are larger than 1e-3.
ZERO_EIGENVALUE = 1e-10


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """A pair of elements.

    Args:
        name: Name on the page.
        pressure: Family and degree of q.
        cell: Type of the cells.
        degree: Degree of each component of v.
        bubbles: Bubbles that v has in addition to degree 2: ``none``, of ``cells``, or of cells and
            ``faces``.
    """

    name: str
    pressure: tuple[str, int]
    cell: str = "tetrahedron"
    degree: int = 2
    bubbles: str = "none"

    @property
    def displacement(self) -> basix.ufl._ElementBase:
        """Element of each component of v."""
        if self.bubbles == "none":
            return basix.ufl.element("Lagrange", self.cell, self.degree)
        return quadratic_with_bubbles(self.cell, faces=self.bubbles == "faces")


#: Pairs by their key in a record, in the order of the page.
PAIRS = {
    "p1-p0": Pair(name="P1–P0", degree=1, pressure=("DG", 0)),
    "p2-p0": Pair(name="P2–P0", pressure=("DG", 0)),
    "p2-p1d": Pair(name="P2–P1disc", pressure=("DG", 1)),
    "p2c-p1d": Pair(name="P2 with bubbles of cells–P1disc", bubbles="cells", pressure=("DG", 1)),
    "p2b-p1d": Pair(
        name="P2 with bubbles of cells and faces–P1disc", bubbles="faces", pressure=("DG", 1)
    ),
    "q1-p0": Pair(name="Q1–P0", cell="hexahedron", degree=1, pressure=("DG", 0)),
    "q2-p1d": Pair(name="Q2–P1disc", cell="hexahedron", pressure=("DPC", 1)),
    "p2-p1": Pair(name="P2–P1, Taylor–Hood", pressure=("Lagrange", 1)),
}


def _options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this part."""
    add = parser.add_argument
    command.add_choices(parser, "--pair", list(PAIRS))
    add("--cells", type=command.several(count), default=[2, 3, 4], help="along an edge; 2,3,4")


def _cases(args: Arguments, _comm: MPI.Comm) -> Iterator[Record]:
    """Yield the pairs on all meshes."""
    for pair, cells in itertools.product(args.pair, args.cells):
        yield {"pair": pair, "cells": cells}


def _run(case: Record, keep: Keep, _args: Arguments, comm: MPI.Comm) -> None:
    """Compute a constant on the first process."""
    keep({}, on_root(lambda: inf_sup_constant(case["pair"], case["cells"]), comm))


def _fields(records: Sequence[Record]) -> Fields:
    """Return a row for each pair, in their order."""
    rows = {}
    for (pair,), of_pair in groups(records, "pair"):
        rows[pair] = {
            "name": PAIRS[pair].name,
            "most": max(record["spurious"] for record in of_pair),
            "at": {record["cells"]: f"{record['beta']:.3f}" for record in of_pair},
            "sources": of_pair,
        }
    return {"pairs": [rows[pair] for pair in PAIRS if pair in rows]}


def inf_sup_constant(pair: str, cells: int) -> Record:
    """Compute β of a pair on the unit cube; spurious pressures do not count.

    Args:
        pair: A key of :data:`PAIRS`.
        cells: Bricks along an edge, each of six tetrahedra or one hexahedron.
    """
    elements = PAIRS[pair]
    cell = getattr(dolfinx.mesh.CellType, elements.cell)
    mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_SELF, cells, cells, cells, cell_type=cell)
    V = dolfinx.fem.functionspace(
        mesh, basix.ufl.blocked_element(elements.displacement, shape=(3,))
    )
    Q = dolfinx.fem.functionspace(mesh, elements.pressure)
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    p = ufl.TrialFunction(Q)
    q = ufl.TestFunction(Q)
    forms = ufl.inner(ufl.grad(u), ufl.grad(v)), q * ufl.div(u), p * q
    A, B, M = (_assembled(form * ufl.dx) for form in forms)
    mesh.topology.create_connectivity(2, 3)
    boundary = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    fixed = dolfinx.fem.locate_dofs_topological(V, 2, boundary)
    free = np.setdiff1d(np.arange(A.shape[0]), (3 * fixed[:, None] + np.arange(3)).ravel())
    factor = scipy.sparse.linalg.splu(A[free][:, free].tocsc())
    coupling = B[:, free].toarray()
    S = coupling @ factor.solve(coupling.T)  # B A⁻¹ Bᵀ
    λ = scipy.linalg.eigh((S + S.T) / 2, M.toarray(), eigvals_only=True)
    nonzero = λ[λ > ZERO_EIGENVALUE]
    return {
        "beta": float(np.sqrt(nonzero[0])),
        "spurious": len(λ)
        - len(nonzero)
        - 1,  # without the constant pressure, whose mean is not zero
        "displacements": len(free),
        "pressures": len(λ),
    }


def _assembled(form: ufl.Form) -> scipy.sparse.csr_array:
    """Return the matrix of a bilinear form on one process."""
    M = dolfinx.fem.petsc.assemble_matrix(dolfinx.fem.form(form))
    M.assemble()
    K = scipy.sparse.csr_array(M.getValuesCSR()[::-1], shape=M.getSize())
    M.destroy()
    return K


INF_SUP = Part(key="pair", values=PAIRS, options=_options, cases=_cases, run=_run, fields=_fields)
