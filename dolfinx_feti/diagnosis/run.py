# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""One linear solve, watched: set-up and solution with a solver of its own, then what it tells.

The weights of the copies differ as the stiffnesses k of the subdomains at a dof do; their jump is
the greatest :math:`k_i / \min_j k_j` over the copies i, j of a dof. The condensed pressure raises
the diagonal of K in the ratio of κ to the shear modulus; its mean share over the dofs, and the
number of pressures for each dof, tell whether the volume constraint locks the elements.
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
from dolfinx_feti.feti.lasting import Form
from dolfinx_feti.feti.report import Report, table
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import join
from dolfinx_feti.runtime.cost import timed_solve
from dolfinx_feti.runtime.events import seconds_of
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.runtime.tables import json_value
from dolfinx_feti.torn.matrix import Torn

__all__ = ["Diagnosis", "Figure", "collect_figures", "diagnose", "residual_shares"]

PHASES = {"gluing": "FETIGluing", "factors": "FETIFactor", "coarse problem": "FETICoarse"}

#: A number, words, the least, mean and greatest of a number, or a list of counts.
Figure: TypeAlias = float | str | tuple[float, float, float] | list[int]


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

    A random right-hand side replaces one that is zero. ``state`` is the x of which the residual
    b − A x is shown, (owned,); ``known`` is advice from earlier solves.
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


def collect_figures(form: Form) -> dict[str, Figure]:
    """Gather the figures of all processes, by the names that a diagnosis prints. Collective."""
    torn, copies = form.pattern.torn, form.pattern.torn.multiplicity()
    comm, torn_copies = torn.comm, torn.tear(copies)

    def spread(values: Sequence[float]) -> tuple[float, float, float]:
        v = join(values, comm).astype(float)
        return (float(v.min()), float(v.mean()), float(v.max())) if len(v) else (np.nan,) * 3

    counts = np.bincount(copies, minlength=comm.allreduce(copies.max(initial=0), op=MPI.MAX) + 1)
    shares = [float(np.mean(torn_copies[dofs] > 1)) for dofs in torn.subdomains]
    figures: dict[str, Figure] = {
        "dofs of a subdomain": spread([len(dofs) for dofs in torn.subdomains]),
        "interface share": spread(shares),
        "subdomains / process": spread([len(torn.subdomains)]),
        "dofs / process": spread([torn.n]),
        "MiB / process": spread([form.memory()]),
        "dofs by copies": [int(n) for n in comm.allreduce(counts)[1:]],
        "jump of stiffness": _jump(torn),
        "rigid body modes": _motions(torn),
        "null vectors": comm.allreduce(sum(m.null for m in form.modes)),
    }
    pressures, before = torn.pressures, torn.A.query("stiffness")
    if pressures is not None and before is not None:
        free = torn.assemble((~torn.dirichlet).astype(np.float64)) > 0.5
        sizes = (np.abs(k).sum() for k in (torn.diagonal(), before.array_r))
        parts = np.array([pressures, free.sum(), *sizes])
        p, n, raised, own = np.where((total := comm.allreduce(parts)) > 0.0, total, np.nan)
        figures |= {"pressures per dof": float(p / n), "stiffer by pressures": float(raised / own)}
    return figures


def residual_shares(A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec) -> Array:
    """Return the part of each subdomain in ‖b − A x‖, (subdomains,). Collective.

    A dof counts in equal parts for its copies; the squares sum to that of the norm.
    """
    with Lifetime() as owned:
        torn, r = owned.own(Torn(A)), owned.own(b.duplicate())
        torn.residual(b, x, r)
        squares = torn.tear(r.array_r) ** 2 / torn.tear(torn.multiplicity())
        parts = join([squares[dofs].sum() for dofs in torn.subdomains], torn.comm)
    return np.sqrt(parts)


def _jump(torn: Torn) -> float:
    """Return the greatest ratio of the stiffnesses of the copies of a dof. Collective."""
    k, counts = torn.gather(torn.stiffness()), torn.multiplicity()
    first = (np.cumsum(counts) - counts)[counts > 0]
    least, most = np.minimum.reduceat(k, first), np.maximum.reduceat(k, first)
    jump = float(np.max(most / np.where(least > 0.0, least, np.inf), initial=1.0))
    return torn.comm.allreduce(jump, op=MPI.MAX)


def _motions(torn: Torn) -> str:
    """Say what the near kernel of the problem is."""
    near_kernel = torn.A.getNearNullSpace()
    modes = len(near_kernel.getVecs()) if near_kernel.handle else 1
    bs = torn.A.getBlockSize()
    if bs in (2, 3) and modes == bs * (bs + 1) // 2:
        return f"{bs} translations, {modes - bs} rotation{'s' if modes - bs > 1 else ''}"
    return "1 constant" if modes == 1 else f"{modes} constants"
