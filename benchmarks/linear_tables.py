# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The tables of the linear study, the paper's values beside ours."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict

from benchmarks import paper
from benchmarks.cube_case import Case
from benchmarks.records import Record
from benchmarks.table import Table

__all__ = ["deviations", "error_scale", "is_papers", "tables"]

TYPES = {"all_floating": "all-floating", "classical": "classical"}
PRECONDITIONERS = ("identity", "lumped", "dirichlet")

#: Parameters that the paper's own cases do not vary.
FIXED = {
    name: value
    for name, value in asdict(Case()).items()
    if name not in ("degree", "level", "type", "pc", "source", "interior")
}


def is_papers(record: Record) -> bool:
    """Tell whether a record has the paper's parameters."""
    return all(record[name] == value for name, value in FIXED.items())


def tables(records: Sequence[Record]) -> list[Table]:
    """Make all the tables that the records have rows for."""
    own = [record for record in records if is_papers(record)]
    found = [
        *_papers_tables(own),
        _errors(own),
        _growth(own),
        _costs(own),
        _numbers(records),
        _jumps(records),
        _choices(records),
    ]
    return [table for table in found if table.rows]


def _papers_tables(records: Sequence[Record]) -> Iterator[Table]:
    """Iterations and condition numbers over levels, a table for each degree and type."""
    for degree in (1, 2):
        for kind, name in TYPES.items():
            mine = [r for r in records if (r["degree"], r["type"]) == (degree, kind)]
            rows = []
            for level in _values(mine, "level"):
                by_pc = {r["pc"]: r for r in mine if r["level"] == level}
                any_of = next(iter(by_pc.values()))
                cells = [str(level), _count(any_of["dofs_torn"]), _count(any_of["multipliers"])]
                for pc in PRECONDITIONERS:
                    cells += _solve(by_pc.get(pc))
                rows.append(cells)
            head = ["level", "torn dofs", "multipliers"]
            head += [f"{pc} {what}" for pc in PRECONDITIONERS for what in ("it.", "κ")]
            more = "; the paper's in brackets" if degree == 1 else ""
            title = f"P{degree}, {name}: iterations and condition numbers{more}"
            yield Table(title, head, rows)


def _solve(record: Record | None) -> list[str]:
    """Return iterations and condition number, the paper's in brackets."""
    if record is None:
        return ["–", "–"]
    its, condition = record["iterations"], record["condition_number"]
    theirs = _papers_solve(record)
    if theirs is None:
        return [str(its), _number(condition)]
    return [
        f"{its} ({theirs.iterations})",
        f"{_number(condition)} ({theirs.condition_number:.1f}, "
        f"{_percent(condition / theirs.condition_number)})",
    ]


def _papers_solve(record: Record) -> paper.Solve | None:
    if record["degree"] != 1:
        return None
    return paper.SOLVES.get((record["type"], record["pc"], record["level"]))


def deviations(records: Sequence[Record]) -> tuple[float, int]:
    """Return the largest deviations from the paper: condition numbers, relative; iterations."""
    pairs = [(r, _papers_solve(r)) for r in records if is_papers(r)]
    both = [(r, theirs) for r, theirs in pairs if theirs is not None]
    condition = [abs(r["condition_number"] / t.condition_number - 1.0) for r, t in both]
    iterations = [abs(r["iterations"] - t.iterations) for r, t in both]
    return max(condition, default=math.nan), max(iterations, default=0)


def error_scale(records: Sequence[Record]) -> float:
    """Return the factor between the paper's L2 errors and ours, that of the source point."""
    quotients = [
        paper.L2_ERRORS[r["type"], r["level"]] / r["l2_error"]
        for r in records
        if is_papers(r) and r["degree"] == 1
    ]
    return math.exp(sum(map(math.log, quotients)) / len(quotients)) if quotients else math.nan


def _errors(records: Sequence[Record]) -> Table:
    """L2 errors and their order, which no preconditioner changes."""
    scale = error_scale(records)
    rows = []
    for degree in (1, 2):
        errors = {(r["type"], r["level"]): r["l2_error"] for r in records if r["degree"] == degree}
        for kind, level in sorted(errors):
            error, coarser = errors[kind, level], errors.get((kind, level - 1))
            order = "–" if coarser is None else f"{math.log2(coarser / error):.2f}"
            theirs = paper.L2_ERRORS[kind, level] if degree == 1 else None
            cells = [f"P{degree}", TYPES[kind], str(level), f"{error:.3e}", order]
            cells += ["–"] * 2 if theirs is None else _scaled(theirs, scale * error)
            rows.append(cells)
    head = ["elements", "type", "level", "L2 error", "eoc", "the paper's", "ours, scaled"]
    return Table("L2 errors and the estimated order of convergence", head, rows)


def _scaled(theirs: float, ours: float) -> list[str]:
    return [f"{theirs:.2e}", _percent(ours / theirs)]


def _growth(records: Sequence[Record]) -> Table:
    """Condition number with the Dirichlet preconditioner, held against theory's (1 + ln H/h)²."""
    rows = []
    for r in sorted((r for r in records if r["pc"] == "dirichlet"), key=_order):
        ratio = 2 ** (r["level"] - 1)
        quotient = r["condition_number"] / (1.0 + math.log(ratio)) ** 2
        condition = _number(r["condition_number"])
        rows.append([f"P{r['degree']}", TYPES[r["type"]], str(ratio), condition, _number(quotient)])
    head = ["elements", "type", "H/h", "κ", "κ/(1 + ln H/h)²"]
    return Table("Growth with the size of the subdomains, Dirichlet preconditioner", head, rows)


