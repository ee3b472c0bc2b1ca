# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""One linear solve, watched: set-up and solution with a solver of its own, then what it tells."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.diagnosis.advice import Advice, advise
from dolfinx_feti.diagnosis.figures import collect_figures, residual_shares
from dolfinx_feti.diagnosis.result import Diagnosis, Seconds
from dolfinx_feti.runtime.cost import timed_solve
from dolfinx_feti.runtime.events import seconds_of

__all__ = ["diagnose"]

Array = npt.NDArray[np.float64]

PHASES = ("FETIGluing", "FETIFactor", "FETICoarse")


def diagnose(
    linear_system: Callable[[], tuple[PETSc.Mat, PETSc.Vec]],
    create: Callable[[], PETSc.KSP],
    *,
    state: Array | float,
    prefix: str,
    known: Sequence[Advice] = (),
) -> Diagnosis:
    """Assemble, set up a solver, solve with it, and gather what it tells. Collective.

    Args:
        linear_system: Assembles the torn matrix A and the right-hand side b, (N,). If b is zero, a
            random one is solved for.
        create: Creates the FETI solver.
        state: The x of which the residual b − A x is shown, (owned,), or one value for all.
        prefix: Options prefix of the problem.
        known: Advice from what earlier solves have found.
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
