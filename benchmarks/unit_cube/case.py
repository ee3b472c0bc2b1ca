# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""One case of the cube: its parameters, and the record of its solution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from benchmarks.common.clock import Clock
from benchmarks.common.machine import PeakMemory
from benchmarks.common.records import Record
from benchmarks.unit_cube.fundamental import l2_error
from benchmarks.unit_cube.memory import Estimate, estimate
from benchmarks.unit_cube.problem import CubeProblem, create_problem
from dolfinx_feti import LinearProblem

__all__ = ["LEVELS", "Case", "run", "tear"]

#: Levels of refinement, n = 2^(level − 1) cells along an edge of a subcube.
LEVELS = range(1, 6)

#: Relative reduction of the dual residual, the paper's.
RTOL = 1e-8

Monitor = Callable[[PETSc.KSP, int, float], None]


@dataclass(frozen=True, slots=True)
class Case:
    """Parameters of a case; the defaults are the paper's.

    Attributes:
        degree: Of the displacements.
        level: Of the mesh, see :data:`LEVELS`.
        subdomains_per_edge: Subcubes along an edge of the cube.
        type: ``-feti_type``.
        pc: ``-feti_pc_type``.
        scaling: ``-feti_scaling``.
        coarse_q: ``-feti_coarse_q``.
        gluing: ``-feti_gluing``.
        interior: ``-feti_interior``.
        coarse_modes: ``-feti_coarse_modes``.
        reorthogonalize: CG with full reorthogonalisation, ``fcg``.
        jump: Young's modulus of the stiff subcubes in units of the others'.
        pattern: Which they are.
        source: Source point of the fundamental solution.
    """

    degree: int = 1
    level: int = 1
    subdomains_per_edge: int = 8
    type: str = "all_floating"
    pc: str = "dirichlet"
    scaling: str = "multiplicity"
    coarse_q: str = "identity"
    gluing: str = "full"
    interior: str = "auto"
    coarse_modes: int = 0
    reorthogonalize: bool = False
    jump: float = 1.0
    pattern: str = "none"
    source: tuple[float, float, float] = (2.0, 2.0, 2.0)

    @property
    def cells(self) -> int:
        """Cells along an edge of a subcube."""
        return 2 ** (self.level - 1)

    def __str__(self) -> str:
        """Name what distinguishes the case from the paper's own."""
        words = [f"P{self.degree}, level {self.level}", f"{self.subdomains_per_edge}³ subdomains"]
        words += [self.type, self.pc]
        usual = asdict(Case())
        kept = ("scaling", "coarse_q", "gluing", "interior", "coarse_modes")
        words += [str(getattr(self, name)) for name in kept if getattr(self, name) != usual[name]]
        words += [f"{self.pattern} of {self.jump:g}"] * (self.pattern != "none")
        words += ["reorthogonalized"] * self.reorthogonalize
        return ", ".join(words)

    def key(self) -> Record:
        """Return the parameters as they stand in a record."""
        return asdict(self) | {"source": list(self.source)}

    def problem(self, comm: MPI.Comm) -> CubeProblem:
        """Create its boundary value problem. Collective."""
        return create_problem(
            comm,
            subdomains=self.subdomains_per_edge,
            cells=self.cells,
            degree=self.degree,
            source=self.source,
            jump=self.jump,
            pattern=self.pattern,
        )

    def estimate(self, processes: int) -> Estimate:
        """Estimate its memory."""
        return estimate(
            degree=self.degree,
            cells=self.cells,
            subdomains=self.subdomains_per_edge,
            all_floating=self.type == "all_floating",
            pc_type=self.pc,
            coarse_q=self.coarse_q,
            interior=self.interior,
            processes=processes,
        )

    def options(self) -> dict[str, object]:
        """Return the options of the solver."""
        return {
            "feti_type": self.type,
            "feti_pc_type": self.pc,
            "feti_scaling": self.scaling,
            "feti_coarse_q": self.coarse_q,
            "feti_gluing": self.gluing,
            "feti_interior": self.interior,
            "feti_coarse_modes": self.coarse_modes,
            **({"feti_dual_ksp_type": "fcg"} if self.reorthogonalize else {}),
            "feti_dual_ksp_rtol": RTOL,
        }


def tear(problem: CubeProblem, options: dict[str, object]) -> LinearProblem:
    """Tear a problem into its subcubes.

    Args:
        problem: The boundary value problem.
        options: PETSc options of the solver, prefix ``cube_``.

    Note:
        Collective.
    """
    return LinearProblem(
        problem.a,
        problem.L,
        bcs=problem.bcs,
        subdomains=problem.part,
        petsc_options_prefix="cube_",
        petsc_options=options,
    )


def run(case: Case, problem: CubeProblem, comm: MPI.Comm, monitor: Monitor | None) -> Record:
    """Solve a case.

    Args:
        case: The case.
        problem: Its boundary value problem.
        comm: Communicator of its mesh.
        monitor: Called at every iteration.

    Returns:
        Its record.

    Raises:
        dolfinx_feti.ConvergenceError: FETI did not converge.

    Note:
        Collective.
    """
    peak = PeakMemory()
    clock = Clock(comm)
    linear = tear(problem, case.options())
    clock.watch(linear.solver)
    if monitor is not None:
        linear.solver.setMonitor(monitor)
    u = linear.solve()
    peak_mib = peak.mib(comm)
    feti = linear.solver.getPythonContext()
    report = feti.report()
    low, high = feti.eigenvalues
    return (
        case.key()
        | {
            "subdomains": report.subdomains,
            "dofs_local_max": report.dofs_local[1],
            "dofs": report.dofs,
            "dofs_torn": report.torn_dofs,
            "multipliers": report.multipliers,
            "coarse_size": report.coarse_size,
            "coarse_mib": _number(report.coarse_mib),
            "kernels": list(report.kernels),
            "interior_is": report.interior,
            "factor_mib": report.factor_mib,
            "iterations": feti.iterations,
            "condition_number": _number(feti.condition_number),
            "lambda_min": _number(low),
            "lambda_max": _number(high),
            "relative_residual": feti.residual,
            "l2_error": l2_error(u, problem.exact) if case.jump == 1.0 else None,
            "peak_mib": _number(peak_mib),
            "processes": comm.size,
        }
        | clock.record()
    )


def _number(value: float) -> float | None:
    """JSON has no nan."""
    return float(value) if np.isfinite(value) else None
