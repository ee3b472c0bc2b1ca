# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""One direct factorisation, with more work space if MUMPS runs out of it, and what it tells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from petsc4py import PETSc

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.subdomain.factors.protocol import Pivots
from dolfinx_feti.runtime.lifetime import Lifetime

#: Percent of work space that MUMPS gets for delayed pivots, one try after the other.
WORK_SPACE = (10, 50, 200, 1000)

Failed = PETSc.PC.FailedReason
Solver = TypeVar("Solver", PETSc.PC, PETSc.KSP)

#: What helps where MUMPS's INFOG(1) tells of memory: more work space, factors on disk, no limit.
MORE_SPACE = "raise -{}mat_mumps_icntl_14, the work space in percent"
ON_DISK = "set -{}mat_mumps_icntl_22 1, which keeps factors on disk"
NO_LIMIT = "raise -{}mat_mumps_icntl_23, the limit in MB, or leave it out"
MEMORY = (
    dict.fromkeys((-8, -9, -14, -17, -20), MORE_SPACE)
    | dict.fromkeys((-5, -7, -13), ON_DISK)
    | {-19: NO_LIMIT}
)

FAILURES = {
    Failed.FACTOR_STRUCT_ZEROPIVOT: "a zero pivot of the pattern",
    Failed.FACTOR_NUMERIC_ZEROPIVOT: "a zero pivot",
    Failed.FACTOR_OUTMEMORY: "not enough memory or work space",
}


@dataclass(frozen=True, slots=True)
class Choice:
    """What all factorisations of one kind have in common.

    Attributes:
        prefix: Options prefix.
        symmetric: Whether the matrices are symmetric.
        right_hand_sides: How many of them MUMPS treats at once.
    """

    prefix: str
    symmetric: bool
    right_hand_sides: int


def takes_ldlt(choice: Choice) -> bool:
    """Tell whether MUMPS factors by L Δ Lᵀ, unless PETSc lacks it: the options may name another."""
    own = PETSc.Options(choice.prefix)
    return (
        choice.symmetric
        and own.getString("pc_factor_mat_solver_type", "mumps") == "mumps"
        and own.getString("pc_type", "cholesky") == "cholesky"
    )


def create_factor(matrix: PETSc.Mat, choice: Choice) -> PETSc.PC:
    """Factor a sequential matrix, (n, n), or raise a FactorError."""

    def prepare(pc: PETSc.PC, percent: int) -> None:
        pc.setOptionsPrefix(choice.prefix)
        pc.setOperators(matrix)
        set_default_factor(pc, choice.symmetric)
        pc.setFromOptions()
        prepare_mumps(pc, percent)
        if is_mumps(pc):
            pc.getFactorMatrix().setMumpsIcntl(27, choice.right_hand_sides)

    return factor_with_work_space(lambda: PETSc.PC().create(PETSc.COMM_SELF), prepare)


def factor_with_work_space(
    create: Callable[[], Solver], prepare: Callable[[Solver, int], None]
) -> Solver:
    """Set a new solver up, prepared for percents of work space; with more if MUMPS runs out.

    Raises:
        FactorError: The factorisation failed.
        MemoryError: Memory or work space ran out; with the option that helps.
    """
    cause = ""
    for percent in WORK_SPACE:
        with Lifetime() as owned:
            solver = owned.own(create())
            prepare(solver, percent)
            solver.setUp()
            pc = owned.own(solver.getPC()) if isinstance(solver, PETSc.KSP) else solver
            if not pc.getFailedReason():
                owned.pop_all()
                return solver
            cause, remedy = factor_failure(pc), _memory_remedy(pc)
            memory = bool(remedy) or pc.getFailedReason() == Failed.FACTOR_OUTMEMORY
        if not memory:  # PETSc does not call MUMPS again with a factor that has failed
            raise FactorError(cause)
        if remedy != MORE_SPACE:
            break
    raise MemoryError(cause)


def set_default_factor(pc: PETSc.PC, symmetric: bool) -> None:
    """Let MUMPS factor, L Δ Lᵀ or L U, before the options are read."""
    pc.setType(PETSc.PC.Type.CHOLESKY if symmetric else PETSc.PC.Type.LU)
    pc.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)


def prepare_mumps(pc: PETSc.PC, percent: int, zero: float | None = None) -> None:
    """Let MUMPS, if it is the solver, have percents of work space, and count zero pivots.

    Those below a multiple ``zero`` of the norm of the matrix are zero; None for exact zeros.
    """
    if is_mumps(pc):
        pc.setFactorSetUpSolverType()
        F = pc.getFactorMatrix()
        F.setMumpsIcntl(14, percent)
        F.setMumpsIcntl(24, 1)  # count zero pivots instead of dividing by them
        if zero is not None:
            F.setMumpsCntl(3, zero)


def solve_many(pc: PETSc.PC, B: PETSc.Mat, X: PETSc.Mat, *, transpose: bool = False) -> None:
    """Solve for the columns of a dense B, (n, r), with a factor or its transpose."""
    F = pc.getFactorMatrix()
    if not transpose:
        F.matSolve(B, X)
    elif is_mumps(pc):
        F.setMumpsIcntl(9, 0)  # transposed, for all columns at once
        F.matSolve(B, X)
        F.setMumpsIcntl(9, 1)
    else:
        for j in range(B.getSize()[1]):
            b, x = B.getDenseColumnVec(j, mode="r"), X.getDenseColumnVec(j, mode="w")
            F.solveTranspose(b, x)
            B.restoreDenseColumnVec(j, mode="r")
            X.restoreDenseColumnVec(j, mode="w")


def factor_failure(pc: PETSc.PC) -> str:
    """Say why a factorisation failed and, where memory ran out in MUMPS, which option helps."""
    reason, remedy = pc.getFailedReason(), _memory_remedy(pc)
    text = FAILURES.get(reason, f"PETSc reports failed reason {reason}")
    if remedy:
        text = FAILURES[Failed.FACTOR_OUTMEMORY]
    if is_mumps(pc):
        F = pc.getFactorMatrix()
        text += f" (MUMPS: INFOG(1) = {F.getMumpsInfog(1)}, INFOG(2) = {F.getMumpsInfog(2)})"
    return f"{text}: {remedy.format(pc.getOptionsPrefix() or '')}" if remedy else text


def _memory_remedy(pc: PETSc.PC) -> str:
    """Return what helps where MUMPS ran out of memory; nothing after another failure."""
    return MEMORY.get(pc.getFactorMatrix().getMumpsInfog(1), "") if is_mumps(pc) else ""


def pivots_of(pc: PETSc.PC) -> Pivots:
    """Read the numbers of negative and zero pivots off a factor; only MUMPS tells."""
    if not is_mumps(pc):
        return Pivots(None, None)
    F = pc.getFactorMatrix()
    negative = F.getMumpsInfog(12) if pc.getType() == "cholesky" else None
    return Pivots(negative, F.getMumpsInfog(28))


def mebibytes(pc: PETSc.PC) -> float | None:
    """Return the memory of a factor in MiB; None if the solver does not tell."""
    if is_mumps(pc):
        return float(pc.getFactorMatrix().getMumpsInfog(22)) * 1e6 / 2**20  # units of 10⁶ bytes
    if pc.getType() not in ("cholesky", "lu"):
        return None
    return float(pc.getFactorMatrix().getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["memory"]) / 2**20


def is_mumps(pc: PETSc.PC) -> bool:
    """Tell whether MUMPS factors."""
    return pc.getType() in ("cholesky", "lu") and pc.getFactorSolverType() == "mumps"
