# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The diagnosis of a problem: one linear solve with a new solver, its figures, and advice.

The jump of the stiffness is the greatest :math:`k_i / \min_j k_j` over the copies i, j of a dof,
with the stiffness k of a subdomain at the dof. The condensed pressure raises the diagonal of K by
the ratio of κ to the shear modulus. The mean of this ratio over the dofs, and the number of
pressures per dof, indicate whether the volume constraint locks the elements.
"""

from __future__ import annotations

import textwrap
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TypeAlias

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.diagnosis.advice import Advice, advise
from dolfinx_feti.diagnosis.cell_volumes import CellVolumes
from dolfinx_feti.feti.formulation import Formulation
from dolfinx_feti.feti.report import Report, table
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import allgather_rows
from dolfinx_feti.runtime.cost import timed_solve
from dolfinx_feti.runtime.events import seconds_of
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.text_tables import json_value
from dolfinx_feti.torn.matrix import Torn

__all__ = ["Diagnosis", "Figure", "collect_figures", "diagnose", "residual_shares"]

#: Phases of the set-up, and their events in PETSc's log.
PHASES = {"gluing": "FETIGluing", "factors": "FETIFactor", "coarse problem": "FETICoarse"}

#: A number; a text; smallest, mean and largest of a number; or a list of counts.
Figure: TypeAlias = float | str | tuple[float, float, float] | list[int]


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Diagnosis of a problem; ``str`` prints it. The same on all processes.

    Attributes:
        report: The report of ``-ksp_view``; None if the set-up failed.
        figures: Further measurements, by name; three numbers are smallest, mean and largest.
        method: Krylov method.
        iterations: Krylov iterations.
        relative_residual: ‖b − A x‖/‖b‖ of the solution.
        error_estimate: Estimated relative error of the solution; nan if not measured.
        message: Why the solve failed, or an empty string.
        seconds: Time of each phase on the slowest process [s]: ``assembly``; ``set-up``, with
            ``gluing``, ``factors`` and the ``coarse problem``; ``solve``.
        peak_mib: Peak memory in addition to mesh and matrix, summed over all processes [MiB].
        residuals: Share of each subdomain in the residual of the current state, (subdomains,), in
            the order of their numbers, ``decomposition.first + decomposition.subdomain``.
        volumes: Volume changes of the cells in the current state; None for a problem without a
            deformation gradient.
        advice: Remedies for what was measured.
    """

    report: Report | None
    figures: Mapping[str, Figure]
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
        rows = [(name, _text(figure)) for name, figure in self.figures.items()]
        rows.append(("iterations", f"{self.iterations} ({self.method or 'none'})"))
        seconds = ", ".join(f"{name} {t:.2f}" for name, t in self.seconds.items())
        rows.append(("time [s]", seconds))
        rows.append(("peak memory [MiB]", _text(self.peak_mib)))
        if self.volumes:
            rows.append(("cells", str(self.volumes)))
        if self.message:
            rows.append(("failed", self.message))
        rows += [("advice", str(advice)) for advice in self.advice or ("none",)]
        report = "" if self.report is None else textwrap.dedent(table(self.report))
        return report + "\n".join(f"{name:<22}{value}" for name, value in rows)


def _text(figure: Figure) -> str:
    """Format a figure: counts as ``2, 3``, smallest to largest as ``1 … 2 … 3``, nan as a dash."""
    if isinstance(figure, str):
        return figure
    if isinstance(figure, list):
        return ", ".join(map(_text, figure))
    if isinstance(figure, tuple):
        return " … ".join(map(_text, figure))
    if np.isnan(figure):
        return "–"
    return f"{figure:.0f}" if abs(figure) >= 100 else f"{figure:.3g}"


