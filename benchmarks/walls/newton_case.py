# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""One case of the nonlinear study: a first load step, and what each Newton step of it costs.

The paper's section *Arterial model on a realistic mesh geometry*, tables Augustin_tab:aorta_linear,
carotis_linear, aorta_quadratic and carotis_quadratic. The first Newton step has the tangent of the
wall at rest, as every load step of the package begins with the tangent of the last equilibrium.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from benchmarks.common.records import Record
from benchmarks.common.stopwatch import Stopwatch
from benchmarks.walls.problem import WallProblem, create_wall_problem
from benchmarks.walls.volume import summarise, volume_ratios
from dolfinx_feti import ConvergenceError, loads, materials
from dolfinx_feti.wall import Wall
from dolfinx_feti.wall.fibres import ANGLES, Frame, fibre_families

__all__ = ["CHOICES", "NEWTON_STEPS", "TANGENTS", "Case", "is_finished", "run"]

#: Tangent of the follower pressure. The paper leaves it out: then CG solves all systems, but on a
#: thin wall Newton's method comes only slowly to the solution.
TANGENTS = {"paper": "none", "default": "symmetric"}

#: Most Newton steps: with the paper's tangent as many as it took at least.
NEWTON_STEPS = {"paper": 4, "default": 20}

#: The paper's choices, and none, which are the package's own. The absolute errors are norms of the
#: residual of the assembled system [mN]; "without end" is for preconditioners that are slow.
CHOICES: dict[str, Record] = {
    "paper": {
        "feti_scaling": "multiplicity",
        "feti_coarse_q": "identity",
        "feti_coarse_modes": 0,
        "feti_formulation": "dual",
        "feti_stagnation": 0,
        "feti_dual_ksp_type": "cg",
        "ksp_rtol": 1e-12,
        "ksp_atol": 1e-8,
        "snes_rtol": 1e-14,
        "snes_atol": 1e-6,
    },
    "default": {},
}


@dataclass(frozen=True, slots=True)
class Case:
    """Parameters of a case, as they stand in its record.

    Attributes:
        geometry: ``vessel`` or ``tube``.
        size: Length of the elements' edges [mm]; None for the generator's default.
        layers: 1 for one fibre angle in the whole wall (the paper's aorta), 2 for media and
            adventitia (its carotid artery).
        degree: k of P_k–P_0.
        subdomains: Number of subdomains, before a rim is cut off.
        contact: How one subdomain meets the rim, see ``rims``.
        kappa: κ [kPa].
        pressure: The load [mmHg].
        type: ``-feti_type``.
        pc: ``-feti_pc_type``.
        choices: Key of :data:`CHOICES`.
        processes: Number of processes.
    """

    geometry: str
    size: float | None
    layers: int
    degree: int
    subdomains: int
    contact: str
    kappa: float
    pressure: float
    type: str
    pc: str
    choices: str
    processes: int

    def __str__(self) -> str:
        """Name it in a line."""
        rim = {"whole": "", "few": ", few points on the rim", "none": ", off the rim"}
        return (
            f"{self.geometry}, {self.layers} layer(s), P{self.degree}–P0, κ = {self.kappa:g}, "
            f"{self.type}, {self.pc}, {self.choices}{rim[self.contact]}"
        )

    def key(self) -> Record:
        """Return the parameters by which a record is found."""
        return asdict(self)

    def options(self, most: int) -> Record:
        """Return the options of the solver; ``most`` iterations in a linear solve at most."""
        own = {"feti_type": self.type, "feti_pc_type": self.pc, "ksp_max_it": most}
        own["snes_max_it"] = NEWTON_STEPS[self.choices]
        return CHOICES[self.choices] | own


def run(case: Case, wall: Wall, frame: Frame, part: npt.NDArray[np.int32], *, most: int) -> Record:
    """Load a wall at rest, and record what it took.

    Args:
        case: The case.
        wall: Its wall.
        frame: The wall's directions.
        part: Part of each owned cell.
        most: Most iterations of a linear solve.

    Returns:
        The record: of the whole load step, or of the Newton steps before a linear solve that took
        more than ``most`` iterations (``iterations_exceed``) or failed (``failure``).

    Note:
        Collective.
    """
    angles = ANGLES if case.layers == 2 else dict.fromkeys(ANGLES, ANGLES["media"])
    body = create_wall_problem(
        wall,
        degree=case.degree,
        c=materials.ArteryParameters().c,
        kappa=case.kappa,
        subdomains=part,
        options=case.options(most),
        fibres=fibre_families(wall, frame, angles),
        potential=False,
        tangent=TANGENTS[case.choices],
    )
    ksp = body.problem.solver.getKSP()
    clock = "processor" if wall.mesh.comm.size == 1 else "wall"
    watch = Stopwatch(wall.mesh.comm, clock=clock)
    watch.hook(ksp)
    found: Record = {}
    at_rest = body.problem.linearise()
    body.pressure.value = loads.mmhg(case.pressure)
    try:
        body.problem.solve(first_tangent=at_rest)
    except ConvergenceError as error:
        stopped = body.problem.solver.getConvergedReason()
        if case.choices == "paper" and stopped == PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT:
            pass  # the first Newton steps are what was asked for
        elif ksp.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT:
            found["iterations_exceed"] = most
        else:
            found["failure"] = str(error)
    found |= _size(body, ksp) | dict(_cost(body, watch)) | {"clock": clock}
    if "failure" not in found and "iterations_exceed" not in found:
        found |= asdict(summarise(volume_ratios(body.u), wall.mesh.comm))
    return case.key() | found


def is_finished(record: Record | None, most: int) -> bool:
    """Tell whether a record needs no further run with so many iterations allowed."""
    return record is not None and record.get("iterations_exceed", most) >= most


def _size(body: WallProblem, ksp: PETSc.KSP) -> Record:
    """Return sizes, and what is solved in which form."""
    report = ksp.getPythonContext().report()
    cells = body.u.function_space.mesh.topology.index_map(3).size_global
    sizes: Record = {"dofs": body.dofs, "cells": cells}
    if report is not None:
        sizes |= {
            "subdomains_in_all": report.subdomains,
            "multipliers": report.multipliers,
            "coarse_size": report.coarse_size,
            "formulation": report.formulation,
        }
    return sizes


def _cost(body: WallProblem, watch: Stopwatch) -> Iterator[tuple[str, object]]:
    """Yield iterations and seconds of the Newton steps that were completed."""
    steps = body.problem.history
    yield "newton_iterations", len(steps)
    yield "linear_iterations_per_newton", [s.linear_iterations for s in steps]
    yield "linear_methods", [s.linear_method for s in steps]
    yield "linear_residuals", [s.linear_residual for s in steps]
    yield "step_lengths", [s.step_length for s in steps]
    if steps:
        yield "linear_iterations_mean", float(np.mean([s.linear_iterations for s in steps]))
        yield "seconds_assembly_per_newton", float(np.mean([s.seconds_assembly for s in steps]))
    setup, krylov = watch.seconds()
    solves = max(watch.solves, 1)
    yield "seconds_setup_per_newton", setup / solves
    yield "seconds_krylov_per_newton", krylov / solves
