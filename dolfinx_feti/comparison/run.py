# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI and other solvers on a problem of one's own, one after the other (docs/comparing.md).

Residuals and differences are measured on the free dofs, in the same system for all. The direct
solution is the reference of the others if its own residual is small, by LU if need be.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.comparison.solvers import (
    SOLVERS,
    assembled_system,
    create_solver,
    missing,
    relative_difference,
    relative_residual,
    takes_torn,
)
from dolfinx_feti.feti.solver import FETI
from dolfinx_feti.feti.subdomain.factors.direct import factor_failure
from dolfinx_feti.problems.linear_problem import LinearProblem
from dolfinx_feti.problems.nonlinear_problem import NonlinearProblem
from dolfinx_feti.runtime.collective import on_all, reason
from dolfinx_feti.runtime.cost import Cost, timed_solve
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.runtime.tables import Cell, json_value, table

__all__ = ["Comparison", "SolverResult", "compare"]

HEAD = (
    "solver", "iterations", "set-up [s]", "solve [s]", "memory [MiB]", "residual", "difference", "",
)  # fmt: skip
DIRECT = "mumps"

#: ‖f − K x‖/‖f‖ up to which a direct solution is a reference.
REFERENCE = 1e-6

#: By how much the residual may exceed the tolerance without a note.
EXCESS = 1.1

#: Options of PETSc by the name of the solver.
Solvers = Mapping[str, Mapping[str, object] | None]


@dataclass(frozen=True, slots=True)
class SolverResult:
    """One solver's part in a comparison.

    Attributes:
        solver: Its name.
        cost: What it took; None if PETSc raised an error.
        relative_residual: ‖f − K x‖/‖f‖ on the free dofs; nan without a solution.
        difference_to_direct: ‖x − x_d‖/‖x_d‖; nan without a direct solution that is a reference.
        note: Why it failed or is less than was asked for; or an empty string.
    """

    solver: str
    cost: Cost | None
    relative_residual: float
    difference_to_direct: float
    note: str

    @property
    def converged(self) -> bool:
        """Whether there is a solution."""
        return self.cost is not None and self.cost.converged_reason > 0


@dataclass(frozen=True, slots=True)
class Comparison:
    """Solvers on the same system; ``str`` prints the table. The same on all processes.

    Attributes:
        dofs: Size of the assembled system.
        subdomains: Their number over all processes.
        processes: Their number.
        rtol: Factor by which the iterative solvers had to lower the residual.
        results: Of the solvers, in the order of the user.
        left_out: Name of each solver that was left out, and why.
    """

    dofs: int
    subdomains: int
    processes: int
    rtol: float
    results: tuple[SolverResult, ...]
    left_out: tuple[tuple[str, str], ...]

    @property
    def records(self) -> list[dict[str, object]]:
        """One record for each solver, to be written as JSON; None for what is not known."""
        size = {"dofs": self.dofs, "subdomains": self.subdomains, "processes": self.processes}
        records: list[dict[str, object]] = [
            {"solver": s.solver, **size, "rtol": self.rtol, "converged": s.converged}
            | ({} if s.cost is None else asdict(s.cost))
            | {"relative_residual": s.relative_residual, "note": s.note}
            | {"difference_to_direct": s.difference_to_direct}
            for s in self.results
        ]
        for name, why in self.left_out:
            records.append({"solver": name, **size, "converged": False, "note": f"left out: {why}"})
        return [{k: json_value(v) for k, v in record.items()} for record in records]

    def __str__(self) -> str:
        """Return the table, and who was left out."""
        lines = [
            f"{self.dofs} dofs, {self.subdomains} subdomains, {self.processes} process(es), "
            f"relative tolerance {self.rtol:g}",
            table(HEAD, [_row(s) for s in self.results]),
        ]
        lines += [f"left out: {name}, {why}" for name, why in self.left_out]
        return "\n".join(lines)


