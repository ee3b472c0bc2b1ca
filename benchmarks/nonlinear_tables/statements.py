# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The sentences of the paper on its nonlinear study, and whether they hold here.

Each statement is counted over all pairs of records that it speaks of: it holds if it does so in
every one. Records without a result take no part, but where a Krylov method was cut off, which
counts as more iterations than any number.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.common.records import Record
from benchmarks.common.table import Table, number
from benchmarks.nonlinear_tables import paper
from benchmarks.nonlinear_tables.groups import CHOICES, is_solved, pairs, seconds, usual

__all__ = ["STATEMENTS", "Finding", "mean_iterations", "statement_table"]

#: By how much classical FETI may be the faster one for all-floating FETI to be "competitive".
COMPETITIVE = 1.1

#: Change of the iterations, either way, that counts as none.
UNCHANGED = 0.1


class Finding(NamedTuple):
    """What the records say about a statement.

    Attributes:
        holds: Whether it holds; None if no records speak of it.
        measured: The numbers.
    """

    holds: bool | None
    measured: str


class Statement(NamedTuple):
    """A sentence of the paper.

    Attributes:
        text: What it says.
        paper: The paper's own numbers.
        find: Holds it against records of one choice.
    """

    text: str
    paper: str
    find: Callable[[Sequence[Record]], Finding]


def mean_iterations(record: Record) -> float:
    """Return the mean iterations of a Newton step; inf where one was cut off, nan if it failed."""
    if "iterations_exceed" in record:
        return math.inf
    return float(record["linear_iterations_mean"]) if is_solved(record) else math.nan


def statement_table(records: Sequence[Record]) -> Table:
    """Make the table of all statements."""
    rows = []
    for statement in STATEMENTS:
        cells = []
        for choices in CHOICES:
            found = statement.find([r for r in records if r["choices"] == choices])
            word = {True: "yes", False: "**no**", None: "–"}[found.holds]
            cells.append(f"{word}: {found.measured}" if found.measured else word)
        rows.append([statement.text, statement.paper, *cells])
    head = ["what the paper says", "its numbers", *CHOICES.values()]
    return Table("What the paper says, and whether it holds here", head, rows, _NOTE)


def _counted(quotients: Iterable[float], holds: Callable[[float], bool]) -> Finding:
    """Count the quotients for which something holds, and tell their range."""
    known = [q for q in quotients if not math.isnan(q)]
    if not known:
        return Finding(None, "")
    good = sum(map(holds, known))
    finite = [q for q in known if math.isfinite(q) and q > 0.0]
    span = f", quotients {number(min(finite))} to {number(max(finite))}" if finite else ""
    return Finding(good == len(known), f"{good} of {len(known)}{span}")


def _quotient(above: float, below: float) -> float:
    """Return a quotient; nan where both are infinite."""
    return math.nan if math.isinf(above) and math.isinf(below) else above / below


def _classical_over_floating(records: Sequence[Record]) -> Finding:
    found = pairs(usual(records), "type", "classical", "all_floating")
    quotients = [_quotient(mean_iterations(a), mean_iterations(b)) for a, b in found]
    return _counted(quotients, lambda q: q > 1.0)


def _times(records: Sequence[Record]) -> Finding:
    found = pairs([r for r in usual(records) if is_solved(r)], "type", "all_floating", "classical")
    return _counted((seconds(a) / seconds(b) for a, b in found), lambda q: q <= COMPETITIVE)


def _order(weaker: str, stronger: str) -> Callable[[Sequence[Record]], Finding]:
    def find(records: Sequence[Record]) -> Finding:
        found = pairs(usual(records), "pc", weaker, stronger)
        quotients = [_quotient(mean_iterations(a), mean_iterations(b)) for a, b in found]
        return _counted(quotients, lambda q: q > 1.0)

    return find


def _escalate(records: Sequence[Record]) -> Finding:
    """Compare the growth with κ of the weaker preconditioners with that of Dirichlet's."""
    mine = usual(records)
    growths = [
        _growth_of(weak) / _growth_of(strong)
        for pc in ("identity", "lumped")
        for weak, strong in pairs(_with_growth(mine), "pc", pc, "dirichlet")
    ]
    return _counted(growths, lambda q: q > 1.0)


def _with_growth(records: Sequence[Record]) -> list[Record]:
    """Return the records at the highest κ that have one at the lowest, with both mean values."""
    kappas = [record["kappa"] for record in records]
    found = pairs(records, "kappa", max(kappas, default=0), min(kappas, default=0))
    return [high | {"_low": mean_iterations(low)} for high, low in found if high is not low]


def _growth_of(record: Record) -> float:
    return _quotient(mean_iterations(record), float(record["_low"]))


def _growth(degree: int) -> Callable[[Sequence[Record]], Finding]:
    def find(records: Sequence[Record]) -> Finding:
        mine = [r for r in usual(records) if r["degree"] == degree and r["pc"] == "dirichlet"]
        return _counted(map(_growth_of, _with_growth(mine)), lambda q: q > 1.0)

    return find


