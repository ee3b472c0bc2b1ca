# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The table of ``-ksp_view``: figures of a FETI solver over all processes."""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx_feti.feti.formulation import Formulation
from dolfinx_feti.feti.options import FETIOptions
from dolfinx_feti.feti.setup import Inertia
from dolfinx_feti.feti.solve_info import SolveInfo
from dolfinx_feti.feti.subdomain.factors.protocol import FactorInertia


@dataclass(frozen=True, slots=True)
class Report:
    """Figures of one FETI solver.

    Attributes:
        options: Options of the solver.
        formulation: ``dual`` or ``primal``.
        age: Number of matrices since the one that the preconditioner was built for.
        subdomains: Number of subdomains.
        dofs: Dofs of the assembled problem.
        torn_dofs: Dofs of all subdomains together.
        dofs_local: Smallest and largest number of dofs of a subdomain.
        multipliers: Rows of B.
        kernels: Number of subdomains with a kernel of each dimension, from 0.
        exact: Number of subdomains whose modes satisfy K R = 0.
        elastic: Number of soft modes (in Y) and of buckling modes (in R).
        inertia: Negative eigenvalues.
        interior: Whether the interior dofs are ``kept`` or ``eliminated``.
        coarse_size: Coarse unknowns.
        coarse_solver: How the coarse problem is solved.
        coarse_mib: Memory of the factor of the coarse matrix in MiB; None if unknown.
        coarse_inertia: Negative eigenvalues and zero pivots of the coarse matrix; None if unknown.
        factor_mib: Memory of all local factors in MiB.
        ritz_vectors: Number of vectors that deflate the solves with the present matrix: Ritz
            vectors, or soft fields in a first solve (``Formulation.deflation_count``).
        ritz_vectors_mib: Memory of these vectors in MiB.
        eigenvalues: Ritz values (λ_min, λ_max) of the preconditioned system of the formulation.
        residual: ‖b − A x‖/‖b − A x_D‖ of the last solve; nan before the first one.
        floor: Residual that rounding leaves, if rounding has ended the last solve; else nan.
        error_estimate: Estimated error η of x in the last solve; nan before the first one.
        error_floor: η that rounding leaves, if rounding has ended the last solve; else nan.
    """

    options: FETIOptions
    formulation: str
    age: int
    subdomains: int
    dofs: int
    torn_dofs: int
    dofs_local: tuple[int, int]
    multipliers: int
    kernels: tuple[int, ...]
    exact: int
    elastic: int
    inertia: Inertia
    interior: str
    coarse_size: int
    coarse_solver: str
    coarse_mib: float | None
    coarse_inertia: FactorInertia
    factor_mib: float
    ritz_vectors: int
    ritz_vectors_mib: float
    eigenvalues: tuple[float, float]
    residual: float
    floor: float
    error_estimate: float
    error_floor: float


def create_report(formulation: Formulation, info: SolveInfo, *, age: int) -> Report:
    """Create the report of a formulation and its last solve, over all processes. Collective.

    Args:
        formulation: The formulation that is set up.
        info: How the last solve has ended.
        age: Number of matrices since the one that the preconditioner was built for.
    """
    pattern = formulation.pattern
    solver = formulation.coarse.solver
    torn = pattern.torn
    comm = torn.comm
    sizes = [len(dofs) for dofs in torn.subdomains]
    modes = formulation.modes
    kernel_sizes = np.array([m.n_rigid + m.n_null for m in modes], dtype=np.int64)
    largest = comm.allreduce(int(kernel_sizes.max(initial=0)), op=MPI.MAX)
    kernels = comm.allreduce(np.bincount(kernel_sizes, minlength=largest + 1))
    return Report(
        options=pattern.options,
        formulation=formulation.name,
        age=age,
        subdomains=comm.allreduce(len(sizes)),
        dofs=torn.A.getSize()[0],
        torn_dofs=comm.allreduce(torn.n),
        dofs_local=(
            comm.allreduce(min(sizes, default=torn.A.getSize()[0]), op=MPI.MIN),
            comm.allreduce(max(sizes, default=0), op=MPI.MAX),
        ),
        multipliers=pattern.gluing.B.getSize()[0],
        kernels=tuple(int(count) for count in kernels),
        exact=comm.allreduce(sum(m.is_exact for m in modes)),
        elastic=comm.allreduce(sum(m.n_buckling + m.n_soft for m in modes)),
        inertia=formulation.inertia,
        interior="eliminated" if formulation.operator.is_interior_eliminated else "kept",
        coarse_size=formulation.coarse.N_c,
        coarse_solver=str(solver),
        coarse_mib=solver.memory(),
        coarse_inertia=solver.inertia(),
        factor_mib=comm.allreduce(formulation.memory()),
        ritz_vectors=formulation.deflation_count,
        ritz_vectors_mib=comm.allreduce(formulation.deflation_memory()),
        eigenvalues=info.ritz_values,
        residual=info.accuracy.residual,
        floor=info.accuracy.residual_floor,
        error_estimate=info.accuracy.error_estimate,
        error_floor=info.accuracy.error_floor,
    )