def _row(result: SolverResult) -> list[Cell]:
    """Return a row of the table."""
    cost, figures = result.cost, list[Cell]([None] * 4)
    if cost is not None:
        times = zip(HEAD[2:], (cost.seconds_setup, cost.seconds_solve), strict=False)
        figures = [cost.iterations, *(f"{t:.2f}".rjust(len(head)) for head, t in times)]
        figures.append(round(cost.peak_mib) if math.isfinite(cost.peak_mib) else None)
    errors = map(_short, (result.relative_residual, result.difference_to_direct))
    return [result.solver, *figures, *errors, result.note]


def _short(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.0e}".replace("e-0", "e-")


@dataclass(frozen=True, slots=True)
class _Outcome:
    """What came of a solver: cost, solution if any, a note, and whether K is proved definite."""

    cost: Cost | None
    x: PETSc.Vec | None
    note: str = ""
    definite: bool = False


def compare(
    problem: LinearProblem | NonlinearProblem,
    solvers: Sequence[str] | Solvers = tuple(SOLVERS),
    *,
    definite: bool | None = None,
) -> Comparison:
    """Solve the linear system of a problem with several solvers, and measure each. Collective.

    Of a nonlinear problem it is the system of the next Newton step, at the present state and load.
    The state stays as it is; the problem's matrix is assembled anew. Each solver is a new one, with
    nothing set up before, and all iterative ones have the relative tolerance of the problem's FETI.

    Args:
        problem: The problem.
        solvers: Names out of :data:`~dolfinx_feti.comparison.SOLVERS`, or a dict of names and
            PETSc's options, such as ``{"feti": {}, "amg": {"pc_type": "hypre"}}``; without options
            they are those of that table.
        definite: Whether the assembled matrix is symmetric positive definite, which spares other
            solvers some work; by default if FETI is asked for and has proved it.

    Returns:
        The comparison: ``print`` it, or take its ``records``. Solvers that PETSc was built without
        are left out and named; one that fails, or stays above the tolerance, has a note.

    Raises:
        ValueError: Unknown solvers, or not the same ones on all processes; nothing loads the
            problem.
    """
    comm = problem.decomposition.mesh.comm
    wanted = _checked(solvers, comm)
    left_out = tuple((name, why) for name, options in wanted.items() if (why := missing(options)))
    present = {name: options for name, options in wanted.items() if name not in dict(left_out)}
    with Lifetime() as owned:
        A, b = problem.linear_system()
        K, f = map(owned.own, assembled_system(A, owned.own(b)))
        dirichlet = A.query("dirichlet")
        _put_zero(f, dirichlet)
        if not f.norm() > 0.0:
            raise ValueError(
                "The right-hand side of the problem is zero, and so is every solution: set a load "
                "before the solvers are compared."
            )
        rtol = owned.own(problem.create_linear_solver()).getTolerances()[0]
        outcomes: dict[str, _Outcome] = {}
        if "feti" in present:  # first: it knows whether the matrix is definite
            outcomes["feti"] = _solve(problem.create_linear_solver, b, owned)
            definite = outcomes["feti"].definite if definite is None else definite
        symmetric = bool(all(K.isSymmetricKnown()))
        marks = {"symmetric": symmetric, "definite": bool(definite) and symmetric}
        if marks["definite"]:
            K.setOption(PETSc.Mat.Option.SPD, True)
        for name, options in present.items():
            if name == DIRECT and options is SOLVERS[DIRECT]:
                outcomes[name] = _solve_directly(K, f, owned)
            elif name != "feti":
                M = A if takes_torn(name, options) else K
                create = partial(create_solver, M, name, options, rtol=rtol, **marks)
                outcomes[name] = _solve(create, f, owned)
        errors = {}
        for name, outcome in outcomes.items():
            if outcome.x is not None:
                _put_zero(outcome.x, dirichlet)
                errors[name] = relative_residual(K, f, outcome.x)
        direct = outcomes[DIRECT].x if errors.get(DIRECT, np.inf) <= REFERENCE else None
        results = []
        for name in present:
            outcome, error = outcomes[name], errors.get(name, np.nan)
            above = error > EXCESS * rtol and not outcome.note
            note = f"the residual is above {rtol:.0e}" if above else outcome.note
            known = outcome.x is not None and direct is not None
            difference = relative_difference(outcome.x, direct) if known else np.nan
            results.append(SolverResult(name, outcome.cost, error, difference, note))
        return Comparison(
            dofs=f.getSize(),
            subdomains=comm.allreduce(problem.decomposition.count),
            processes=comm.size,
            rtol=rtol,
            results=tuple(results),
            left_out=left_out,
        )