def diagnose(
    linear_system: Callable[[], tuple[PETSc.Mat, PETSc.Vec]],
    create: Callable[[], PETSc.KSP],
    *,
    state: Array | float,
    prefix: str,
    known: Sequence[Advice] = (),
    volumes: CellVolumes | None = None,
) -> Diagnosis:
    """Assemble a system, solve it with a new solver, and measure both. Collective.

    A random right-hand side replaces one that is zero.

    Args:
        linear_system: Assembles the torn matrix A and the right-hand side b.
        create: Creates the solver and sets it up.
        state: The x whose residual b − A x is shown, (owned,) or a number for all dofs.
        prefix: Prefix of the solver's options, for the advice.
        known: Advice from earlier solves and from the state.
        volumes: Volume changes of the cells in the state.
    """
    started = time.perf_counter()
    A, b = linear_system()
    seconds = {"assembly": time.perf_counter() - started}
    comm = A.comm.tompi4py()
    x = b.duplicate()
    load = b.copy()
    solution = b.duplicate()
    x.array[:] = state
    if not b.norm() > 0.0:
        load.array[:] = np.random.default_rng(comm.rank).standard_normal(load.getLocalSize())
    if not PETSc.Log.isActive():
        PETSc.Log.begin()
    before = seconds_of(PHASES.values())
    cost, ksp = timed_solve(create, load, solution)
    spent = np.subtract(seconds_of(PHASES.values()), before)
    seconds |= {"set-up": cost.seconds_setup, **dict(zip(PHASES, spent, strict=True))}
    seconds["solve"] = cost.seconds_solve
    feti = ksp.getPythonContext()
    report = feti.report()
    figures = dict[str, Figure]()
    advice = list[Advice]()
    if report is not None:
        figures = collect_figures(feti.formulation)
        advice = advise(figures, report, iterations=cost.iterations, prefix=prefix)
    diagnosis = Diagnosis(
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
        advice=(*known, *advice),
    )
    for owned in (ksp, load, solution, b, x):
        owned.destroy()
    return diagnosis


def collect_figures(formulation: Formulation) -> dict[str, Figure]:
    """Return the figures over all processes, by the names that a diagnosis prints. Collective."""
    torn = formulation.pattern.torn
    copies = torn.multiplicity()
    comm = torn.comm
    torn_copies = torn.tear(copies)

    def spread(values: Sequence[float]) -> tuple[float, float, float]:
        """Return the smallest, mean and largest value over all processes."""
        v = allgather_rows(values, comm).astype(float)
        if not len(v):
            return np.nan, np.nan, np.nan
        return float(v.min()), float(v.mean()), float(v.max())

    most_copies = comm.allreduce(copies.max(initial=0), op=MPI.MAX)
    counts = np.bincount(copies, minlength=most_copies + 1)
    shares = [float(np.mean(torn_copies[dofs] > 1)) for dofs in torn.subdomains]
    figures: dict[str, Figure] = {
        "dofs of a subdomain": spread([len(dofs) for dofs in torn.subdomains]),
        "interface share": spread(shares),
        "subdomains / process": spread([len(torn.subdomains)]),
        "dofs / process": spread([torn.n]),
        "MiB / process": spread([formulation.memory()]),
        "dofs by copies": [int(n) for n in comm.allreduce(counts)[1:]],
        "jump of stiffness": _jump(torn),
        "rigid body modes": _motions(torn),
        "null vectors": comm.allreduce(sum(m.null_size for m in formulation.modes)),
    }
    without_pressure = torn.A.query("stiffness")  # the diagonal of K before the condensation
    if torn.pressures is not None and without_pressure is not None:
        is_free = torn.assemble((~torn.dirichlet_copies).astype(np.float64)) > 0.5
        with_pressure = np.abs(torn.diagonal()).sum()
        without = np.abs(without_pressure.array_r).sum()
        sums = comm.allreduce(np.array([torn.pressures, is_free.sum(), with_pressure, without]))
        p, n, raised, original = np.where(sums > 0.0, sums, np.nan)
        figures["pressures per dof"] = float(p / n)
        figures["stiffer by pressures"] = float(raised / original)
    return figures


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


def _jump(torn: Torn) -> float:
    """Return the greatest ratio of the stiffnesses of the copies of a dof. Collective."""
    k = torn.gather(torn.stiffness())
    counts = torn.multiplicity()
    first = (np.cumsum(counts) - counts)[counts > 0]
    least = np.minimum.reduceat(k, first)
    most = np.maximum.reduceat(k, first)
    jump = float(np.max(most / np.where(least > 0.0, least, np.inf), initial=1.0))
    return torn.comm.allreduce(jump, op=MPI.MAX)


def _motions(torn: Torn) -> str:
    """Return the near kernel as text: translations and rotations, or constants."""
    near_kernel = torn.A.getNearNullSpace()
    modes = len(near_kernel.getVecs()) if near_kernel.handle else 1
    bs = torn.A.getBlockSize()
    if bs == 2 and modes == 3:
        return "2 translations, 1 rotation"
    if bs == 3 and modes == 6:
        return "3 translations, 3 rotations"
    return "1 constant" if modes == 1 else f"{modes} constants"
