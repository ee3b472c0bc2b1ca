# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI and other solvers on the same problem, one after the other (docs/comparing.md).

Residuals and differences are measured on the free dofs of the same assembled system. The direct
solution is the reference for the others if its residual is small; if that of Cholesky factors is
not, LU factors are used.
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
    is_feti,
    missing,
    relative_difference,
    relative_residual,
    takes_torn,
)
from dolfinx_feti.feti.solver import FETI
from dolfinx_feti.feti.subdomain.factors.petsc_solver import failure_message
from dolfinx_feti.mechanics.values import require_sequence, require_type
from dolfinx_feti.problems.linear_problem import LinearProblem
from dolfinx_feti.problems.nonlinear_problem import NonlinearProblem
from dolfinx_feti.runtime.collective import error_message, on_all
from dolfinx_feti.runtime.cost import Cost, timed_solve
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.text_tables import Cell, json_value, text_table

__all__ = ["Comparison", "SolverResult", "compare"]

#: Columns of the table; the last one is for notes.
HEAD = (
    "solver",
    "iterations",
    "set-up [s]",
    "solve [s]",
    "memory [MiB]",
    "residual",
    "estimate",
    "difference",
    "",
)

#: The solver whose solution is the reference.
DIRECT = "mumps"

#: ‖f − K x‖/‖f‖ up to which a direct solution is a reference. A bound, not a measurement: factors
#: of well-conditioned systems leave 1e-14, those that this refuses have lost most digits.
REFERENCE_RTOL = 1e-6

#: Residual over the tolerance up to which there is no note: Krylov methods stop by a norm that
#: rounding separates a little from the one that is measured here.
RESIDUAL_MARGIN = 1.1

#: Options of PETSc by the name of the solver.
Solvers = Mapping[str, Mapping[str, object] | None]


