# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The comparison in sentences: FETI beside each solver on the largest bodies, and κ."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from benchmarks.common.records import Record
from benchmarks.common.table import count
from benchmarks.speed.groups import NAMES, Group, groups, seconds

__all__ = ["GROWTH", "KAPPAS", "Pair", "growth_pairs", "statements"]

#: Volume stiffness at the ends of the comparison [kPa].
KAPPAS = (10.0, 1000.0)

#: What the iterations may grow by from the lesser κ to the larger one, on the block.
GROWTH = 1.3


@dataclass(frozen=True, slots=True)
class Pair:
    """The records of one solver, size and layout at both κ.

    Attributes:
        low: At the lesser κ.
        high: At the larger one.
    """

    low: Record
    high: Record

    @property
    def quotient(self) -> float:
        """Iterations at the larger κ over those at the lesser one."""
        return self.high["iterations"] / self.low["iterations"]


def growth_pairs(records: Sequence[Record]) -> list[Pair]:
    """Return the pairs of iterative solvers, in the order of the page."""
    names = ("solver", "geometry", "dofs", "wanted_subdomains", "processes", "threads", "path_mmhg")
    first_steps = [group for group in groups(records) if group.path_mmhg is None]
    ordered = [
        record
        for group in first_steps
        for solver in NAMES
        for record in group.records
        if record["solver"] == solver != "mumps" and record["converged"] and record["iterations"]
    ]
    high = {tuple(r[n] for n in names): r for r in ordered if r["kappa"] == KAPPAS[1]}
    low = [record for record in ordered if record["kappa"] == KAPPAS[0]]
    return [Pair(r, high[k]) for r in low if (k := tuple(r[n] for n in names)) in high]


def statements(records: Sequence[Record]) -> list[str]:
    """Return the sentences."""
    return [*_of_first_steps(records), *_of_paths(records), *_of_kappa(records)]


def _of_first_steps(records: Sequence[Record]) -> Iterator[str]:
    """Compare on the largest size of each body and κ that FETI and another solver have."""
    largest: dict[tuple[str, float], Group] = {}
    for group in groups(records):  # sizes rise
        others = [name for name in NAMES if name != "feti" and group.best(name) is not None]
        if group.path_mmhg is None and group.best("feti") is not None and others:
            largest[group.geometry, group.kappa] = group
    for (geometry, kappa), group in largest.items():
        feti = group.best("feti")
        others = {name: group.best(name) for name in NAMES if name != "feti"}
        parts = [
            f"{_share(feti, other)} of {NAMES[name]}" for name, other in others.items() if other
        ]
        yield (
            f"{geometry}, κ = {kappa:g} kPa, {count(group.dofs)} dofs: FETI takes {_listed(parts)}."
        )


def _of_paths(records: Sequence[Record]) -> Iterator[str]:
    for group in groups(records):
        feti, mumps = group.best("feti"), group.best("mumps")
        if group.path_mmhg is not None and feti is not None and mumps is not None:
            yield (
                f"{group.geometry}, κ = {group.kappa:g} kPa, {count(group.dofs)} dofs, all the way "
                f"to {group.path_mmhg:g} mmHg: FETI takes "
                f"{seconds(feti) / seconds(mumps):.2f} of the time of MUMPS."
            )


def _of_kappa(records: Sequence[Record]) -> Iterator[str]:
    pairs = [pair for pair in growth_pairs(records) if pair.low["geometry"] == "block"]
    feti = [pair for pair in pairs if pair.low["solver"] == "feti"]
    if feti:
        worst = max(feti, key=lambda pair: pair.quotient)
        met = "is met" if worst.quotient <= GROWTH else "is **not** met"
        yield (
            f"On the block the iterations of FETI grow from {worst.low['iterations']} to "
            f"{worst.high['iterations']} from κ = {KAPPAS[0]:g} to {KAPPAS[1]:g} kPa "
            f"({count(worst.low['dofs'])} dofs, the worst case): by a factor of "
            f"{worst.quotient:.2f}. The target of {GROWTH:g} {met}."
        )


def _share(feti: Record, other: Record) -> str:
    """Say which share of another solver's time and memory FETI takes."""
    time = f"{seconds(feti) / seconds(other):.2f} of the time"
    mine, its = feti["peak_mib"], other["peak_mib"]
    return f"{time} and {mine / its:.2f} of the memory" if mine and its else time


def _listed(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else ", ".join(parts[:-1]) + ", and " + parts[-1]
