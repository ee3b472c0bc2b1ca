# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tables beyond the paper's: larger subdomains, more of them, and coefficients that jump."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.common.records import Record
from benchmarks.common.table import Table, count, number, percent
from benchmarks.unit_cube.groups import TYPES, differs_in, group, order

__all__ = ["Fit", "fit_growth", "growing", "growth_tables", "jump_table", "number_table"]


class Fit(NamedTuple):
    r"""Fit of theory's bound, :math:`\sqrt κ = a + b \ln(H/h)`.

    Attributes:
        a: √κ at one cell an edge.
        b: Slope.
        worst: Largest deviation of κ, relative.
    """

    a: float
    b: float
    worst: float


def fit_growth(records: Sequence[Record]) -> Fit:
    """Fit the condition numbers of records that differ in their levels alone."""
    x = np.log([2.0 ** (r["level"] - 1) for r in records])
    condition = np.array([r["condition_number"] for r in records])
    b, a = np.polyfit(x, np.sqrt(condition), 1)
    return Fit(a, b, float(np.max(np.abs((a + b * x) ** 2 / condition - 1.0))))


def growth_tables(records: Sequence[Record]) -> Iterator[Table]:
    """Condition number with the Dirichlet preconditioner over H/h, and the fits."""
    sets = growing(records)
    levels = sorted({r["level"] for mine in sets for r in mine})
    rows, fits = [], []
    for mine in sets:
        first = mine[0]
        name = [f"P{first['degree']}", TYPES[first["type"]], f"{first['subdomains_per_edge']}³"]
        by_level = {r["level"]: r for r in mine}
        for what, form in (("condition_number", number), ("iterations", str)):
            cells = [form(by_level[n][what]) if n in by_level else "–" for n in levels]
            rows.append([*name, "κ" if form is number else "it.", *cells])
        if len(mine) > 2:
            fit = fit_growth(mine)
            fits.append([*name, number(fit.a), number(fit.b), percent(1.0 + fit.worst)])
    head = ["elements", "type", "subdomains", ""]
    head += [f"H/h = {2 ** (level - 1)}" for level in levels]
    yield Table("Larger subdomains, Dirichlet preconditioner", head, rows)
    head = ["elements", "type", "subdomains", "a", "b", "largest deviation of κ"]
    note = (
        "Theory bounds κ by C (1 + ln H/h)². The fit is √κ = a + b ln H/h, with H/h the number of "
        "cells along an edge of a subdomain."
    )
    yield Table("Growth held against theory", head, fits, note)


def growing(records: Sequence[Record]) -> list[list[Record]]:
    """Group the cases with the Dirichlet preconditioner that differ in their levels alone."""
    mine = [
        r for r in records if differs_in(r, ("subdomains_per_edge",)) and r["pc"] == "dirichlet"
    ]
    groups: dict[tuple[object, ...], list[Record]] = {}
    for record in sorted(mine, key=lambda r: (r["subdomains_per_edge"], *order(r))):
        groups.setdefault(group(record, "level"), []).append(record)
    return [of_one for of_one in groups.values() if len(of_one) > 1]


def number_table(records: Sequence[Record]) -> Table:
    """Number of subdomains at a fixed size of them."""
    names = ("subdomains_per_edge", "coarse_q")
    mine = [r for r in records if differs_in(r, names) and r["pc"] == "dirichlet"]
    several = {group(r, "subdomains_per_edge") for r in mine if r["subdomains_per_edge"] != 8}
    mine = [r for r in mine if group(r, "subdomains_per_edge") in several]
    rows = [
        [
            f"P{r['degree']}",
            TYPES[r["type"]],
            str(r["level"]),
            r["coarse_q"],
            f"{r['subdomains_per_edge']}³",
            count(r["dofs"]),
            str(r["iterations"]),
            number(r["condition_number"]),
            count(r["coarse_size"]),
            count(r["coarse_mib"]),
            count(r["peak_mib"]),
            f"{r['seconds_coarse']:.2f}",
            f"{r['seconds_setup']:.2f}",
            f"{100 * r['seconds_coarse'] / r['seconds_setup']:.0f} %",
        ]
        for r in sorted(mine, key=lambda r: (*order(r), r["coarse_q"], r["subdomains_per_edge"]))
    ]
    head = ["elements", "type", "level", "Q", "subdomains", "dofs", "it.", "κ", "coarse size"]
    head += ["its factor [MiB]", "peak [MiB]", "coarse set-up [s]", "set-up [s]", "share"]
    note = "Seconds are of the clock: G, N and the factor of N, and all of the set-up."
    return Table("More subdomains of the same size, Dirichlet preconditioner", head, rows, note)


def jump_table(records: Sequence[Record]) -> Table:
    """Iterations and condition numbers over the jump, by pattern, type, scaling and weight Q."""
    names = ("type", "scaling", "coarse_q", "gluing", "subdomains_per_edge", "level")
    stiff = [r for r in records if r["pattern"] != "none"]
    even = {tuple(r[name] for name in names): r for r in records if _is_even(r)}
    jumps = sorted({r["jump"] for r in stiff})
    sets: dict[tuple[object, ...], dict[float, Record]] = {}
    for record in sorted(stiff, key=lambda r: (r["pattern"], *map(str, map(r.get, names)))):
        key = tuple(record[name] for name in names)
        of_one = sets.setdefault((record["pattern"], *key), {1.0: even[key]} if key in even else {})
        of_one[record["jump"]] = record
    rows = [
        [
            pattern,
            TYPES[kind],
            scaling,
            q,
            *(_solve(of_one.get(jump)) for jump in (1.0, *jumps)),
        ]
        for (pattern, kind, scaling, q, *_), of_one in sets.items()
    ]
    head = ["pattern", "type", "scaling", "Q", *(f"jump {jump:.0e}" for jump in (1.0, *jumps))]
    places = sorted({(r["subdomains_per_edge"], r["level"]) for r in stiff})
    where = ", ".join(f"{edge}³ subdomains on level {level}" for edge, level in places)
    note = (
        f"Iterations, and κ in brackets, with the Dirichlet preconditioner; {where}. Bounded are "
        "stiffness scaling and a weight Q together; either alone is not enough."
    )
    return Table("Young's modulus jumps between subdomains", head, rows, note)


def _is_even(record: Record) -> bool:
    """Tell whether nothing jumps, and the preconditioner is the one of the jumps."""
    usual = record["pc"] == "dirichlet" and not record["reorthogonalize"]
    return usual and record["pattern"] == "none" and record["coarse_modes"] == 0


def _solve(record: Record | None) -> str:
    if record is None:
        return "–"
    return f"{record['iterations']} ({record['condition_number']:.3g})"