def format_report(report: Report) -> str:
    """Return the table of a report, one line a row; the functions below format one row each."""
    options = report.options
    smallest, largest = report.dofs_local
    rows = [
        ("method", f"{options.type}, {options.scaling} scaling, {_formulation(report)}"),
        ("preconditioner", f"{options.pc_type}{_age(report.age)}"),
        ("subdomains", f"{report.subdomains}"),
        ("dofs", f"{report.dofs}, torn {report.torn_dofs}, a subdomain {smallest}–{largest}"),
        ("kernels", _kernels(report)),
        ("multipliers", f"{report.multipliers}"),
        ("coarse size", f"{report.coarse_size}, {report.coarse_solver}"),
        ("negative eigenvalues", _negative_eigenvalues(report)),
        ("factors", f"{report.factor_mib:.0f} MiB, interior {report.interior}"),
        ("condition number", _condition_number(report)),
    ]
    if report.ritz_vectors:
        memory = f"{report.ritz_vectors_mib:.0f} MiB"
        rows.append(("Ritz vectors", f"{report.ritz_vectors} deflate the solves, {memory}"))
    if not np.isnan(report.residual):
        rows.append(("residual", _with_floor(report.residual, report.floor, "load")))
    if not np.isnan(report.error_estimate):
        error = _with_floor(report.error_estimate, report.error_floor, "solution")
        rows.append(("estimated error", error))
    return "".join(f"  {name:<22}{value}\n" for name, value in rows)


def _formulation(report: Report) -> str:
    """Format the formulation and what its coarse space depends on."""
    if report.formulation == "primal":
        columns = report.options.coarse_adaptive
        return f"primal form, up to {columns} adaptive columns per subdomain"
    return f"dual form, Q = {report.options.coarse_q}"


def _age(age: int) -> str:
    """Format the age of the preconditioner; empty for a new one."""
    if age == 0:
        return ""
    return f", set up {age} {'matrix' if age == 1 else 'matrices'} ago"


def _kernels(report: Report) -> str:
    """Format the numbers of kernels by dimension, and of modes in addition to them."""
    counts = [
        f"{count} of dimension {dimension}"
        for dimension, count in enumerate(report.kernels)
        if count
    ]
    numbers = ", ".join(counts)
    return f"{numbers}; {report.exact} exact; {report.elastic} elastic modes in addition"


def _negative_eigenvalues(report: Report) -> str:
    """Format the numbers of negative eigenvalues of all factored matrices, and of A."""
    inertia = report.inertia
    coarse_matrix = "A₀" if report.formulation == "primal" else "N"
    return (
        f"{_number(inertia.local)} in K_ρ, {inertia.defect} in D, "
        f"{_number(inertia.interior)} in K_II, "
        f"{_number(report.coarse_inertia.negative)} in {coarse_matrix}, "
        f"{_number(inertia.assembled)} at least in A"
    )


def _condition_number(report: Report) -> str:
    """Format the condition number and the Ritz values that it is the quotient of."""
    low, high = report.eigenvalues
    if not low > 0.0:  # also if nan
        return "not known"
    return f"{high / low:.4g}  ({low:.4g} … {high:.4g}) of the {report.formulation} system"


def _with_floor(value: float, floor: float, reference: str) -> str:
    """Format a residual or error, with the floor of rounding if rounding has ended the solve.

    Args:
        value: Residual or error, relative to the reference.
        floor: What rounding leaves of it; nan if rounding has not ended the solve.
        reference: Name of what it is relative to.
    """
    if floor > 0.0:
        return f"{value:.1e}, at the floor of rounding, {floor:.1e} of the {reference}"
    return f"{value:.1e} of the {reference}"


def _number(count: int | None) -> str:
    """Format a number that may be unknown."""
    return "unknown" if count is None else str(count)
