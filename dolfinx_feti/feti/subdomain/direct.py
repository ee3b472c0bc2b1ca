# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""One direct factorisation, with more work space if MUMPS runs out of it, and what it tells."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

from petsc4py import PETSc

from dolfinx_feti.errors import FactorError

__all__ = [
    "WORK_SPACE",
    "Choice",
    "Pivots",
    "create_factor",
    "failure",
    "mebibytes",
    "pivots_of",
    "prepare_mumps",
    "set_zero_pivot",
    "sum_pivots",
    "takes_ldlt",
]

#: Percent of work space that MUMPS gets for delayed pivots, one try after the other.
WORK_SPACE = (10, 50, 200, 1000)

Failed = PETSc.PC.FailedReason

FAILURES = {
    Failed.FACTOR_STRUCT_ZEROPIVOT: "a zero pivot of the pattern",
    Failed.FACTOR_NUMERIC_ZEROPIVOT: "a zero pivot",
    Failed.FACTOR_OUTMEMORY: "not enough memory or work space",
}


class Pivots(NamedTuple):
    """What a factor tells of its matrix; None where it does not tell.

    Attributes:
        negative: Number of negative eigenvalues.
        zero: Number of pivots that are exactly zero; a singular matrix may have none.
    """

    negative: int | None
    zero: int | None


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


def create_factor(
    matrix: PETSc.Mat, choice: Choice, prepare: Callable[[PETSc.Mat], object] | None = None
) -> PETSc.PC:
    """Factor a sequential matrix.

    Args:
        matrix: The matrix, (n, n).
        choice: How to factor.
        prepare: Called with the factor before the work begins.

    Raises:
        FactorError: The factorisation failed.
    """
    cause = ""
    for percent in WORK_SPACE:
        pc = _create_pc(matrix, choice, percent)
        if prepare is not None:
            prepare(pc.getFactorMatrix())
        pc.setUp()
        if not pc.getFailedReason():
            return pc
        failed, cause = pc.getFailedReason(), failure(pc)
        pc.destroy()  # PETSc does not call MUMPS again with a factor that has failed
        if failed != Failed.FACTOR_OUTMEMORY:
            break
    raise FactorError(cause)


def _create_pc(matrix: PETSc.Mat, choice: Choice, percent: int) -> PETSc.PC:
    pc = PETSc.PC().create(PETSc.COMM_SELF)
    pc.setOptionsPrefix(choice.prefix)
    pc.setOperators(matrix)
    pc.setType(PETSc.PC.Type.CHOLESKY if choice.symmetric else PETSc.PC.Type.LU)
    pc.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
    pc.setFromOptions()
    prepare_mumps(pc, percent)
    if _is_mumps(pc):
        pc.getFactorMatrix().setMumpsIcntl(27, choice.right_hand_sides)
    return pc


def prepare_mumps(pc: PETSc.PC, percent: int) -> None:
    """Let MUMPS, if it is the solver, have work space and count zero pivots."""
    if _is_mumps(pc):
        pc.setFactorSetUpSolverType()
        pc.getFactorMatrix().setMumpsIcntl(14, percent)
        pc.getFactorMatrix().setMumpsIcntl(24, 1)  # count zero pivots instead of dividing by them


def set_zero_pivot(pc: PETSc.PC, zero: float) -> None:
    """Let MUMPS, if it is the solver, take small pivots for zero.

    Args:
        pc: Prepared by :func:`prepare_mumps`, not yet set up.
        zero: Multiple of the norm of the matrix.
    """
    if _is_mumps(pc):
        pc.getFactorMatrix().setMumpsCntl(3, zero)


def failure(pc: PETSc.PC) -> str:
    """Say why a factorisation failed."""
    reason = pc.getFailedReason()
    text = FAILURES.get(reason, f"PETSc reports failed reason {reason}")
    if _is_mumps(pc):
        F = pc.getFactorMatrix()
        text += f" (MUMPS: INFOG(1) = {F.getMumpsInfog(1)}, INFOG(2) = {F.getMumpsInfog(2)})"
    return text


def pivots_of(pc: PETSc.PC) -> Pivots:
    """Read the numbers of negative and zero pivots off a factor; only MUMPS tells."""
    if not _is_mumps(pc):
        return Pivots(None, None)
    F = pc.getFactorMatrix()
    negative = F.getMumpsInfog(12) if pc.getType() == "cholesky" else None
    return Pivots(negative, F.getMumpsInfog(28))


def mebibytes(pc: PETSc.PC) -> float | None:
    """Return the memory of a factor in MiB; None if the solver does not tell."""
    if _is_mumps(pc):
        return float(pc.getFactorMatrix().getMumpsInfog(22)) * 1e6 / 2**20  # units of 10⁶ bytes
    if pc.getType() not in ("cholesky", "lu"):
        return None
    return float(pc.getFactorMatrix().getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["memory"]) / 2**20


def sum_pivots(counts: Iterable[Pivots]) -> Pivots:
    """Add up what several factors tell: None as soon as one of them does not tell."""
    negative: int | None = 0
    zero: int | None = 0
    for count in counts:
        negative = None if None in (negative, count.negative) else negative + count.negative  # type: ignore[operator]
        zero = None if None in (zero, count.zero) else zero + count.zero  # type: ignore[operator]
    return Pivots(negative, zero)


def _is_mumps(pc: PETSc.PC) -> bool:
    return pc.getType() in ("cholesky", "lu") and pc.getFactorSolverType() == "mumps"
