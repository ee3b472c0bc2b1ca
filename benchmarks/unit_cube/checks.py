# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Statements that the linear study should confirm, and whether its records do."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from benchmarks.common.records import Record
from benchmarks.common.table import Table, number
from benchmarks.unit_cube import paper
from benchmarks.unit_cube.groups import (
    differs_in,
    group,
    is_papers,
    is_solved,
    seconds_an_iteration,
)
from benchmarks.unit_cube.growth import fit_growth, growing

__all__ = ["Check", "check_table", "checks", "error_scale"]

#: Multipliers of the paper's first level, all-floating.
MULTIPLIERS = 38_052


class Check(NamedTuple):
    """A statement with its measured value.

    Attributes:
        what: The quantity.
        bound: Its bound, in words.
        value: Its value, in words.
        holds: Whether the value is within the bound.
    """

    what: str
    bound: str
    value: str
    holds: bool


def check_table(records: Sequence[Record], solvers: Sequence[Record]) -> Table:
    """Make the table of all checks that the records have values for."""
    found = [*checks(records), *speed_checks(solvers)]
    rows = [[c.what, c.bound, c.value, "yes" if c.holds else "**no**"] for c in found]
    return Table("What was to be shown", ["quantity", "bound", "measured", "holds"], rows)


def checks(records: Sequence[Record]) -> Iterator[Check]:
    """Hold the numbers against the paper and theory."""
    solved = [r for r in records if is_solved(r)]
    own = [r for r in solved if is_papers(r) and r["degree"] == 1]
    both = [(r, paper.SOLVES[r["type"], r["pc"], r["level"]]) for r in own]
    if both:
        worst = max(abs(r["condition_number"] / t.condition_number - 1.0) for r, t in both)
        yield _percents("κ, P1, off the paper's", 0.03, worst)
        far = [abs(r["iterations"] - t.iterations) for r, t in both]
        fine = [d <= max(3.0, 0.15 * t.iterations) for d, (_, t) in zip(far, both, strict=True)]
        worst = f"at most {max(far)}"
        yield Check("iterations, P1, off the paper's", "3, or 15 %", worst, all(fine))
        scale = error_scale(own)
        error = max(
            abs(scale * r["l2_error"] / paper.L2_ERRORS[r["type"], r["level"]] - 1.0) for r in own
        )
        yield _percents("L2 errors, P1, off the paper's after one factor", 0.05, error)
    for degree, least in ((1, 1.9), (2, 2.9)):
        orders = list(_orders([r for r in solved if is_papers(r) and r["degree"] == degree]))
        if orders:
            yield _least(f"order of the L2 error, P{degree}", least, min(orders))
    coarsest = [r["multipliers"] for r in own if (r["type"], r["level"]) == ("all_floating", 1)]
    if coarsest:
        fine = set(coarsest) == {MULTIPLIERS}
        yield Check("multipliers on level 1", str(MULTIPLIERS), str(coarsest[0]), fine)
    yield from _theory(solved)


def _theory(records: Sequence[Record]) -> Iterator[Check]:
    """Eigenvalues, growth with H/h and with the number of subdomains, and jumps."""
    low = [r["lambda_min"] for r in records if r["pc"] == "dirichlet" and r["lambda_min"]]
    if low:
        lowest = f"1 − {1.0 - min(low):.1e}" if min(low) < 1.0 else f"1 + {min(low) - 1.0:.1e}"
        what = f"λ_min with the Dirichlet preconditioner, {len(low)} solves"
        yield Check(what, "≥ 1 − 1e-6", lowest, min(low) >= 1.0 - 1e-6)
    for q in ("identity", "preconditioner"):
        flat = list(_spread([r for r in records if r["coarse_q"] == q]))
        if flat:
            yield _percents(f"growth of iterations from 4³ subdomains on, Q = {q}", 0.15, max(flat))
    fits = [fit_growth(mine) for mine in growing(records) if len(mine) > 3]
    if fits:
        worst = max(fit.worst for fit in fits)
        yield _percents("κ over H/h off √κ = a + b ln H/h", 0.2, worst)
    for scaling, bounded in (("stiffness", True), ("multiplicity", False)):
        mine = [r for r in records if r["pattern"] != "none" and r["coarse_q"] == "preconditioner"]
        its = [r["iterations"] for r in mine if r["scaling"] == scaling]
        if its:
            bound = "≤ 60" if bounded else "grow"
            fine = max(its) <= 60 if bounded else max(its) > 10 * min(its) > 0
            what = f"iterations over jumps to 1e6, {scaling} scaling, Q = preconditioner"
            yield Check(what, bound, f"{min(its)} to {max(its)}", fine)


def _orders(records: Sequence[Record]) -> Iterator[float]:
    errors = {(r["type"], r["level"]): r["l2_error"] for r in records}
    for (kind, level), error in errors.items():
        if (kind, level - 1) in errors:
            yield math.log2(errors[kind, level - 1] / error)


def _spread(records: Sequence[Record]) -> Iterator[float]:
    """Yield how much iterations change from 4³ subdomains on, for each size of subdomain."""
    groups: dict[tuple[object, ...], list[int]] = {}
    for r in records:
        own = differs_in(r, ("subdomains_per_edge", "coarse_q")) and r["pc"] == "dirichlet"
        if own and r["subdomains_per_edge"] >= 4 and r["degree"] == 1 and r["level"] < 3:
            groups.setdefault(group(r, "subdomains_per_edge"), []).append(r["iterations"])
    for its in groups.values():
        if len(its) > 2:
            yield max(its) / min(its) - 1.0


def speed_checks(solvers: Sequence[Record]) -> Iterator[Check]:
    """Hold the times of level 3 on the paper's cube against their bounds."""
    for r in solvers:
        paper_s = r["solver"] in ("feti_all_floating", "feti_classical")
        if not paper_s or (r["level"], r["subdomains"]) != (3, 512):
            continue
        name = f"level 3, {r['solver'][5:].replace('_', '-')}, {r['processes']} processes"
        yield _most(f"set-up, {name} [s]", 8.0, r["seconds_setup"])
        quotient = seconds_an_iteration(r) / r["seconds_streaming"]
        yield _most(f"an iteration over streaming the factors, {name}", 1.5, quotient)
        share = r["seconds_coarse"] / r["seconds_setup"]
        yield _percents(f"coarse problem's share of set-up, {name}", 0.1, share)


def error_scale(records: Sequence[Record]) -> float:
    """Return the factor between the paper's L2 errors and ours, that of the source point."""
    quotients = [
        paper.L2_ERRORS[r["type"], r["level"]] / r["l2_error"]
        for r in records
        if is_papers(r) and r["degree"] == 1
    ]
    return math.exp(sum(map(math.log, quotients)) / len(quotients)) if quotients else math.nan


def _percents(what: str, bound: float, value: float) -> Check:
    return Check(what, f"≤ {100 * bound:.0f} %", f"{100 * value:.1f} %", value <= bound)


def _least(what: str, bound: float, value: float) -> Check:
    return Check(what, f"≥ {bound:g}", number(value), value >= bound)


def _most(what: str, bound: float, value: float) -> Check:
    return Check(what, f"≤ {bound:g}", number(value), value <= bound)
