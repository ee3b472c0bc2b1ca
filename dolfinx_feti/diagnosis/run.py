# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""One linear solve, watched: set-up and solution with a solver of its own, then what it tells."""

from __future__ import annotations

import math
import textwrap
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.diagnosis.advice import Advice, advise
from dolfinx_feti.diagnosis.figures import Figures, Spread, collect_figures, residual_shares
from dolfinx_feti.feti.report import table
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.cost import timed_solve
from dolfinx_feti.runtime.events import seconds_of
from dolfinx_feti.runtime.tables import json_value

__all__ = ["Diagnosis", "Seconds", "diagnose"]


PHASES = ("FETIGluing", "FETIFactor", "FETICoarse")


@dataclass(frozen=True, slots=True)
class Seconds:
    """What the time of one linear solve went into, on the slowest process [s].

    Attributes:
        assembly: Matrix and right-hand side.
        gluing: B and its weights.
        factors: Local factors and kernels.
        coarse: Coarse problem.
        setup: All of the set-up.
        solve: Krylov method.
    """

    assembly: float
    gluing: float
    factors: float
    coarse: float
    setup: float
    solve: float


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Diagnosis of a problem; ``str`` prints it. The same on all processes.

    Attributes:
        figures: Figures of the solver; None if its set-up failed.
        method: Krylov method.
        iterations: Krylov iterations.
        relative_residual: ‖b − A x‖/‖b‖ after them.
        message: Why the solve failed, or an empty string.
        seconds: Time.
        peak_mib: Peak memory above mesh and matrix, of all processes together [MiB].
        residuals: Part of each subdomain in the residual of the present state, (subdomains,), in
            the order of their numbers, ``decomposition.first + decomposition.subdomain``.
        advice: What would help.
    """

    figures: Figures | None
    method: str
    iterations: int
    relative_residual: float
    message: str
    seconds: Seconds
    peak_mib: float
    residuals: Array
    advice: tuple[Advice, ...]

    @property
    def records(self) -> list[object]:
        """One record of all that was measured, to be written as JSON; None for what is unknown."""
        return [json_value({**asdict(self), "residuals": self.residuals.tolist()})]

    def __str__(self) -> str:
        """Return the solver's own report, what was measured, and the advice."""
        s = self.seconds
        rows = [
            *([] if self.figures is None else _rows(self.figures)),
            ("iterations", f"{self.iterations} ({self.method or 'none'})"),
            ("residual", f"{self.relative_residual:.1e}"),
            (
                "time [s]",
                f"assembly {s.assembly:.2f}, set-up {s.setup:.2f} (gluing {s.gluing:.2f}, factors "
                f"{s.factors:.2f}, coarse problem {s.coarse:.2f}), solve {s.solve:.2f}",
            ),
            ("peak memory [MiB]", "–" if math.isnan(self.peak_mib) else f"{self.peak_mib:.0f}"),
            ("failed", self.message),
            *([("advice", str(advice)) for advice in self.advice] or [("advice", "none")]),
        ]
        report = "" if self.figures is None else textwrap.dedent(table(self.figures.report))
        return report + "\n".join(f"{name:<22}{value}" for name, value in rows if value)


def _rows(figures: Figures) -> list[tuple[str, str]]:
    """Return what the solver's report does not have."""
    copies = ", ".join(
        f"{n} of {m} {'copies' if m > 1 else 'copy'}"
        for m, n in enumerate(figures.multiplicities, start=1)
        if n
    )
    pressure = ""
    if figures.pressures_per_dof:
        pressure = (
            f"{figures.pressures_per_dof:.2f} for each dof, which they make "
            f"{figures.pressure_stiffness:.4g} times as stiff"
        )
    return [
        ("dofs each", _spread(figures.dofs_subdomain)),
        ("interface", f"share of a subdomain's dofs {_spread(figures.interface, '.2f')}"),
        ("dofs with copies", copies),
        ("jump of stiffness", f"{figures.jump:.4g}"),
        ("rigid body modes", f"{figures.motions}; {figures.null} null vectors in addition"),
        ("pressures", pressure),
        (
            "processes",
            f"subdomains {_spread(figures.subdomains_process)}, dofs "
            f"{_spread(figures.dofs_process)}, factors [MiB] {_spread(figures.factor_mib_process)}",
        ),
    ]


def _spread(spread: Spread, form: str = ".0f") -> str:
    """Format the least, mean and most of something."""
    return f"{spread.least:{form}} … {spread.mean:{form}} … {spread.most:{form}}"


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
    assembly = time.perf_counter() - started
    comm = A.comm.tompi4py()
    x = b.duplicate()
    x.array[:] = state
    load, solution = b.copy(), b.duplicate()
    if not b.norm() > 0.0:
        load.array[:] = np.random.default_rng(comm.rank).standard_normal(load.getLocalSize())
    if not PETSc.Log.isActive():
        PETSc.Log.begin()
    before = seconds_of(PHASES)
    cost, ksp = timed_solve(create, load, solution)
    spent = [now - then for now, then in zip(seconds_of(PHASES), before, strict=True)]
    gluing, factors, coarse = (comm.allreduce(seconds, op=MPI.MAX) for seconds in spent)
    feti = ksp.getPythonContext()
    figures, report = None, feti.report()
    if feti.form is not None and report is not None:
        figures = collect_figures(feti.form, report)
    advice: tuple[Advice, ...] = ()
    if figures is not None:
        advice = advise(figures, iterations=cost.iterations, prefix=prefix)
    diagnosis = Diagnosis(
        figures=figures,
        method=feti.method,
        iterations=cost.iterations,
        relative_residual=feti.residual,
        message=feti.message,
        seconds=Seconds(
            assembly=comm.allreduce(assembly, op=MPI.MAX),
            gluing=gluing,
            factors=factors,
            coarse=coarse,
            setup=cost.seconds_setup,
            solve=cost.seconds_solve,
        ),
        peak_mib=cost.peak_mib,
        residuals=residual_shares(A, b, x),
        advice=(*known, *advice),
    )
    for owned in (ksp, load, solution, b, x):
        owned.destroy()
    return diagnosis
