# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's first load step of a wall, with the paper's choices or with the package's.

It is that of the paper's section *Arterial model on a realistic mesh geometry*. The first Newton
step has the tangent of the wall at rest, since every load step of the package begins with the
tangent of the last equilibrium.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import dolfinx

from benchmarks.common.bodies import Body
from benchmarks.common.records import Record
from benchmarks.common.walls.problem import create_wall_problem
from dolfinx_feti import ConvergenceError
from dolfinx_feti.fem.decomposition import decompose
from dolfinx_feti.runtime.arrays import Indices
from dolfinx_feti.wall import Wall, facets, openings
from dolfinx_feti.wall.fibres import ANGLES, fibre_families, fibre_frame

#: Keys of cases, and their names on pages.
TYPES = {"all_floating": "all-floating", "classical": "classical"}
PRECONDITIONERS = ("identity", "lumped", "dirichlet")
CHOICES = {"paper": "the paper's choices", "default": "the package's defaults"}

#: Walls by layers: with the fibres of the media everywhere, the paper's aorta, or with media and
#: adventitia, its carotid artery.
LAYERS = {1: "one layer", 2: "two layers"}
ARTERIES = {1: "aorta", 2: "carotid artery"}

#: How one subdomain touches the clamped rim: as in the decomposition, in POINTS points, not at all.
CONTACTS = ("whole", "few", "none")
POINTS = 3

#: Tangent of the follower pressure. The paper leaves it out: then CG solves all systems, but on a
#: thin wall Newton's method comes only slowly to the solution.
TANGENTS = {"paper": "none", "default": "symmetric"}

#: PETSc options of the paper's choices; the package's choices are its defaults. The absolute
#: tolerances are norms of the residual of the assembled system [mN].
OPTIONS: dict[str, Record] = {
    "paper": {
        "feti_scaling": "multiplicity",
        "feti_coarse_q": "identity",
        "feti_coarse_modes": 0,
        "feti_formulation": "dual",
        "feti_dual_ksp_type": "cg",
        "ksp_rtol": 1e-12,
        "ksp_atol": 1e-8,
        "snes_rtol": 1e-14,
        "snes_atol": 1e-6,
    },
    "default": {},
}


def create(wall: Wall, case: Record, subdomains: int | Indices, options: Record) -> Body:
    """Create the problem of a wall at rest. Collective.

    Args:
        wall: Mesh and tags.
        case: Has ``layers``, ``degree``, ``kappa`` [kPa] and ``choices``.
        subdomains: Their number, or a part for each owned cell.
        options: PETSc options without prefix, in addition to those of the choices.
    """
    angles = ANGLES if case["layers"] == 2 else dict.fromkeys(ANGLES, ANGLES["media"])
    return create_wall_problem(
        wall,
        degree=case["degree"],
        kappa=case["kappa"],
        subdomains=subdomains,
        petsc_options=OPTIONS[case["choices"]] | options,
        fibres=fibre_families(wall, fibre_frame(wall), angles),
        use_pressure_potential=False,
        tangent=TANGENTS[case["choices"]],
    )


def sizes(body: Body) -> Record:
    """Return the sizes of the problem of a wall, and its formulation once it is set up."""
    report = body.problem.solver.getKSP().getPythonContext().report()
    names = ("multipliers", "coarse_size", "formulation")
    known = {} if report is None else {"subdomains_in_all": report.subdomains}
    return {"dofs": body.dofs} | known | {n: getattr(report, n) for n in names if known}


def load(body: Body, mmhg: float, *, allow_max_steps: bool) -> None:
    """Load a wall at rest. Collective.

    Args:
        body: The wall.
        mmhg: Pressure [mmHg].
        allow_max_steps: Whether Newton's method may end at its largest number of steps
            (``snes_max_it``) without an error.

    Raises:
        ConvergenceError: Newton's method failed.
    """
    at_rest = body.problem.linearise()
    body.set_load(mmhg)
    try:
        body.problem.solve(first_tangent=at_rest)
    except ConvergenceError:
        too_many = PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT
        if not allow_max_steps or body.problem.solver.getConvergedReason() != too_many:
            raise


def partition(wall: Wall, subdomains: int, contact: str) -> Indices:
    """Return a part for each owned cell, (n_cells,). Collective.

    The paper: "It may happen that the decomposition of a mesh results in subdomains that have only
    a few points on the Dirichlet boundary". In classical FETI such a subdomain is barely supported,
    and has no kernel for the coarse problem. Here one subdomain on a rim loses its cells at the
    rim: all of them (``none``), or all but a few that touch it in three points (``few``).

    Args:
        wall: Mesh and tags.
        subdomains: Their number, before cells are cut off.
        contact: One of :data:`CONTACTS`.

    Raises:
        ValueError: No subdomain touches a rim in three points and has most of its cells elsewhere.
    """
    mesh = wall.mesh
    part = decompose(mesh, subdomains).subdomain
    if contact == "whole":
        return part
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    cells = V.dofmap.list[: len(part)]
    rims = np.concatenate([facets(wall, name) for name in openings(wall)])
    is_on_rim = np.isin(cells, dolfinx.fem.locate_dofs_topological(V, 2, rims))  # (n_cells, 4)
    touches_rim = is_on_rim.any(axis=1)
    has_one_vertex = is_on_rim.sum(axis=1) == 1
    vertex = np.where(is_on_rim, cells, -1).max(axis=1, initial=-1)  # on the rim, or −1
    n = int(part.max(initial=-1)) + 1
    points = [np.unique(vertex[has_one_vertex & (part == i)]) for i in range(n)]
    cells_at_rim = np.bincount(part[touches_rim], minlength=n)
    cells_elsewhere = np.bincount(part[~touches_rim], minlength=n)
    has_points = np.array([len(vertices) for vertices in points], dtype=int) >= POINTS
    candidates = np.where(has_points & (cells_elsewhere > cells_at_rim), cells_at_rim, 0)
    best = (int(candidates.max(initial=0)), -mesh.comm.rank)
    most_cells, owner = mesh.comm.allreduce(best, op=MPI.MAX)
    if most_cells == 0:
        raise ValueError(
            f"subdomains={subdomains}: none of them touches a rim in {POINTS} points or more and "
            "has most of its cells elsewhere: take fewer, or refine the mesh."
        )
    if mesh.comm.rank != -owner:
        return part
    chosen = int(candidates.argmax())
    is_cut_off = touches_rim & (part == chosen)
    if contact == "few":
        kept_points = _nearest_points(V, points[chosen])
        touches_others = (is_on_rim & ~np.isin(cells, kept_points)).any(axis=1)
        is_cut_off &= touches_others
    return np.where(is_cut_off, part.max() + 1, part).astype(np.int32)


def _nearest_points(V: dolfinx.fem.FunctionSpace, points: Indices) -> Indices:
    """Return POINTS of some nodes of V: the first one, and those nearest to it."""
    X = V.tabulate_dof_coordinates()[points]
    order = np.argsort(np.linalg.norm(X - X[:1], axis=1), kind="stable")
    return points[order[:POINTS]]
