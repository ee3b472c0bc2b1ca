# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""FETI and other solvers on a problem of one's own, one after the other.

FETI and BDDC get the torn matrix, the others the assembled one,

.. math:: K_{FF}\, x_F = f_F,

with unit rows for the Dirichlet dofs D; prescribed values are on the right-hand side, and what is
measured are the free dofs F. Torn and assembled matrix exist before a solver begins.

The direct solution is the reference of the others only if its own residual is small; otherwise the
matrix is factored once more, by LU, and without success there is no reference.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.comparison.assembled import (
    assembled_system,
    create_mumps,
    relative_difference,
    relative_residual,
)
from dolfinx_feti.comparison.result import Comparison, Solved
from dolfinx_feti.comparison.solvers import create_bddc, create_gamg, create_hypre, missing
from dolfinx_feti.feti.solver import FETI
from dolfinx_feti.problems.linear_problem import LinearProblem
from dolfinx_feti.problems.nonlinear_problem import NonlinearProblem
from dolfinx_feti.runtime.collective import on_all, reason
from dolfinx_feti.runtime.cost import Cost, measure

__all__ = ["SOLVERS", "compare"]

SOLVERS = ("feti", "mumps", "gamg", "hypre", "bddc")
DIRECT = "mumps"

#: ‖f − K x‖/‖f‖ up to which a direct solution is a reference.
REFERENCE = 1e-6

Outcome = tuple[Cost | None, PETSc.Vec | None, str]


def compare(
    problem: LinearProblem | NonlinearProblem,
    solvers: Sequence[str] = ("feti", "mumps", "gamg", "bddc"),
    *,
    definite: bool | None = None,
) -> Comparison:
    """Solve the linear system of a problem with several solvers, and measure each.

    Of a nonlinear problem it is the system of the next Newton step, at the present state and load.
    The state stays as it is; the problem's matrix is assembled anew. Each solver is a new one, with
    nothing set up before, and all iterative ones have the relative tolerance of the problem's FETI.

    Args:
        problem: The problem.
        solvers: Names out of ``feti``, ``mumps``, ``gamg``, ``hypre`` and ``bddc``.
        definite: Whether the assembled matrix is symmetric positive definite, which spares MUMPS
            and GAMG some work; by default if FETI is asked for and has proved it.

    Returns:
        The comparison: ``print`` it, or take its ``records``. Solvers that this PETSc lacks are
        left out and named; one that fails has a note.

    Raises:
        TypeError: The problem is none of this package's.
        ValueError: Unknown solvers, or not the same ones on all processes; nothing loads the
            problem.

    Note:
        Collective; raises on all processes.
    """
    if not isinstance(problem, (LinearProblem, NonlinearProblem)):
        raise TypeError(
            f"problem is a {type(problem).__name__}: give a dolfinx_feti.LinearProblem or a "
            "dolfinx_feti.NonlinearProblem."
        )
    comm = problem.decomposition.mesh.comm
    names = _checked(solvers, comm)
    left_out = tuple((name, why) for name in names if (why := missing(name)))
    A, b = problem.linear_system()
    K, f = assembled_system(A, b)
    dirichlet = A.query("dirichlet")
    _put_zero(f, dirichlet)
    try:
        if not f.norm() > 0.0:
            raise ValueError(
                "The right-hand side of the problem is zero, and so is every solution: set a load "
                "before the solvers are compared."
            )
        ksp = problem.create_linear_solver()
        rtol = ksp.getTolerances()[0]
        ksp.destroy()
        solutions = _solve_all(
            [name for name in names if not missing(name)],
            problem.create_linear_solver,
            (A, b),
            (K, f),
            rtol=rtol,
            definite=definite,
        )
        x_direct = solutions[DIRECT][1] if DIRECT in solutions else None
        if x_direct is not None and not relative_residual(K, f, x_direct) <= REFERENCE:
            x_direct = None
        solved = []
        for name, (cost, x, note) in solutions.items():
            error = difference = np.nan
            if x is not None:
                _put_zero(x, dirichlet)
                error = relative_residual(K, f, x)
                if x_direct is not None:
                    difference = relative_difference(x, x_direct)
            solved.append(Solved(name, cost, error, difference, note))
        for _, x, _ in solutions.values():
            if x is not None:
                x.destroy()
        return Comparison(
            dofs=f.getSize(),
            subdomains=comm.allreduce(problem.decomposition.count),
            processes=comm.size,
            rtol=rtol,
            solved=tuple(sorted(solved, key=lambda s: names.index(s.solver))),
            left_out=left_out,
        )
    finally:
        for owned in (K, f, b):
            owned.destroy()


