# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""One case of the cube: its parameters, and the record of its solution."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from mpi4py import MPI

import numpy as np

from benchmarks.common.clock import Clock
from benchmarks.common.cube import CubeProblem, create_problem, l2_error, tear
from benchmarks.common.machine import PeakMemory
from benchmarks.common.records import Record
from benchmarks.cube.memory import Estimate, estimate
from dolfinx_feti import LinearProblem

__all__ = ["LEVELS", "Case", "run", "solve"]

#: Levels of refinement, n = 2^(level − 1) cells along an edge of a subcube.
LEVELS = range(1, 6)

#: Relative reduction of the dual residual, the paper's.
RTOL = 1e-8


@dataclass(frozen=True, slots=True)
class Case:
    """Parameters of a case, those of the command line; the defaults are the paper's.

    ``gluing`` has multipliers between all pairs of subdomains that share a dof, and
    ``reorthogonalize`` is CG with full reorthogonalisation.
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

    def __str__(self) -> str:
        """Name what distinguishes the case from the paper's own."""
        words = [f"P{self.degree}, level {self.level}", f"{self.subdomains_per_edge}³ subdomains"]
        words += [self.type, self.pc]
        usual = asdict(Case())
        kept = ("scaling", "coarse_q", "interior", "coarse_modes")
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
            cells=2 ** (self.level - 1),
            degree=self.degree,
            source=self.source,
            jump=self.jump,
            pattern=self.pattern,
        )

    def estimate(self, processes: int) -> Estimate:
        """Estimate its memory."""
        return estimate(
            degree=self.degree,
            cells=2 ** (self.level - 1),
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
            "feti_interior": self.interior,
            "feti_coarse_modes": self.coarse_modes,
            **({"feti_dual_ksp_type": "fcg"} if self.reorthogonalize else {}),
            "feti_dual_ksp_rtol": RTOL,
        }


def run(case: Case, problem: CubeProblem, comm: MPI.Comm) -> Record:
    """Solve a case, and return its record. Collective.

    Raises:
        dolfinx_feti.ConvergenceError: FETI did not converge.
    """
    peak = PeakMemory()
    linear, found = solve(problem, case.options())
    peak_mib = _number(peak.mib(comm))
    error = l2_error(linear.u, problem.exact) if case.jump == 1.0 else None
    own = {"l2_error": error, "peak_mib": peak_mib, "processes": comm.size}
    return case.key() | found | own


def solve(problem: CubeProblem, options: dict[str, object]) -> tuple[LinearProblem, Record]:
    """Tear a problem, solve it, and record what it took; options prefix ``cube_``. Collective."""
    clock = Clock(problem.mesh.comm)
    linear = tear(problem, options)
    clock.watch(linear.solver)
    linear.solve()
    feti = linear.solver.getPythonContext()
    report = feti.report()
    low, high = feti.eigenvalues
    return linear, {
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
    } | clock.record()


def _number(value: float) -> float | None:
    """JSON has no nan."""
    return float(value) if np.isfinite(value) else None
