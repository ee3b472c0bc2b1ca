# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Direct solvers of PETSc, as a PC or a KSP: retries with more work space, inertia, failures.

The solver is MUMPS unless the options name another one. Its control parameters (ICNTL, CNTL) and
reports (INFOG) are numbered as in the MUMPS Users' Guide.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from petsc4py import PETSc

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.subdomain.factors.protocol import FactorInertia
from dolfinx_feti.feti.subsolver_options import DirectOptions

#: Work space of MUMPS above its estimate [%], in consecutive attempts. Pivots that are delayed for
#: stability need it. Most matrices delay none: 10 % suffices, and saves memory compared with
#: MUMPS's own default of 20 to 30 %. The last value bounds the memory at eleven times the estimate.
WORK_SPACE = (10, 50, 200, 1000)

#: A direct solver: the PC of a subdomain, or the KSP of the coarse problem.
Solver = TypeVar("Solver", PETSc.PC, PETSc.KSP)

FailedReason = PETSc.PC.FailedReason

#: Remedies for lack of memory; {} is the options prefix. The first one is tried automatically, with
#: :data:`WORK_SPACE`.
MORE_WORK_SPACE = "raise -{}mat_mumps_icntl_14, the work space in percent"
FACTORS_ON_DISK = "set -{}mat_mumps_icntl_22 1, which stores factors on disk"
HIGHER_LIMIT = "raise -{}mat_mumps_icntl_23, the limit in MB, or leave it out"

#: Errors INFOG(1) of MUMPS after which it may succeed with more work space.
WORK_SPACE_ERRORS = (-8, -9, -14, -17, -20)

#: Remedies for the errors INFOG(1) of MUMPS that concern memory.
MEMORY_REMEDIES = {
    **dict.fromkeys(WORK_SPACE_ERRORS, MORE_WORK_SPACE),
    -5: FACTORS_ON_DISK,
    -7: FACTORS_ON_DISK,
    -13: FACTORS_ON_DISK,
    -19: HIGHER_LIMIT,
}

#: Causes of failures, by the reason that PETSc gives.
FAILURES = {
    FailedReason.FACTOR_STRUCT_ZEROPIVOT: "a zero pivot of the pattern",
    FailedReason.FACTOR_NUMERIC_ZEROPIVOT: "a zero pivot",
    FailedReason.FACTOR_OUTMEMORY: "not enough memory or work space",
}


@dataclass(frozen=True, slots=True)
class FactorOptions:
    """Settings of all factorisations of one kind, such as those of all K_II.

    Attributes:
        solver: Options of the solver.
        is_symmetric: Whether the matrices are symmetric.
        right_hand_sides: Number of right-hand sides that MUMPS solves for at once, ICNTL(27).
    """

    solver: DirectOptions
    is_symmetric: bool
    right_hand_sides: int


def is_ldlt(options: FactorOptions) -> bool:
    """Return True if MUMPS factors by L Δ Lᵀ, which reads one triangle of the matrix."""
    return options.is_symmetric and options.solver.allows_ldlt


def factor_matrix(matrix: PETSc.Mat, options: FactorOptions) -> PETSc.PC:
    """Factor a sequential matrix, (n, n).

    Args:
        matrix: AIJ, or its upper triangle as SBAIJ if :func:`is_ldlt`.
        options: Settings.

    Returns:
        The factor; the caller destroys it.

    Raises:
        FactorError: The factorisation failed.
        MemoryError: Memory or work space ran out; if MUMPS reports it, the message names the option
            that helps.
    """

    def configure(pc: PETSc.PC, percent: int) -> None:
        pc.setOptionsPrefix(options.solver.prefix)
        pc.setOperators(matrix)
        set_default_solver(pc, options.is_symmetric)
        pc.setFromOptions()
        set_mumps_controls(pc, percent)
        if is_mumps(pc):
            # Right-hand sides of one solve phase.
            pc.getFactorMatrix().setMumpsIcntl(27, options.right_hand_sides)

    return set_up_with_retries(lambda: PETSc.PC().create(PETSc.COMM_SELF), configure)


def set_up_with_retries(
    create: Callable[[], Solver], configure: Callable[[Solver, int], None]
) -> Solver:
    """Create and set up a solver; repeat that with more work space while MUMPS runs out of it.

    Collective on the communicator of the solver.

    Args:
        create: Returns a new solver for each attempt, because PETSc does not call MUMPS again with
            a factor that failed.
        configure: Configures it for a work space in percent.

    Returns:
        The solver; the caller destroys it.

    Raises:
        FactorError: The factorisation failed.
        MemoryError: Memory or work space ran out; if MUMPS reports it, the message names the option
            that helps.
    """
    message = ""
    for percent in WORK_SPACE:
        solver = create()
        try:
            configure(solver, percent)
            solver.setUp()
            failure = _failure_of(solver)
        except BaseException:
            solver.destroy()
            raise
        if failure is None:
            return solver
        solver.destroy()
        message = failure.message
        if not failure.is_out_of_memory:
            raise FactorError(message)
        if not failure.needs_work_space:
            break
    raise MemoryError(message)


@dataclass(frozen=True, slots=True)
class _Failure:
    """A factorisation that failed.

    Attributes:
        message: Cause and, if it is known, remedy.
        is_out_of_memory: Whether memory or work space ran out.
        needs_work_space: Whether MUMPS may succeed with more work space.
    """

    message: str
    is_out_of_memory: bool
    needs_work_space: bool