def _grows_less(records: Sequence[Record]) -> Finding:
    """Compare the growth with κ in P2–P0 with that in P1–P0, on the same mesh."""
    mine = _with_growth([r for r in usual(records) if r["pc"] == "dirichlet"])
    quotients = [
        _growth_of(second) / _growth_of(first)
        for first in mine
        for second in mine
        if (first["degree"], second["degree"]) == (1, 2)
        and all(first[n] == second[n] for n in ("geometry", "size", "layers", "type"))
    ]
    return _counted(quotients, lambda q: q < 1.0)


def _volume(records: Sequence[Record]) -> Finding:
    """Compare how far J is from one in P2–P0 and P1–P0, on the same mesh."""
    mine = [r for r in usual(records) if is_solved(r) and r["pc"] == "dirichlet"]
    quotients = [
        second["mean_deviation_J"] / first["mean_deviation_J"]
        for first in mine
        for second in mine
        if (first["degree"], second["degree"]) == (1, 2)
        and all(first[n] == second[n] for n in ("geometry", "size", "layers", "type", "kappa"))
    ]
    return _counted(quotients, lambda q: q < 1.0)


def _newton(records: Sequence[Record]) -> Finding:
    arrived = [r for r in usual(records) if is_solved(r) and r["choices"] == "default"]
    steps = [r["newton_iterations"] for r in arrived]
    if not steps:
        return Finding(None, "")
    low, high = paper.NEWTON_STEPS
    return Finding(low <= min(steps) and max(steps) <= high, f"{min(steps)} to {max(steps)}")


def _few_points(kind: str, holds: Callable[[float], bool]) -> Callable[[Sequence[Record]], Finding]:
    """Compare a subdomain that touches the rim in a few points with one that does not at all."""

    def find(records: Sequence[Record]) -> Finding:
        found = pairs([r for r in records if r["type"] == kind], "contact", "few", "none")
        quotients = [_quotient(mean_iterations(a), mean_iterations(b)) for a, b in found]
        return _counted(quotients, holds)

    return find


def _paper_order(weaker: str, stronger: str) -> str:
    """Count the paper's own pairs of two preconditioners."""
    quotients = [
        _quotient(solve.iterations or np.inf, paper.SOLVES[*key, stronger].iterations or np.inf)
        for (*key, pc), solve in paper.SOLVES.items()
        if pc == weaker
    ]
    return _counted(quotients, lambda q: q > 1.0).measured


def _paper_types() -> str:
    """Count the paper's own pairs of the two variants."""
    quotients = [
        _quotient(solve.iterations or np.inf, other.iterations or np.inf)
        for (layers, degree, kind, *key), solve in paper.SOLVES.items()
        if kind == "classical" and (other := paper.SOLVES[layers, degree, "all_floating", *key])
    ]
    return _counted(quotients, lambda q: q > 1.0).measured


#: The statements in the order of the paper.
STATEMENTS = (
    Statement(
        "Newton's method needs four to six steps",
        f"{paper.NEWTON_STEPS[0]} to {paper.NEWTON_STEPS[1]}",
        _newton,
    ),
    Statement(
        "few points on the Dirichlet boundary harm classical FETI",
        "",
        _few_points("classical", lambda q: q > 1.0 + UNCHANGED),
    ),
    Statement(
        "… and do not affect all-floating FETI at all",
        "",
        _few_points("all_floating", lambda q: abs(q - 1.0) <= UNCHANGED),
    ),
    Statement(
        "all-floating FETI takes fewer iterations than classical FETI",
        _paper_types(),
        _classical_over_floating,
    ),
    Statement("… and is competitive in time, set-up and Krylov method", "", _times),
    Statement(
        "Dirichlet takes fewer iterations than lumped",
        _paper_order("lumped", "dirichlet"),
        _order("lumped", "dirichlet"),
    ),
    Statement(
        "lumped takes fewer iterations than identity",
        _paper_order("identity", "lumped"),
        _order("identity", "lumped"),
    ),
    Statement("for large κ identity and lumped escalate: they grow more", "", _escalate),
    Statement(
        "the iterations depend on κ, P1–P0, Dirichlet",
        f"× {paper.GROWTH[1]:.1f} from 10 to 1000 kPa",
        _growth(1),
    ),
    Statement("… P2–P0, Dirichlet", f"× {paper.GROWTH[2]:.1f}", _growth(2)),
    Statement("… and grow less with P2–P0 than with P1–P0", "", _grows_less),
    Statement("J is closer to one with P2–P0 than with P1–P0", "", _volume),
)

_NOTE = (
    "*k of n* are the pairs of cases that agree in everything else and in which the statement "
    "holds; the quotients are those of the mean iterations of a Newton step, the paper's worse "
    f"case over its better one, of the seconds (all-floating over classical, up to {COMPETITIVE:g} "
    "counts as competitive), of the growth with κ, or of the mean |J − 1| (P2–P0 over P1–P0). "
    "For the few points they are those of the iterations, three points over none, and "
    f"{100 * UNCHANGED:.0f} % either way count as no effect; the cells at the points also change "
    "the shape of the subdomain."
)
