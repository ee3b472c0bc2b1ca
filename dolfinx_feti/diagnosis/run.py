# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""One linear solve, watched: set-up and solution with a solver of its own, then what it tells."""

from __future__ import annotations

import textwrap
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.diagnosis.advice import Advice, advise
from dolfinx_feti.diagnosis.figures import Figure, collect_figures, residual_shares
from dolfinx_feti.feti.report import Report, table
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.cost import timed_solve
from dolfinx_feti.runtime.events import seconds_of
from dolfinx_feti.runtime.tables import json_value

__all__ = ["Diagnosis", "diagnose"]

PHASES = {"gluing": "FETIGluing", "factors": "FETIFactor", "coarse problem": "FETICoarse"}


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Diagnosis of a problem; ``str`` prints it. The same on all processes.

    Attributes:
        report: What ``-ksp_view`` shows; None if the set-up failed.
        figures: What else was measured, by name; of three numbers the least, mean and greatest.
        method: Krylov method.
        iterations: Krylov iterations.
        relative_residual: ‖b − A x‖/‖b‖ after them.
        message: Why the solve failed, or an empty string.
        seconds: What the time went into, on the slowest process [s]: ``assembly``; ``set-up``, with
            ``gluing``, ``factors`` and the ``coarse problem``; ``solve``.
        peak_mib: Peak memory above mesh and matrix, of all processes together [MiB].
        residuals: Part of each subdomain in the residual of the present state, (subdomains,), in
            the order of their numbers, ``decomposition.first + decomposition.subdomain``.
        advice: What would help.
    """

    report: Report | None
    figures: Mapping[str, Figure]
    method: str
    iterations: int
    relative_residual: float
    message: str
    seconds: Mapping[str, float]
    peak_mib: float
    residuals: Array
    advice: tuple[Advice, ...]

    @property
    def records(self) -> list[object]:
        """One record of all that was measured, to be written as JSON; None for what is unknown."""
        return [json_value({**asdict(self), "residuals": self.residuals.tolist()})]

    def __str__(self) -> str:
        """Return the solver's own report, what was measured, and the advice."""
        rows = [
            *((name, _text(figure)) for name, figure in self.figures.items()),
            ("iterations", f"{self.iterations} ({self.method or 'none'})"),
            ("residual", f"{self.relative_residual:.1e}"),
            ("time [s]", ", ".join(f"{name} {t:.2f}" for name, t in self.seconds.items())),
            ("peak memory [MiB]", _text(self.peak_mib)),
            *([("failed", self.message)] if self.message else []),
            *(("advice", str(advice)) for advice in self.advice or ("none",)),
        ]
        report = "" if self.report is None else textwrap.dedent(table(self.report))
        return report + "\n".join(f"{name:<22}{value}" for name, value in rows)


def _text(figure: Figure) -> str:
    """Format a figure."""
    if isinstance(figure, str):
        return figure
    if isinstance(figure, (list, tuple)):
        return (", " if isinstance(figure, list) else " … ").join(map(_text, figure))
    return "–" if np.isnan(figure) else f"{figure:.0f}" if abs(figure) >= 100 else f"{figure:.3g}"


def diagnose(
    linear_system: Callable[[], tuple[PETSc.Mat, PETSc.Vec]],
    create: Callable[[], PETSc.KSP],
    *,
    state: Array | float,
    prefix: str,
    known: Sequence[Advice] = (),
) -> Diagnosis:
    """Assemble, set up a solver, solve with it, and gather what it tells. Collective.

    A right-hand side that is zero makes way for a random one. ``state`` is the x of which the
    residual b − A x is shown, (owned,), ``prefix`` that of the options, ``known`` advice from
    earlier solves.
    """
    started = time.perf_counter()
    A, b = linear_system()
    seconds = {"assembly": time.perf_counter() - started}
    comm = A.comm.tompi4py()
    x, load, solution = b.duplicate(), b.copy(), b.duplicate()
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
    report, figures, advice = feti.report(), dict[str, Figure](), list[Advice]()
    if report is not None:
        figures = collect_figures(feti.form)
        advice = advise(figures, report, iterations=cost.iterations, prefix=prefix)
    diagnosis = Diagnosis(
        report=report,
        figures=figures,
        method=feti.method,
        iterations=cost.iterations,
        relative_residual=feti.residual,
        message=feti.message,
        seconds={name: float(comm.allreduce(t, op=MPI.MAX)) for name, t in seconds.items()},
        peak_mib=cost.peak_mib,
        residuals=residual_shares(A, b, x),
        advice=(*known, *advice),
    )
    for owned in (ksp, load, solution, b, x):
        owned.destroy()
    return diagnosis
