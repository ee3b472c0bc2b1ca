# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A first load step of a wall as the paper takes it, with its choices or with the package's.

The paper's section *Arterial model on a realistic mesh geometry*. The first Newton step has the
tangent of the wall at rest, as every load step of the package begins with the tangent of the last
equilibrium.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from benchmarks.common.records import Record
from benchmarks.common.walls.problem import WallProblem, create_wall_problem
from dolfinx_feti import ConvergenceError, loads
from dolfinx_feti.wall import Wall
from dolfinx_feti.wall.fibres import ANGLES, Frame, fibre_families

__all__ = ["ARTERIES", "CHOICES", "LAYERS", "PRECONDITIONERS", "TYPES", "create", "load", "sizes"]

#: What cases are told by, and their names on pages.
TYPES = {"all_floating": "all-floating", "classical": "classical"}
PRECONDITIONERS = ("identity", "lumped", "dirichlet")
CHOICES = {"paper": "the paper's choices", "default": "the package's defaults"}

#: Walls by layers: with the fibres of the media everywhere, the paper's aorta, or with media and
#: adventitia, its carotid artery.
LAYERS = {1: "one layer", 2: "two layers"}
ARTERIES = {1: "aorta", 2: "carotid artery"}

#: Tangent of the follower pressure. The paper leaves it out: then CG solves all systems, but on a
#: thin wall Newton's method comes only slowly to the solution.
TANGENTS = {"paper": "none", "default": "symmetric"}

#: The paper's choices, and none, which are the package's own. The absolute errors are norms of the
#: residual of the assembled system [mN].
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


def create(
    wall: Wall,
    frame: Frame,
    case: Record,
    subdomains: int | npt.NDArray[np.int32],
    options: Record,
) -> WallProblem:
    """Tear a wall at rest, with a number of subdomains or a part for each owned cell. Collective.

    Of the case it takes ``layers``, ``degree``, ``kappa`` [kPa] and ``choices``.
    """
    angles = ANGLES if case["layers"] == 2 else dict.fromkeys(ANGLES, ANGLES["media"])
    return create_wall_problem(
        wall,
        degree=case["degree"],
        kappa=case["kappa"],
        subdomains=subdomains,
        options=OPTIONS[str(case["choices"])] | options,
        fibres=fibre_families(wall, frame, angles),
        potential=False,
        tangent=TANGENTS[str(case["choices"])],
    )


def sizes(body: WallProblem) -> Record:
    """Return the sizes of a wall that is set up, and what is solved in which form."""
    report = body.problem.solver.getKSP().getPythonContext().report()
    names = ("multipliers", "coarse_size", "formulation")
    known = {} if report is None else {"subdomains_in_all": report.subdomains}
    return {"dofs": body.dofs} | known | {n: getattr(report, n) for n in names if known}


def load(body: WallProblem, mmhg: float, *, in_part: bool) -> None:
    """Load a wall at rest [mmHg], or only by the Newton steps that the options allow. Collective.

    Raises:
        ConvergenceError: A linear system was not solved, or Newton's method did not arrive.
    """
    at_rest = body.problem.linearise()
    body.load.value = loads.mmhg(mmhg)
    try:
        body.problem.solve(first_tangent=at_rest)
    except ConvergenceError:
        too_many = PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT
        if not in_part or body.problem.solver.getConvergedReason() != too_many:
            raise