def _solve_all(
    names: Sequence[str],
    create_feti: Callable[[], PETSc.KSP],
    torn: tuple[PETSc.Mat, PETSc.Vec],
    assembled: tuple[PETSc.Mat, PETSc.Vec],
    *,
    rtol: float,
    definite: bool | None,
) -> dict[str, Outcome]:
    """Solve with each solver, FETI first: it knows whether the matrix is definite."""
    (A, b), (K, f) = torn, assembled
    symmetric = bool(all(K.isSymmetricKnown()))
    solutions: dict[str, Outcome] = {}
    if "feti" in names:
        contexts: list[FETI] = []

        def create() -> PETSc.KSP:
            ksp = create_feti()
            contexts.append(ksp.getPythonContext())
            return ksp

        solutions["feti"] = _solve(create, b, lambda: contexts[0].message)
        if definite is None:
            definite = symmetric and _proved_definite(contexts[0])
    definite = bool(definite)
    if definite:
        K.setOption(PETSc.Mat.Option.SPD, True)
    others: dict[str, Callable[[], PETSc.KSP]] = {
        "gamg": lambda: create_gamg(K, rtol=rtol),
        "hypre": lambda: create_hypre(K, rtol=rtol),
        "bddc": lambda: create_bddc(A, rtol=rtol, symmetric=symmetric, definite=definite),
    }
    for name in names:
        if name == DIRECT:
            solutions[name] = _solve_directly(K, f)
        elif name in others:
            solutions[name] = _solve(others[name], f, lambda: "")
    return solutions


def _solve(create: Callable[[], PETSc.KSP], b: PETSc.Vec, message: Callable[[], str]) -> Outcome:
    """Solve with one solver; a failure becomes a note."""
    try:
        cost, x = on_all(lambda: measure(create, b), b.comm.tompi4py())
    except PETSc.Error as error:
        return None, None, f"failed: {reason(error).splitlines()[-1]}"
    if cost.converged_reason > 0:
        return cost, x, ""
    x.destroy()
    return cost, None, f"failed: {message() or _name(cost.converged_reason)}"


def _solve_directly(K: PETSc.Mat, f: PETSc.Vec) -> Outcome:
    """Solve by MUMPS; once more, by LU, if what Cholesky leaves is too much."""
    outcome = _solve(lambda: create_mumps(K), f, lambda: "")
    cost, x, note = outcome
    if x is None:
        return outcome
    error = relative_residual(K, f, x)
    if not error <= REFERENCE and all(K.isSymmetricKnown()):
        x.destroy()
        note = f"by LU, as Cholesky leaves a residual of {error:.0e}"
        cost, x, failure = _solve(lambda: create_mumps(K, symmetric=False), f, lambda: "")
        if x is None:
            return cost, x, f"{note}; {failure}"
        error = relative_residual(K, f, x)
    if not error <= REFERENCE:
        nothing = f"no reference: the residual is above {REFERENCE:.0e}"
        note = f"{note}; {nothing}" if note else nothing
    return cost, x, note


def _proved_definite(feti: FETI) -> bool:
    """Tell whether the subdomains of a solver prove the assembled matrix to be definite."""
    inertia = feti.inertia
    return inertia is not None and inertia.definite and not inertia.interior


def _name(reason: int) -> str:
    """Return PETSc's name of a reason why a Krylov method ended."""
    names = vars(PETSc.KSP.ConvergedReason).items()
    return next((k for k, v in names if v == reason and k.startswith("DIVERGED")), str(reason))


def _checked(solvers: Sequence[str], comm: MPI.Comm) -> list[str]:
    """Check the names of solvers, and that all processes have the same.

    Raises:
        ValueError: Some are unknown, there are none, or they differ.
    """
    names = solvers if isinstance(solvers, str) else list(dict.fromkeys(solvers))
    everywhere = comm.allgather(names)
    for rank, other in enumerate(everywhere):
        if other != everywhere[0]:
            raise ValueError(
                f"solvers is {everywhere[0]!r} on process 0 and {other!r} on process {rank}: give "
                "the same on all."
            )
    if isinstance(names, str):
        raise ValueError(f"solvers is {names!r}: put the names in a list, solvers=[{names!r}].")
    unknown = [name for name in names if name not in SOLVERS]
    if unknown or not names:
        what = f"solvers has {unknown[0]!r}" if unknown else "solvers is empty"
        raise ValueError(f"{what}: choose from {', '.join(SOLVERS)}.")
    return names


def _put_zero(x: PETSc.Vec, dofs: PETSc.IS | None) -> None:
    """Let a vector be zero on some global dofs."""
    if dofs is not None:
        indices = dofs.getIndices()
        x.setValues(indices, np.zeros(len(indices)))
    x.assemble()