def _solve(create: Callable[[], PETSc.KSP], b: PETSc.Vec, owned: Lifetime) -> _Outcome:
    """Solve with one solver; a failure becomes a note."""
    x = owned.own(b.duplicate())
    try:
        cost, ksp = on_all(lambda: timed_solve(create, b, x), b.comm.tompi4py())
    except (PETSc.Error, RuntimeError, ImportError) as error:
        return _Outcome(None, None, f"failed: {reason(error).splitlines()[-1]}")
    why, definite, pc = _name(cost.converged_reason), False, ksp.getPC()
    if ksp.getType() == PETSc.KSP.Type.PYTHON and isinstance(ksp.getPythonContext(), FETI):
        feti = ksp.getPythonContext()
        why, inertia = feti.message or why, feti.inertia
        definite = inertia is not None and inertia.definite and not inertia.interior
    failed = PETSc.KSP.ConvergedReason.DIVERGED_PCSETUP_FAILED
    if cost.converged_reason == failed and pc.getType() in ("cholesky", "lu"):
        why = factor_failure(pc)
    ksp.destroy()
    if cost.converged_reason > 0:
        return _Outcome(cost, x, definite=definite)
    return _Outcome(cost, None, f"failed: {why}", definite)


def _solve_directly(K: PETSc.Mat, f: PETSc.Vec, owned: Lifetime) -> _Outcome:
    """Solve by MUMPS; once more, by LU, if what Cholesky leaves is too much."""
    notes = []
    for symmetric in (True, False) if all(K.isSymmetricKnown()) else (False,):
        outcome = _solve(partial(create_solver, K, symmetric=symmetric), f, owned)
        error = np.nan if outcome.x is None else relative_residual(K, f, outcome.x)
        if outcome.x is None or error <= REFERENCE:
            break
        if symmetric:
            notes.append(f"by LU, as Cholesky leaves a residual of {error:.0e}")
        else:
            notes.append(f"no reference: the residual is above {REFERENCE:.0e}")
    return replace(outcome, note="; ".join(filter(None, (*notes, outcome.note))))


def _name(reason: int) -> str:
    """Return PETSc's name of a reason why a Krylov method ended."""
    names = vars(PETSc.KSP.ConvergedReason).items()
    return next((k for k, v in names if v == reason and k.startswith("DIVERGED")), str(reason))


def _checked(solvers: Sequence[str] | Solvers, comm: MPI.Comm) -> dict[str, Mapping[str, object]]:
    """Return the options of each solver, and check that all processes have the same solvers."""
    names = list(dict.fromkeys(solvers))
    everywhere = comm.allgather(names)
    for rank, other in enumerate(everywhere):
        if other != everywhere[0]:
            raise ValueError(
                f"solvers is {everywhere[0]!r} on process 0 and {other!r} on process {rank}: give "
                "the same on all."
            )
    given = solvers if isinstance(solvers, Mapping) else {}
    unknown = [name for name in names if name not in SOLVERS and not given.get(name)]
    if unknown or not names:
        what = f"solvers has {unknown[0]!r}" if unknown else "solvers is empty"
        known = ", ".join(SOLVERS)
        raise ValueError(
            f"{what}: choose from {known}, or give a dict of names and PETSc's options."
        )
    return {name: given.get(name) or SOLVERS[name] for name in names}


def _put_zero(x: PETSc.Vec, dofs: PETSc.IS | None) -> None:
    """Let a vector be zero on some global dofs."""
    if dofs is not None:
        indices = dofs.getIndices()
        x.setValues(indices, np.zeros(len(indices)))
    x.assemble()