@dataclass(frozen=True, slots=True)
class SolverResult:
    """One solver's part in a comparison.

    Attributes:
        solver: Its name.
        cost: What it took; None if PETSc raised an error.
        relative_residual: ‖f − K x‖/‖f‖ on the free dofs; nan without a solution.
        error_estimate: FETI's own estimate of the relative error of x; nan of other solvers.
        difference_to_direct: ‖x − x_d‖/‖x_d‖; nan without a direct solution that is a reference.
        note: Why the solver failed or is less accurate than requested; or an empty string.
    """

    solver: str
    cost: Cost | None
    relative_residual: float
    error_estimate: float
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
        results: One for each solver, in the order of the user.
        left_out: Name of each solver that was omitted, and the reason.
    """

    dofs: int
    subdomains: int
    processes: int
    rtol: float
    results: tuple[SolverResult, ...]
    left_out: tuple[tuple[str, str], ...]

    @property
    def records(self) -> list[dict[str, object]]:
        """One record for each solver, ready for JSON; unknown values are None."""
        size = {"dofs": self.dofs, "subdomains": self.subdomains, "processes": self.processes}
        records: list[dict[str, object]] = []
        for result in self.results:
            record: dict[str, object] = {"solver": result.solver, **size, "rtol": self.rtol}
            record["converged"] = result.converged
            if result.cost is not None:
                record |= asdict(result.cost)
            record["relative_residual"] = result.relative_residual
            record["note"] = result.note
            record["error_estimate"] = result.error_estimate
            record["difference_to_direct"] = result.difference_to_direct
            records.append(record)
        for name, why in self.left_out:
            records.append({"solver": name, **size, "converged": False, "note": f"left out: {why}"})
        for record in records:
            for key, value in record.items():
                record[key] = json_value(value)
        return records

    def __str__(self) -> str:
        """Return the table, and a line for each omitted solver."""
        lines = [
            f"{self.dofs} dofs, {self.subdomains} subdomains, {self.processes} process(es), "
            f"relative tolerance {self.rtol:g}",
            text_table(HEAD, [_row(s) for s in self.results]),
        ]
        lines += [f"left out: {name}, {why}" for name, why in self.left_out]
        return "\n".join(lines)


def _row(result: SolverResult) -> list[Cell]:
    """Return a row of the table."""
    cost = result.cost
    row: list[Cell] = [result.solver]
    if cost is None:
        row += [None, None, None, None]
    else:
        row.append(cost.iterations)
        row.append(f"{cost.seconds_setup:.2f}".rjust(len("set-up [s]")))
        row.append(f"{cost.seconds_solve:.2f}".rjust(len("solve [s]")))
        row.append(round(cost.peak_mib) if math.isfinite(cost.peak_mib) else None)
    row.append(_power_of_ten(result.relative_residual))
    row.append(_power_of_ten(result.error_estimate))
    row.append(_power_of_ten(result.difference_to_direct))
    row.append(result.note)
    return row


def _power_of_ten(value: float) -> str:
    """Format an error with one digit, such as ``3e-9``; a dash for nan."""
    return "–" if math.isnan(value) else f"{value:.0e}".replace("e-0", "e-")


@dataclass(frozen=True, slots=True)
class _Outcome:
    """The result of one solver, before it is compared with the others."""

    cost: Cost | None  #: None if PETSc raised an error
    x: PETSc.Vec | None  #: The solution; None without one
    note: str = ""
    definite: bool = False  #: Whether FETI has proved that K is positive definite
    error_estimate: float = np.nan  #: FETI's estimate of the relative error of x


def compare(
    problem: LinearProblem | NonlinearProblem,
    solvers: Sequence[str] | Solvers = tuple(SOLVERS),
    *,
    definite: bool | None = None,
) -> Comparison:
    """Solve the linear system of a problem with several solvers, and measure each. Collective.

    For a nonlinear problem it is the system of the next Newton step, at the current state and load.
    The state does not change; the problem's matrix is assembled again. Each solver is set up from
    scratch, and all iterative ones have the relative tolerance of the problem's FETI.

    Args:
        problem: The problem.
        solvers: Names from :data:`~dolfinx_feti.comparison.solvers.SOLVERS`, or a dict of names and
            PETSc's options, such as ``{"feti": {}, "amg": {"pc_type": "hypre"}}``; empty options
            mean those of ``SOLVERS``. A solver whose options all begin with ``feti_`` is FETI with
            these in place of the problem's own, such as
            ``{"dual": {"feti_formulation": "dual"}}``.
        definite: Whether the assembled matrix is symmetric positive definite, which other solvers
            use; if not given, True if FETI is among the solvers and proves it.

    Returns:
        The comparison: ``print`` it, or use its ``records``. It lists solvers that PETSc was built
        without as omitted; a solver that fails, or stays above the tolerance, has a note.

    Raises:
        ValueError: A solver is unknown, processes have different solvers, or the right-hand side is
            zero.
    """
    require_type((LinearProblem, NonlinearProblem), problem=problem)
    comm = problem.decomposition.mesh.comm
    left_out: list[tuple[str, str]] = []
    present: dict[str, Mapping[str, object]] = {}
    for name, options in _checked(solvers, comm).items():
        why = missing(options)
        if why:
            left_out.append((name, why))
        else:
            present[name] = options
    with Lifetime() as owned:
        A, b = problem.linear_system()
        K, f = assembled_system(A, owned.own(b))
        owned.own(K)
        owned.own(f)
        dirichlet = A.query("dirichlet")
        _set_zero(f, dirichlet)
        if not f.norm() > 0.0:
            raise ValueError(
                "The right-hand side of the problem is zero, and so is every solution: set a load "
                "before the solvers are compared."
            )
        rtol = owned.own(problem.create_linear_solver()).getTolerances()[0]
        outcomes: dict[str, _Outcome] = {}
        for name, options in present.items():  # FETI first: it proves whether K is definite
            if is_feti(name, options):
                create = partial(problem.create_linear_solver, options)
                outcomes[name] = _solve(create, b, owned)
        if definite is None:
            definite = any(outcome.definite for outcome in outcomes.values())
        symmetric = bool(all(K.isSymmetricKnown()))
        marks = {"symmetric": symmetric, "definite": bool(definite) and symmetric}
        if marks["definite"]:
            K.setOption(PETSc.Mat.Option.SPD, True)
        for name, options in present.items():
            if name == DIRECT and options is SOLVERS[DIRECT]:
                outcomes[name] = _solve_directly(K, f, owned)
            elif name not in outcomes:
                M = A if takes_torn(name, options) else K
                create = partial(create_solver, M, name, options, rtol=rtol, **marks)
                outcomes[name] = _solve(create, f, owned)
        errors = {}
        for name, outcome in outcomes.items():
            if outcome.x is not None:
                _set_zero(outcome.x, dirichlet)
                errors[name] = relative_residual(K, f, outcome.x)
        direct = outcomes[DIRECT].x if errors.get(DIRECT, np.inf) <= REFERENCE_RTOL else None
        results = []
        for name in present:
            outcome = outcomes[name]
            error = errors.get(name, np.nan)
            note = outcome.note
            if error > RESIDUAL_MARGIN * rtol and not note:
                note = f"the residual is above {rtol:.0e}"
            difference = np.nan
            if outcome.x is not None and direct is not None:
                difference = relative_difference(outcome.x, direct)
            results.append(
                SolverResult(
                    solver=name,
                    cost=outcome.cost,
                    relative_residual=error,
                    error_estimate=outcome.error_estimate,
                    difference_to_direct=difference,
                    note=note,
                )
            )
        return Comparison(
            dofs=f.getSize(),
            subdomains=comm.allreduce(problem.decomposition.count),
            processes=comm.size,
            rtol=rtol,
            results=tuple(results),
            left_out=tuple(left_out),
        )


def _solve(create: Callable[[], PETSc.KSP], b: PETSc.Vec, owned: Lifetime) -> _Outcome:
    """Solve with one solver; a failure becomes a note. Collective.

    Args:
        create: Creates the solver and sets it up.
        b: Right-hand side.
        owned: Destroys the solution in the end.
    """
    x = owned.own(b.duplicate())
    try:
        cost, ksp = on_all(lambda: timed_solve(create, b, x), b.comm.tompi4py())
    except (PETSc.Error, RuntimeError, ImportError) as error:
        return _Outcome(None, None, f"failed: {error_message(error).splitlines()[-1]}")
    why = _name(cost.converged_reason)
    definite = False
    pc = ksp.getPC()
    error_estimate = np.nan
    if ksp.getType() == PETSc.KSP.Type.PYTHON and isinstance(ksp.getPythonContext(), FETI):
        feti = ksp.getPythonContext()
        why = feti.message or why
        inertia = feti.inertia
        definite = inertia is not None and inertia.is_definite and not inertia.interior
        error_estimate = feti.error_estimate
    failed = PETSc.KSP.ConvergedReason.DIVERGED_PCSETUP_FAILED
    if cost.converged_reason == failed and pc.getType() in ("cholesky", "lu"):
        why = failure_message(pc)
    ksp.destroy()
    if cost.converged_reason > 0:
        return _Outcome(cost, x, definite=definite, error_estimate=error_estimate)
    return _Outcome(cost, None, f"failed: {why}", definite)


def _solve_directly(K: PETSc.Mat, f: PETSc.Vec, owned: Lifetime) -> _Outcome:
    """Solve by MUMPS: a symmetric system by Cholesky, then by LU if the residual is too large.

    Args:
        K: Assembled matrix.
        f: Right-hand side.
        owned: Destroys the solutions in the end.
    """
    notes = []
    factorisations = (True, False) if all(K.isSymmetricKnown()) else (False,)
    for symmetric in factorisations:
        outcome = _solve(partial(create_solver, K, symmetric=symmetric), f, owned)
        error = np.nan if outcome.x is None else relative_residual(K, f, outcome.x)
        if outcome.x is None or error <= REFERENCE_RTOL:
            break
        if symmetric:
            notes.append(f"by LU, as Cholesky leaves a residual of {error:.0e}")
        else:
            notes.append(f"no reference: the residual is above {REFERENCE_RTOL:.0e}")
    if outcome.note:
        notes.append(outcome.note)
    return replace(outcome, note="; ".join(notes))


def _name(reason: int) -> str:
    """Return PETSc's name of a negative converged reason."""
    for name, value in vars(PETSc.KSP.ConvergedReason).items():
        if value == reason and name.startswith("DIVERGED"):
            return name
    return str(reason)


def _checked(solvers: Sequence[str] | Solvers, comm: MPI.Comm) -> dict[str, Mapping[str, object]]:
    """Return the options of each solver. Collective.

    Raises:
        ValueError: A solver is unknown, there is none, or processes have different ones.
    """
    if not isinstance(solvers, Mapping):
        require_sequence(str, solvers=solvers)
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


def _set_zero(x: PETSc.Vec, dofs: PETSc.IS | None) -> None:
    """Set the entries of a vector at global dofs to zero. Collective."""
    if dofs is not None:
        indices = dofs.getIndices()
        x.setValues(indices, np.zeros(len(indices)))
    x.assemble()