def _costs(records: Sequence[Record]) -> Table:
    """Time and memory."""
    rows = [
        [
            f"P{r['degree']}",
            TYPES[r["type"]],
            str(r["level"]),
            r["pc"],
            r["interior_is"],
            f"{r['seconds_setup']:.2f}",
            f"{r['seconds_solve']:.2f}",
            f"{r['seconds_solve'] / r['iterations']:.3f}",
            f"{r['seconds_streaming']:.3f}",
            _count(r["peak_mib"]),
            _count(r["estimated_mib"]),
        ]
        for r in sorted(records, key=_order)
    ]
    head = ["elements", "type", "level", "preconditioner", "interior", "set-up [s]", "solve [s]"]
    head += ["an iteration [s]", "to read the factors [s]", "peak [MiB]", "estimated [MiB]"]
    return Table("Time and memory", head, rows)


def _numbers(records: Sequence[Record]) -> Table:
    """Number of subdomains at a fixed size of them."""
    only = ("subdomains_per_edge",)
    mine = [r for r in records if _differs_in(r, only)]
    several = {_group(r, "subdomains_per_edge") for r in mine if r["subdomains_per_edge"] != 8}
    mine = [r for r in mine if _group(r, "subdomains_per_edge") in several]
    rows = [
        [
            f"P{r['degree']}",
            TYPES[r["type"]],
            str(r["level"]),
            r["pc"],
            f"{r['subdomains_per_edge']}³",
            _count(r["dofs"]),
            _count(r["coarse_size"]),
            str(r["iterations"]),
            _number(r["condition_number"]),
        ]
        for r in sorted(mine, key=lambda r: (*_order(r), r["subdomains_per_edge"]))
    ]
    head = [
        "elements",
        "type",
        "level",
        "preconditioner",
        "subdomains",
        "dofs",
        "coarse size",
        "it.",
    ]
    return Table("More subdomains of the same size", [*head, "κ"], rows)


def _jumps(records: Sequence[Record]) -> Table:
    """Coefficients that jump, by pattern, type, scaling and weight Q."""
    mine = [r for r in records if r["pattern"] != "none"]
    rows = [
        [
            r["pattern"],
            f"{r['jump']:.0e}",
            TYPES[r["type"]],
            r["pc"],
            *_choice(r),
            f"{r['subdomains_per_edge']}³, level {r['level']}",
            str(r["iterations"]),
            _number(r["condition_number"]),
        ]
        for r in sorted(mine, key=lambda r: (r["pattern"], *_order(r), *_choice(r), r["jump"]))
    ]
    head = ["pattern", "jump", "type", "preconditioner", "scaling", "Q", "gluing", "subdomains"]
    head += ["it.", "κ"]
    return Table("Young's modulus jumps between subdomains", head, rows)


def _choices(records: Sequence[Record]) -> Table:
    """What else differs from the paper's parameters, on its cube."""
    names = ("scaling", "coarse_q", "gluing", "coarse_modes", "reorthogonalize")
    mine = [r for r in records if _differs_in(r, names)]
    groups = {_group(r, *names) for r in mine if not is_papers(r)}
    mine = [r for r in mine if _group(r, *names) in groups]
    rows = [
        [
            f"P{r['degree']}",
            TYPES[r["type"]],
            str(r["level"]),
            r["pc"],
            *_choice(r),
            str(r["coarse_modes"]),
            "yes" if r["reorthogonalize"] else "no",
            str(r["iterations"]),
            _number(r["condition_number"]),
            _number(r["lambda_min"]),
            _number(r["lambda_max"]),
        ]
        for r in sorted(mine, key=lambda r: (*_order(r), *_choice(r), r["reorthogonalize"]))
    ]
    head = ["elements", "type", "level", "preconditioner", "scaling", "Q", "gluing", "soft modes"]
    head += ["reorthogonalized", "it.", "κ", "λ_min", "λ_max"]
    return Table("Other choices than the paper's", head, rows)


def _differs_in(record: Record, names: Sequence[str]) -> bool:
    """Tell whether a record has the paper's parameters but for some."""
    return all(record[name] == value for name, value in FIXED.items() if name not in names)


def _group(record: Record, *names: str) -> tuple[object, ...]:
    """Return the parameters but for some, and but for those that change no result."""
    kept = [name for name in asdict(Case()) if name not in (*names, "source", "interior")]
    return tuple(record[name] for name in kept)


def _order(record: Record) -> tuple[object, ...]:
    """Return what sorts the rows of a table."""
    pc = str(record["pc"])
    place = PRECONDITIONERS.index(pc) if pc in PRECONDITIONERS else len(PRECONDITIONERS)
    return record["degree"], record["type"], record["level"], place


def _choice(record: Record) -> list[str]:
    return [record[name] for name in ("scaling", "coarse_q", "gluing")]


def _values(records: Sequence[Record], name: str) -> list[int]:
    return sorted({record[name] for record in records})


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"


def _count(value: float | None) -> str:
    return "–" if value is None else f"{value:,.0f}".replace(",", " ")


def _percent(quotient: float) -> str:
    """Return a deviation in per cent."""
    return f"{100 * (quotient - 1.0):+.1f} %".replace("-", "−")
