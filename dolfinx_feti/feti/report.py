# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The table of ``-ksp_view``: what a FETI solver has built, over all processes."""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx_feti.feti.lasting import Form
from dolfinx_feti.feti.options import FETIOptions
from dolfinx_feti.feti.primal.form import PrimalForm
from dolfinx_feti.feti.setup import Inertia
from dolfinx_feti.feti.subdomain.factors.protocol import Pivots


@dataclass(frozen=True, slots=True)
class Report:
    """Figures of one FETI solver.

    Attributes:
        options: The choices made.
        formulation: ``dual`` or ``primal``.
        lag: Matrices since the one that the preconditioner belongs to.
        subdomains: Number of subdomains.
        dofs: Dofs of the assembled problem.
        torn_dofs: Dofs of all subdomains together.
        dofs_local: Fewest and most dofs of a subdomain.
        multipliers: Rows of B.
        kernels: Number of subdomains with a kernel of each dimension, from 0.
        exact: Subdomains whose modes satisfy K R = 0.
        elastic: Soft and buckling modes that joined the kernels.
        inertia: Negative eigenvalues.
        interior: Whether the interior dofs are ``kept`` or ``eliminated``.
        coarse_size: Coarse unknowns.
        coarse_solver: How the coarse problem is solved.
        coarse_mib: Memory of the factor of the coarse matrix in MiB; None if not known.
        coarse_inertia: Negative and zero eigenvalues of the coarse matrix; None if not known.
        factor_mib: Memory of all local factors in MiB.
        recycled: Ritz vectors of earlier solves, deflated in the last one.
        recycled_mib: Their memory in MiB.
        eigenvalues: (λ_min, λ_max) of the preconditioned operator.
        floor: ‖b − A x‖/‖b‖ that rounding leaves, if that has ended the last solve; else nan.
    """

    options: FETIOptions
    formulation: str
    lag: int
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
    coarse_inertia: Pivots
    factor_mib: float
    recycled: int
    recycled_mib: float
    eigenvalues: tuple[float, float]
    floor: float


def collect(form: Form, *, lag: int, eigenvalues: tuple[float, float], floor: float) -> Report:
    """Gather the figures of all processes. Collective."""
    pattern, solver = form.pattern, form.coarse.solver
    ritz = form.deflation if isinstance(form, PrimalForm) else None
    torn = pattern.torn
    comm = torn.comm
    sizes = [len(dofs) for dofs in torn.subdomains]
    modes = form.modes
    k = np.array([m.kernel for m in modes], dtype=np.int64)
    widest = comm.allreduce(int(k.max(initial=0)), op=MPI.MAX)
    kernels = comm.allreduce(np.bincount(k, minlength=widest + 1))
    return Report(
        options=pattern.options,
        formulation=form.formulation,
        lag=lag,
        subdomains=comm.allreduce(len(sizes)),
        dofs=torn.A.getSize()[0],
        torn_dofs=comm.allreduce(torn.n),
        dofs_local=(
            comm.allreduce(min(sizes, default=torn.A.getSize()[0]), op=MPI.MIN),
            comm.allreduce(max(sizes, default=0), op=MPI.MAX),
        ),
        multipliers=pattern.gluing.B.getSize()[0],
        kernels=tuple(int(count) for count in kernels),
        exact=comm.allreduce(sum(m.exact for m in modes)),
        elastic=comm.allreduce(sum(m.R.shape[1] - m.kernel for m in modes)),
        inertia=form.inertia,
        interior="eliminated" if form.operator.eliminated else "kept",
        coarse_size=form.coarse.total,
        coarse_solver=str(solver),
        coarse_mib=solver.memory(),
        coarse_inertia=solver.pivots(),
        factor_mib=comm.allreduce(form.memory()),
        recycled=0 if ritz is None else ritz.count,
        recycled_mib=comm.allreduce(0.0 if ritz is None else ritz.memory()),
        eigenvalues=eigenvalues,
        floor=floor,
    )


def table(report: Report) -> str:
    """Format a report for a PETSc viewer."""
    o, r = report.options, report
    kernels = ", ".join(f"{n} of dimension {k}" for k, n in enumerate(r.kernels) if n)
    low, high = r.eigenvalues
    condition = (
        "not known" if np.isnan(low) or low <= 0 else f"{high / low:.4g}  ({low:.4g} … {high:.4g})"
    )
    details = f"dual form, Q = {o.coarse_q}"
    if r.formulation == "primal":
        details = f"primal form, up to {o.coarse_adaptive} adaptive columns per subdomain"
    ago = "1 matrix ago" if r.lag == 1 else f"{r.lag} matrices ago"
    lag = f", set up {ago}" if r.lag else ""
    rows = [
        ("method", f"{o.type}, {o.scaling} scaling, {details}"),
        ("preconditioner", o.pc_type + lag),
        ("subdomains", f"{r.subdomains}"),
        ("dofs", f"{r.dofs}, torn {r.torn_dofs}, a subdomain {r.dofs_local[0]}–{r.dofs_local[1]}"),
        ("kernels", f"{kernels}; {r.exact} exact; {r.elastic} elastic modes in addition"),
        ("multipliers", f"{r.multipliers}"),
        ("coarse size", f"{r.coarse_size}, {r.coarse_solver}"),
        (
            "negative eigenvalues",
            f"{_number(r.inertia.local)} in K_ρ, {r.inertia.defect} in D, "
            f"{_number(r.inertia.interior)} in K_II, {_number(r.coarse_inertia.negative)} in N, "
            f"{_number(r.inertia.assembled)} at least in A",
        ),
        ("factors", f"{r.factor_mib:.0f} MiB, interior {r.interior}"),
        ("condition number", condition),
    ]
    if r.recycled:
        rows.append(("Ritz vectors", f"{r.recycled} deflated, {r.recycled_mib:.0f} MiB"))
    if r.floor > 0.0:
        rows.append(("residual", f"at the floor of rounding, {r.floor:.1e} of the load"))
    return "".join(f"  {name:<22}{value}\n" for name, value in rows)


def _number(count: int | None) -> str:
    """Format a number that may not be known."""
    return "unknown" if count is None else str(count)
