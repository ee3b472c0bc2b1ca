# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What a comparison of solvers found: a table that prints itself, and records."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

from dolfinx_feti.runtime.cost import Cost
from dolfinx_feti.runtime.tables import Cell, json_value, table

__all__ = ["Comparison", "SolverResult"]

HEAD = (
    "solver", "iterations", "set-up [s]", "solve [s]", "memory [MiB]", "residual", "difference", "",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class SolverResult:
    """One solver's part in a comparison.

    Attributes:
        solver: Its name.
        cost: What it took; None if PETSc raised an error.
        relative_residual: ‖f − K x‖/‖f‖ of the assembled system, on the free dofs; nan without a
            solution.
        difference_to_direct: ‖x − x_d‖/‖x_d‖ to the direct solution; nan if there is none whose
            own residual is at most 1e-6.
        note: Why it failed, that its residual is above the tolerance, or why the direct solution
            took LU or is no reference; or an empty string.
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
        solved: The solvers, in the order of the user.
        left_out: Name of each solver that was left out, and why.
    """

    dofs: int
    subdomains: int
    processes: int
    rtol: float
    solved: tuple[SolverResult, ...]
    left_out: tuple[tuple[str, str], ...]

    @property
    def records(self) -> list[dict[str, object]]:
        """One record for each solver, to be written as JSON; None for what is not known."""
        size = {"dofs": self.dofs, "subdomains": self.subdomains, "processes": self.processes}
        solved = [
            {"solver": s.solver, **size, "rtol": self.rtol, "converged": s.converged}
            | ({} if s.cost is None else asdict(s.cost))
            | {"relative_residual": s.relative_residual}
            | {"difference_to_direct": s.difference_to_direct, "note": s.note}
            for s in self.solved
        ]
        left_out = [
            {"solver": name, **size, "converged": False, "note": f"left out: {why}"}
            for name, why in self.left_out
        ]
        return [{k: json_value(v) for k, v in record.items()} for record in solved + left_out]

    def __str__(self) -> str:
        """Return the table, and who was left out."""
        lines = [
            f"{self.dofs} dofs, {self.subdomains} subdomains, {self.processes} process(es), "
            f"relative tolerance {self.rtol:g}",
            table(HEAD, [_row(s) for s in self.solved]),
        ]
        lines += [f"left out: {name}, {why}" for name, why in self.left_out]
        return "\n".join(lines)


def _row(solved: SolverResult) -> list[Cell]:
    """Return a row of the table."""
    cost = solved.cost
    if cost is None:
        return [solved.solver, None, None, None, None, None, None, solved.note]
    return [
        solved.solver,
        cost.iterations,
        f"{cost.seconds_setup:.2f}".rjust(len(HEAD[2])),
        f"{cost.seconds_solve:.2f}".rjust(len(HEAD[3])),
        round(cost.peak_mib) if math.isfinite(cost.peak_mib) else None,
        _short(solved.relative_residual),
        _short(solved.difference_to_direct),
        solved.note,
    ]


def _short(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.0e}".replace("e-0", "e-")
