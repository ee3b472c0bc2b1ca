# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The diagnosis of a problem: one linear solve with a new solver, measurements, and advice."""

from __future__ import annotations

import textwrap
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.diagnosis.advice import Advice, advise
from dolfinx_feti.diagnosis.cell_volumes import CellVolumes
from dolfinx_feti.diagnosis.figures import Figures, collect_figures, figure_text
from dolfinx_feti.feti.report import Report, format_report
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import allgather_rows
from dolfinx_feti.runtime.cost import timed_solve
from dolfinx_feti.runtime.events import seconds_of
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.text_tables import json_value
from dolfinx_feti.torn.matrix import Torn

__all__ = ["Diagnosis", "diagnose", "residual_shares"]

#: Phases of the set-up, and their events in PETSc's log.
PHASES = {"gluing": "FETIGluing", "factors": "FETIFactor", "coarse problem": "FETICoarse"}


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Diagnosis of a problem; ``str`` prints it. The same on all processes.

    Attributes:
        report: The report of ``-ksp_view``; None if the set-up failed.
        figures: Figures of the subdomains; None if the set-up failed.
        method: Krylov method.
        iterations: Krylov iterations.
        relative_residual: ‖b − A x‖/‖b‖ of the solution.
        error_estimate: Estimated relative error of the solution; nan if not measured.
        message: Why the solve failed, or an empty string.
        seconds: Time of each phase on the slowest process [s]: ``assembly``; ``set-up``, with
            ``gluing``, ``factors`` and the ``coarse problem``; ``solve``.
        peak_mib: Peak memory above that before the solver was created, summed over all processes
            [MiB].
        residuals: Share of each subdomain in the residual of the current state, (subdomains,).
            ``decomposition.first + decomposition.subdomain`` is the entry of each owned cell.
        volumes: Volume changes of the cells in the current state; None for a problem without a
            deformation gradient.
        advice: Remedies, each with the quantity that suggests it.
    """

    report: Report | None
    figures: Figures | None
    method: str
    iterations: int
    relative_residual: float
    error_estimate: float
    message: str
    seconds: Mapping[str, float]
    peak_mib: float
    residuals: Array
    volumes: CellVolumes | None
    advice: tuple[Advice, ...]

    @property
    def records(self) -> list[object]:
        """One record of all measurements, ready for JSON; unknown values are None."""
        return [json_value({**asdict(self), "residuals": self.residuals.tolist()})]

    def __str__(self) -> str:
        """Return the solver's report, a row for each measurement, and the advice."""
        report = "" if self.report is None else textwrap.dedent(format_report(self.report))
        rows = [] if self.figures is None else self.figures.rows()
        rows.append(("iterations", f"{self.iterations} ({self.method or 'none'})"))
        seconds = ", ".join(f"{name} {t:.2f}" for name, t in self.seconds.items())
        rows.append(("time [s]", seconds))
        rows.append(("peak memory [MiB]", figure_text(self.peak_mib)))
        if self.volumes:
            rows.append(("cells", str(self.volumes)))
        if self.message:
            rows.append(("failed", self.message))
        rows += [("advice", str(advice)) for advice in self.advice or ("none",)]
        return report + "\n".join(f"{name:<22}{value}" for name, value in rows)


def diagnose(
    linear_system: Callable[[], tuple[PETSc.Mat, PETSc.Vec]],
    create_solver: Callable[[], PETSc.KSP],
    *,
    state: Array | float,
    prefix: str,
    earlier_advice: Sequence[Advice] = (),
    volumes: CellVolumes | None = None,
) -> Diagnosis:
    """Assemble a system, solve it with a new solver, and measure both. Collective.

    If the right-hand side is zero, a random one takes its place. PETSc's logging is started, if it
    is off, and stays on.

    Args:
        linear_system: Assembles the torn matrix A and the right-hand side b.
        create_solver: Creates the solver; its set-up is measured.
        state: The x whose residual b − A x is distributed over the subdomains: (owned,), or one
            number for all dofs.
        prefix: Prefix of the solver's options, for the advice.
        earlier_advice: Advice from earlier solves and from the state.
        volumes: Volume changes of the cells in the state.
    """
    with Lifetime() as owned:
        started = time.perf_counter()
        A, b = linear_system()
        assembled = time.perf_counter()
        owned.own(b)
        x = owned.own(b.duplicate())
        x.array[:] = state
        load = owned.own(b.copy())
        if not b.norm() > 0.0:
            rng = np.random.default_rng(A.comm.rank)
            load.array[:] = rng.standard_normal(load.getLocalSize())
        if not PETSc.Log.isActive():
            PETSc.Log.begin()
        before = seconds_of(PHASES.values())
        cost, ksp = timed_solve(create_solver, load, owned.own(b.duplicate()))
        owned.own(ksp)
        in_phases = np.subtract(seconds_of(PHASES.values()), before)
        seconds = {
            "assembly": assembled - started,
            "set-up": cost.seconds_setup,
            **dict(zip(PHASES, in_phases, strict=True)),
            "solve": cost.seconds_solve,
        }
        comm = A.comm.tompi4py()
        feti = ksp.getPythonContext()
        report = feti.report()
        figures = None
        advice = list(earlier_advice)
        if report is not None:
            figures = collect_figures(feti.formulation)
            advice += advise(figures, report, iterations=cost.iterations, prefix=prefix)
        return Diagnosis(
            report=report,
            figures=figures,
            method=feti.method,
            iterations=cost.iterations,
            relative_residual=feti.residual,
            error_estimate=feti.error_estimate,
            message=feti.message,
            seconds={name: float(comm.allreduce(t, op=MPI.MAX)) for name, t in seconds.items()},
            peak_mib=cost.peak_mib,
            residuals=residual_shares(A, b, x),
            volumes=volumes,
            advice=tuple(advice),
        )


def residual_shares(A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec) -> Array:
    """Return the share of each subdomain in ‖b − A x‖, (subdomains,). Collective.

    The square of a dof's residual is divided equally among its copies, so the squares of the shares
    sum to ‖b − A x‖².
    """
    with Lifetime() as owned:
        torn = owned.own(Torn(A))
        r = owned.own(b.duplicate())
        torn.residual(b, x, r)
        squares = torn.tear(r.array_r) ** 2 / torn.tear(torn.multiplicity())
        parts = allgather_rows([squares[dofs].sum() for dofs in torn.subdomains], torn.comm)
    return np.sqrt(parts)