def _failure_of(solver: PETSc.PC | PETSc.KSP) -> _Failure | None:
    """Return how the set-up of a solver failed; None if it succeeded."""
    pc = solver.getPC() if isinstance(solver, PETSc.KSP) else solver
    try:
        reason = pc.getFailedReason()
        if not reason:
            return None
        is_out_of_memory = bool(_memory_remedy(pc)) or reason == FailedReason.FACTOR_OUTMEMORY
        needs_work_space = _mumps_error(pc) in WORK_SPACE_ERRORS
        return _Failure(failure_message(pc), is_out_of_memory, needs_work_space)
    finally:
        if pc is not solver:
            pc.destroy()  # only this reference; the KSP keeps its PC


def set_default_solver(pc: PETSc.PC, is_symmetric: bool) -> None:
    """Select MUMPS with L Δ Lᵀ or L U; options that are read later may select another solver."""
    pc.setType(PETSc.PC.Type.CHOLESKY if is_symmetric else PETSc.PC.Type.LU)
    pc.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)


def set_mumps_controls(pc: PETSc.PC, percent: int, zero_pivot: float | None = None) -> None:
    """Set the work space of MUMPS and let it count zero pivots; do nothing for other solvers.

    Args:
        pc: A preconditioner with its operators.
        percent: Work space above the estimate [%], ICNTL(14).
        zero_pivot: Largest pivot that counts as zero, as a multiple of the norm of the matrix,
            CNTL(3); None for exact zeros.
    """
    if not is_mumps(pc):
        return
    # In its set-up PETSc reads the options mat_mumps_…, which override these values.
    pc.setFactorSetUpSolverType()
    F = pc.getFactorMatrix()
    F.setMumpsIcntl(14, percent)
    F.setMumpsIcntl(24, 1)  # count zero pivots instead of dividing by them
    if zero_pivot is not None:
        F.setMumpsCntl(3, zero_pivot)


def solve_columns(pc: PETSc.PC, B: PETSc.Mat, X: PETSc.Mat, *, transpose: bool = False) -> None:
    """Solve for several right-hand sides with a factor.

    Args:
        pc: The factor.
        B: Right-hand sides, dense, (n, r).
        X: The solutions are written to it, dense, (n, r).
        transpose: Solve with the transpose.
    """
    F = pc.getFactorMatrix()
    if not transpose:
        F.matSolve(B, X)
        return
    if is_mumps(pc):
        F.setMumpsIcntl(9, 0)  # solve with the transpose; 1 for the matrix itself
        try:
            F.matSolve(B, X)
        finally:
            F.setMumpsIcntl(9, 1)
        return
    for j in range(B.getSize()[1]):
        b = B.getDenseColumnVec(j, mode="r")
        x = X.getDenseColumnVec(j, mode="w")
        F.solveTranspose(b, x)
        B.restoreDenseColumnVec(j, mode="r")
        X.restoreDenseColumnVec(j, mode="w")


def failure_message(pc: PETSc.PC) -> str:
    """Return why a factorisation failed and, if MUMPS reports lack of memory, the remedy."""
    reason = pc.getFailedReason()
    remedy = _memory_remedy(pc)
    text = FAILURES.get(reason, f"PETSc reports failed reason {reason}")
    if remedy:
        text = FAILURES[FailedReason.FACTOR_OUTMEMORY]
    if is_mumps(pc):
        F = pc.getFactorMatrix()
        text += f" (MUMPS: INFOG(1) = {F.getMumpsInfog(1)}, INFOG(2) = {F.getMumpsInfog(2)})"
    return f"{text}: {remedy.format(pc.getOptionsPrefix() or '')}" if remedy else text


def _memory_remedy(pc: PETSc.PC) -> str:
    """Return the remedy if MUMPS ran out of memory; an empty string after another failure."""
    return MEMORY_REMEDIES.get(_mumps_error(pc), "")


def _mumps_error(pc: PETSc.PC) -> int:
    """Return the error INFOG(1) of MUMPS, which is negative; zero for another solver."""
    return int(pc.getFactorMatrix().getMumpsInfog(1)) if is_mumps(pc) else 0


def inertia_of(pc: PETSc.PC) -> FactorInertia:
    """Return the inertia of a factor, which only MUMPS reports."""
    if not is_mumps(pc):
        return FactorInertia(None, None)
    F = pc.getFactorMatrix()
    # INFOG(12): negative pivots of L Δ Lᵀ, or off-diagonal ones of L U. INFOG(28): zero pivots.
    negative = F.getMumpsInfog(12) if pc.getType() == "cholesky" else None
    return FactorInertia(negative, F.getMumpsInfog(28))


def factor_memory(pc: PETSc.PC) -> float | None:
    """Return the memory of a factor in MiB, over all processes; None if it is not reported."""
    if is_mumps(pc):
        # INFOG(22): memory used in the factorisation, sum over the processes, in 10⁶ bytes.
        return float(pc.getFactorMatrix().getMumpsInfog(22)) * 1e6 / 2**20
    if pc.getType() not in ("cholesky", "lu"):
        return None
    return float(pc.getFactorMatrix().getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["memory"]) / 2**20


def is_mumps(pc: PETSc.PC) -> bool:
    """Return True if MUMPS factors."""
    return pc.getType() in ("cholesky", "lu") and pc.getFactorSolverType() == "mumps"
