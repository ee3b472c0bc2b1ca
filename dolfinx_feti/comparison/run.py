# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI and other solvers on the same problem, one after the other (docs/comparing.md).

Residuals and differences are measured on the free dofs of the same assembled system. The direct
solution is the reference for the others if its residual is small. If that of a Cholesky
factorisation is too large, LU factors are tried.
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
    REFERENCE,
    SOLVERS,
    Solver,
    SolverKind,
    assembled_system,
    create_solver,
    is_marked_symmetric,
    relative_difference,
    relative_residual,
)
from dolfinx_feti.feti.solver import FETI
from dolfinx_feti.feti.subdomain.factors.petsc_solver import failure_message
from dolfinx_feti.problems.linear_problem import LinearProblem
from dolfinx_feti.problems.nonlinear_problem import NonlinearProblem
from dolfinx_feti.runtime.collective import error_message, on_all
from dolfinx_feti.runtime.cost import Cost, timed_solve
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.runtime.values import require_sequence, require_type
from dolfinx_feti.text_tables import Cell, json_value, text_table

__all__ = ["Comparison", "SolverResult", "compare"]

#: Headings of the columns of the table. The column of notes has none.
HEADINGS = (
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

#: ‖f − K x‖/‖f‖ up to which a direct solution is a reference: a choice. Factors of well-conditioned
#: systems leave 1e-14. A solution above the bound has lost most of its digits.
REFERENCE_RTOL = 1e-6

#: Residual over the tolerance above which a result gets a note. A Krylov method updates the norm by
#: which it stops, and rounding makes it differ a little from the norm that is measured here.
RESIDUAL_MARGIN = 1.1

#: PETSc's options by the name of the solver. None and an empty dict mean those of ``SOLVERS``.
Solvers = Mapping[str, Mapping[str, object] | None]


@dataclass(frozen=True, slots=True)
class SolverResult:
    """The result of one solver.

    Attributes:
        solver: Its name.
        cost: Its time, memory and iterations; None if PETSc raised an error.
        relative_residual: ‖f − K x‖/‖f‖ on the free dofs; nan without a solution.
        error_estimate: FETI's own estimate of the relative error of x; nan for other solvers.
        difference_to_direct: ‖x − x_d‖/‖x_d‖; nan if no direct solution x_d is accurate enough.
        note: Why the solver failed, that its residual is above the tolerance, or that LU replaced
            Cholesky factors; empty without such a remark.
    """

    solver: str
    cost: Cost | None
    relative_residual: float
    error_estimate: float
    difference_to_direct: float
    note: str

    @property
    def converged(self) -> bool:
        """Whether the solver converged."""
        return self.cost is not None and self.cost.converged_reason > 0


@dataclass(frozen=True, slots=True)
class Comparison:
    """Solvers on the same system; ``str`` prints the table. The same on all processes.

    Attributes:
        dofs: Size of the assembled system.
        subdomains: Their number over all processes.
        processes: Their number.
        rtol: Relative tolerance of the residual for the iterative solvers.
        results: One for each solver, in the order of the argument ``solvers``.
        left_out: Pairs of an omitted solver and the reason.
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
        for name, reason in self.left_out:
            note = f"left out: {reason}"
            records.append({"solver": name, **size, "converged": False, "note": note})
        for record in records:
            for key, value in record.items():
                record[key] = json_value(value)
        return records

    def __str__(self) -> str:
        """Return the table, followed by a line for each omitted solver."""
        rows = []
        for result in self.results:
            cells = _cells(result)
            rows.append([cells[heading] for heading in HEADINGS])
        lines = [
            f"{self.dofs} dofs, {self.subdomains} subdomains, {self.processes} process(es), "
            f"relative tolerance {self.rtol:g}",
            text_table(HEADINGS, rows),
        ]
        lines += [f"left out: {name}, {reason}" for name, reason in self.left_out]
        return "\n".join(lines)


def _cells(result: SolverResult) -> dict[str, Cell]:
    """Return the cells of a row of the table by the headings of their columns."""
    cost = result.cost
    cells: dict[str, Cell] = {
        "solver": result.solver,
        "iterations": None,
        "set-up [s]": None,
        "solve [s]": None,
        "memory [MiB]": None,
        "residual": _power_of_ten(result.relative_residual),
        "estimate": _power_of_ten(result.error_estimate),
        "difference": _power_of_ten(result.difference_to_direct),
        "": result.note,
    }
    if cost is not None:
        cells["iterations"] = cost.iterations
        cells["set-up [s]"] = _seconds(cost.seconds_setup, "set-up [s]")
        cells["solve [s]"] = _seconds(cost.seconds_solve, "solve [s]")
        if math.isfinite(cost.peak_mib):
            cells["memory [MiB]"] = round(cost.peak_mib)
    return cells


def _seconds(value: float, heading: str) -> str:
    """Format a time as text that is as wide as its heading, with the number on the right."""
    return f"{value:.2f}".rjust(len(heading))


def _power_of_ten(value: float) -> str:
    """Format an error with one digit, such as ``3e-9``; a dash for nan."""
    return "–" if math.isnan(value) else f"{value:.0e}".replace("e-0", "e-")


@dataclass(frozen=True, slots=True)
class _LinearSystem:
    """The linear system that all solvers solve.

    Attributes:
        A: Torn matrix.
        b: Right-hand side of the torn matrix.
        K: Assembled matrix, with unit rows and columns at the Dirichlet dofs.
        f: Right-hand side of K, zero at the Dirichlet dofs.
        dirichlet: Global numbers of the Dirichlet dofs that this process owns; None without any.
        rtol: Relative tolerance of iterative solvers.
    """

    A: PETSc.Mat
    b: PETSc.Vec
    K: PETSc.Mat
    f: PETSc.Vec
    dirichlet: PETSc.IS | None
    rtol: float

    @property
    def is_symmetric(self) -> bool:
        """Whether K is marked as symmetric."""
        return is_marked_symmetric(self.K)


@dataclass(frozen=True, slots=True)
class _Outcome:
    """The result of one solver, before it is compared with the others.

    Attributes:
        cost: Its time, memory and iterations; None if PETSc raised an error.
        x: The solution; None without one.
        note: Why it failed, or a remark on its solution; an empty string without one.
        proves_definite: Whether it is FETI and has proved that K is positive definite.
        error_estimate: FETI's estimate of the relative error of x.
    """

    cost: Cost | None
    x: PETSc.Vec | None
    note: str = ""
    proves_definite: bool = False
    error_estimate: float = np.nan


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

    Example::

        problem = LinearProblem(a, L, bcs=bcs, subdomains=4)
        comparison = compare(problem, ["feti", "mumps"])
        print(comparison)  # a table
        print(comparison.results[1].difference_to_direct)

    Args:
        problem: The problem.
        solvers: Names from :data:`~dolfinx_feti.comparison.solvers.SOLVERS`, or a dict of names and
            PETSc's options, such as ``{"feti": {}, "amg": {"pc_type": "hypre"}}``; empty options
            mean those of ``SOLVERS``. A solver whose options all begin with ``feti_`` is FETI with
            the problem's options, which these override, such as
            ``{"dual": {"feti_formulation": "dual"}}``.
        definite: Whether the assembled matrix is symmetric positive definite. This is passed to the
            solvers other than FETI. By default it is True if FETI is among the solvers and proves
            it.

    Returns:
        The comparison: ``print`` it, or use its ``records``. Solvers whose package PETSc was built
        without are listed as omitted. A solver that fails, or stays above the tolerance, has a
        note. The solution of the solver with the name ``mumps``, whatever its options, is the
        reference for the others if its residual is small.

    Raises:
        ValueError: A solver is unknown, there is none, its options mix those of FETI with others,
            processes have different solvers, or the right-hand side is zero.
    """
    require_type((LinearProblem, NonlinearProblem), problem=problem)
    comm = problem.decomposition.mesh.comm
    left_out: list[tuple[str, str]] = []
    present: list[Solver] = []
    for solver in _chosen_solvers(solvers, comm):
        package = solver.missing_package()
        if package:
            left_out.append((solver.name, f"this PETSc was built without {package}"))
        else:
            present.append(solver)
    with Lifetime() as owned:
        system = _assemble(problem, owned)
        feti = [solver for solver in present if solver.kind is SolverKind.FETI]
        others = [solver for solver in present if solver.kind is not SolverKind.FETI]
        outcomes = _solve_by_feti(problem, feti, system, owned)
        if definite is None:
            definite = any(outcome.proves_definite for outcome in outcomes.values())
        outcomes |= _solve_by_others(others, system, owned, is_definite=definite)
        ordered = {solver.name: outcomes[solver.name] for solver in present}
        return Comparison(
            dofs=system.f.getSize(),
            subdomains=comm.allreduce(problem.decomposition.count),
            processes=comm.size,
            rtol=system.rtol,
            results=_results(system, ordered),
            left_out=tuple(left_out),
        )


def _assemble(problem: LinearProblem | NonlinearProblem, owned: Lifetime) -> _LinearSystem:
    """Assemble the linear system of a problem. Collective.

    Args:
        problem: The problem, which keeps A.
        owned: Owner of b, K and f, which destroys them.

    Raises:
        ValueError: The right-hand side is zero.
    """
    A, b = problem.linear_system()
    owned.own(b)
    K, f = assembled_system(A, b)
    owned.own(K)
    owned.own(f)
    dirichlet = A.query("dirichlet")
    _set_zero(f, dirichlet)
    if not f.norm() > 0.0:
        raise ValueError(
            "The right-hand side of the problem is zero, and so is every solution: set a load "
            "before the solvers are compared."
        )
    # from a solver that is not set up: options in PETSc's database may change the tolerance
    rtol = owned.own(problem.create_linear_solver()).getTolerances()[0]
    return _LinearSystem(A, b, K, f, dirichlet, rtol)


def _solve_by_feti(
    problem: LinearProblem | NonlinearProblem,
    solvers: Sequence[Solver],
    system: _LinearSystem,
    owned: Lifetime,
) -> dict[str, _Outcome]:
    """Solve with FETI, under the options of each solver. Collective.

    Args:
        problem: The problem. The options of a solver are added to those of the problem, and take
            precedence.
        solvers: The solvers, all of the kind FETI.
        system: The linear system.
        owned: Owner of the solutions, which destroys them.

    Returns:
        Outcomes by the names of solvers.
    """
    outcomes = {}
    for solver in solvers:
        create = partial(problem.create_linear_solver, solver.options)
        outcomes[solver.name] = _solve(create, system.b, owned)
    return outcomes


def _solve_by_others(
    solvers: Sequence[Solver], system: _LinearSystem, owned: Lifetime, *, is_definite: bool
) -> dict[str, _Outcome]:
    """Solve with solvers other than FETI. Collective.

    Args:
        solvers: The solvers.
        system: The linear system.
        owned: Owner of the solutions, which destroys them.
        is_definite: Whether K is positive definite; ignored if it is not symmetric.

    Returns:
        Outcomes by the names of solvers.
    """
    is_spd = is_definite and system.is_symmetric
    if is_spd:
        system.K.setOption(PETSc.Mat.Option.SPD, True)
    outcomes = {}
    for solver in solvers:
        if solver.kind is SolverKind.REFERENCE:
            outcomes[solver.name] = _solve_directly(system.K, system.f, owned)
            continue
        create = partial(
            create_solver,
            system.A if solver.kind is SolverKind.TORN else system.K,
            solver.name,
            solver.options,
            rtol=system.rtol,
            symmetric=system.is_symmetric,
            definite=is_spd,
        )
        outcomes[solver.name] = _solve(create, system.f, owned)
    return outcomes


def _results(system: _LinearSystem, outcomes: Mapping[str, _Outcome]) -> tuple[SolverResult, ...]:
    """Compute the residual of each solution and its difference from the reference. Collective.

    Args:
        system: The linear system.
        outcomes: Outcomes by the names of solvers, in the order of the results.
    """
    residuals = {}
    for name, outcome in outcomes.items():
        residuals[name] = np.nan
        if outcome.x is not None:
            _set_zero(outcome.x, system.dirichlet)
            residuals[name] = relative_residual(system.K, system.f, outcome.x)
    reference = None
    if residuals.get(REFERENCE, np.nan) <= REFERENCE_RTOL:
        reference = outcomes[REFERENCE].x
    results = []
    for name, outcome in outcomes.items():
        note = outcome.note
        if residuals[name] > RESIDUAL_MARGIN * system.rtol and not note:
            note = f"the residual is above {system.rtol:.0e}"
        difference = np.nan
        if outcome.x is not None and reference is not None:
            difference = relative_difference(outcome.x, reference)
        results.append(
            SolverResult(
                solver=name,
                cost=outcome.cost,
                relative_residual=residuals[name],
                error_estimate=outcome.error_estimate,
                difference_to_direct=difference,
                note=note,
            )
        )
    return tuple(results)


def _solve(create: Callable[[], PETSc.KSP], b: PETSc.Vec, owned: Lifetime) -> _Outcome:
    """Solve with one solver; a failure becomes a note. Collective.

    Args:
        create: Creates the solver; the measured time includes it.
        b: Right-hand side.
        owned: Owner of the solution, which destroys it.
    """
    x = owned.own(b.duplicate())
    try:
        cost, ksp = on_all(lambda: timed_solve(create, b, x), b.comm.tompi4py())
    except (PETSc.Error, RuntimeError, ImportError) as error:
        return _Outcome(None, None, f"failed: {error_message(error)}")
    has_converged = cost.converged_reason > 0
    outcome = _Outcome(
        cost=cost,
        x=x if has_converged else None,
        note="" if has_converged else f"failed: {_failure(ksp)}",
    )
    feti = _feti_of(ksp)
    if feti is not None:
        # K is positive definite if K_ρ, D and K_II have no negative eigenvalue; the number for K_II
        # is None if it is not factored, and K_ρ then includes the interior
        inertia = feti.inertia
        is_proved = inertia is not None and inertia.is_definite and not inertia.interior
        outcome = replace(outcome, proves_definite=is_proved)
        if has_converged:
            outcome = replace(outcome, error_estimate=feti.error_estimate)
    ksp.destroy()
    return outcome


def _feti_of(ksp: PETSc.KSP) -> FETI | None:
    """Return the FETI solver of a KSP; None if it is another solver."""
    if ksp.getType() != PETSc.KSP.Type.PYTHON:
        return None
    context = ksp.getPythonContext()
    return context if isinstance(context, FETI) else None


def _failure(ksp: PETSc.KSP) -> str:
    """Return why a solver did not converge: its own message, or PETSc's name of the reason."""
    reason = ksp.getConvergedReason()
    feti = _feti_of(ksp)
    if feti is not None and feti.message:
        return feti.message
    pc = ksp.getPC()
    failed_setup = PETSc.KSP.ConvergedReason.DIVERGED_PCSETUP_FAILED
    if reason == failed_setup and pc.getType() in ("cholesky", "lu"):
        return failure_message(pc)
    for name, value in vars(PETSc.KSP.ConvergedReason).items():
        if value == reason and name.startswith("DIVERGED"):
            return name
    return str(reason)


def _solve_directly(K: PETSc.Mat, f: PETSc.Vec, owned: Lifetime) -> _Outcome:
    """Solve with MUMPS: with Cholesky factors if K is symmetric, with LU factors if they fail.

    Cholesky factors have failed if the residual is above ``REFERENCE_RTOL``.

    Args:
        K: Assembled matrix.
        f: Right-hand side.
        owned: Owner of the solutions, which destroys them.
    """

    def solve(*, symmetric: bool) -> tuple[_Outcome, float]:
        """Return the outcome and the relative residual, nan without a solution."""
        outcome = _solve(partial(create_solver, K, REFERENCE, symmetric=symmetric), f, owned)
        residual = np.nan if outcome.x is None else relative_residual(K, f, outcome.x)
        return outcome, residual

    notes = []
    is_symmetric = is_marked_symmetric(K)
    outcome, residual = solve(symmetric=is_symmetric)
    if is_symmetric and residual > REFERENCE_RTOL:
        notes.append(f"by LU, as Cholesky leaves a residual of {residual:.0e}")
        outcome, residual = solve(symmetric=False)
    if residual > REFERENCE_RTOL:
        notes.append(f"no reference: the residual is above {REFERENCE_RTOL:.0e}")
    if outcome.note:
        notes.append(outcome.note)
    return replace(outcome, note="; ".join(notes))


def _chosen_solvers(solvers: Sequence[str] | Solvers, comm: MPI.Comm) -> list[Solver]:
    """Return the solvers that a user has chosen, in this order. Collective.

    Raises:
        ValueError: A solver is unknown, there is none, processes have different ones, or the
            options of one mix those of FETI with others.
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
    options_of_user = solvers if isinstance(solvers, Mapping) else {}
    unknown = [name for name in names if name not in SOLVERS and not options_of_user.get(name)]
    if unknown or not names:
        cause = f"solvers has {unknown[0]!r}" if unknown else "solvers is empty"
        known = ", ".join(SOLVERS)
        raise ValueError(
            f"{cause}: choose from {known}, or give a dict of names and PETSc's options."
        )
    return [Solver(name, options_of_user.get(name) or SOLVERS[name]) for name in names]


def _set_zero(x: PETSc.Vec, dofs: PETSc.IS | None) -> None:
    """Set the entries of a vector at global dofs to zero. Collective."""
    if dofs is not None:
        indices = dofs.getIndices()
        x.setValues(indices, np.zeros(len(indices)))
    x.assemble()
