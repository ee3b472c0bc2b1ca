# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The page of the linear study: the paper's values beside ours, and what goes beyond them.

    python3 -m benchmarks.cube.page build/linear.json build/solvers.json --output build/results

writes ``linear.md``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from functools import partial

import numpy as np

from benchmarks.common.pages import FORMS, groups, section, write_page
from benchmarks.common.records import Record
from benchmarks.cube import paper
from benchmarks.cube.case import Case
from benchmarks.cube.study import is_solved

__all__ = ["deviations", "error_scale", "fields", "fit_growth", "main"]

TYPES = {"all_floating": "all-floating", "classical": "classical"}
SOLVERS = {
    "feti_all_floating": "FETI, all-floating, the paper's choices",
    "feti_classical": "FETI, classical, the paper's choices",
    "feti_default": "FETI, defaults",
    "gamg": "GAMG",
    "mumps": "MUMPS",
}
PRECONDITIONERS = ("identity", "lumped", "dirichlet")

#: Parameters that the paper's own cases do not vary.
FIXED = {
    name: value
    for name, value in asdict(Case()).items()
    if name not in ("degree", "level", "type", "pc", "source", "interior")
}


def _is_known(record: Record) -> bool:
    """Tell whether a record is one of a case, of a refused case, or of a solver."""
    names = ("condition_number", "estimated_mib", "failure", "solver")
    return "machine" in record and any(name in record for name in names)


def fields(records: Sequence[Record]) -> dict[str, object]:
    """Return the values of the page."""
    solvers = [record for record in records if "solver" in record]
    solvers.sort(key=lambda r: (r["level"], r["processes"]))
    cases = [r | {"name": TYPES[r["type"]]} for r in records if "solver" not in r]
    cases.sort(key=order)
    solved = [record for record in cases if is_solved(record)]
    own = [record for record in solved if is_papers(record)]
    condition, iterations = deviations(own)
    whole = {"condition": 100 * condition, "iterations": iterations, "scale": error_scale(own)}
    points = {tuple(record["source"]) for record in cases}
    return {
        "sources": ", ".join(f"({x:g}, {y:g}, {z:g})" for x, y, z in sorted(points)),
        "deviations": [] if math.isnan(condition) else [whole],
        "solvers": section(map(_solver, solvers)),
        "linear": list(_papers(own, 1, TYPES)),
        "floating": list(_papers(own, 2, ["all_floating"])),
        "classical": list(_papers(own, 2, ["classical"])),
        "errors": section(_errors(own)),
        "larger": section(_growth(solved)),
        "fits": section(
            mine[0] | dict(zip(("a", "b", "off"), fit_growth(mine), strict=True))
            for mine in growing(solved)
            if len(mine) > 2
        ),
        "choices": section(_choices(solved)),
        "jumps": _jumps(solved),
        "more": section(_numbers(solved)),
        "costs": section(
            r
            | {"each": r["cpu_seconds_solve"] / r["iterations"]}
            | {"read": r["processes"] * r["seconds_streaming"]}
            for r in own
        ),
        "refused": section(
            r | {"why": "did not converge" if "failure" in r else "does not fit"}
            for r in cases
            if not is_solved(r)
        ),
    }


def deviations(records: Sequence[Record]) -> tuple[float, int]:
    """Return the largest deviations from the paper: condition numbers, relative; iterations."""
    pairs = [(r, _papers_solve(r)) for r in records if is_papers(r)]
    both = [(r, theirs) for r, theirs in pairs if theirs is not None]
    condition = [abs(r["condition_number"] / t.condition_number - 1.0) for r, t in both]
    iterations = [abs(r["iterations"] - t.iterations) for r, t in both]
    return max(condition, default=math.nan), max(iterations, default=0)


def _papers_solve(record: Record) -> paper.Solve | None:
    if record["degree"] != 1:
        return None
    return paper.SOLVES.get((record["type"], record["pc"], record["level"]))


def _papers(own: Sequence[Record], degree: int, kinds: Iterable[str]) -> Iterator[Record]:
    """Yield a section for each type: iterations and condition numbers over the levels."""
    for kind in kinds:
        mine = [r for r in own if (r["degree"], r["type"]) == (degree, kind)]
        by_level = [of_level for _, of_level in groups(mine, "level")]
        rows = [of_level[0] | {r["pc"]: _solve(r) for r in of_level} for of_level in by_level]
        yield from section(rows, name=TYPES[kind])


def _solve(record: Record) -> dict[str, str]:
    """Return iterations and condition number, the paper's in brackets."""
    its, condition = str(record["iterations"]), record["condition_number"]
    number, theirs = FORMS["number"](condition), _papers_solve(record)
    if theirs is None:
        return {"its": its, "kappa": number}
    off = FORMS["off"](condition / theirs.condition_number)
    kappa = f"{number} ({theirs.condition_number:.1f}, {off})"
    return {"its": f"{its} ({theirs.iterations})", "kappa": kappa}


def _errors(records: Sequence[Record]) -> Iterator[dict[str, object]]:
    """L2 errors and their order (eq. 54), which no preconditioner changes."""
    scale = error_scale(records)
    known = {(r["degree"], r["type"], r["level"]): r for r in records}
    for (degree, kind, level), record in known.items():
        error, coarser = record["l2_error"], known.get((degree, kind, level - 1))
        eoc = math.log2(coarser["l2_error"] / error) if coarser else None
        theirs = paper.L2_ERRORS.get((kind, level)) if degree == 1 else None
        ratio = scale * error / theirs if theirs else None
        yield record | {"eoc": eoc, "paper": theirs, "ratio": ratio}


def _growth(records: Sequence[Record]) -> Iterator[Record]:
    """Condition numbers and iterations with the Dirichlet preconditioner over H/h."""
    for mine in growing(records):
        for what, name, form in (("κ", "condition_number", ".4g"), ("it.", "iterations", "d")):
            yield mine[0] | {"what": what, "at": {r["level"]: f"{r[name]:{form}}" for r in mine}}


def _choices(records: Sequence[Record]) -> list[Record]:
    """What else differs from the paper's parameters, on its cube."""
    names = ("scaling", "coarse_q", "gluing", "coarse_modes", "reorthogonalize")
    mine = [r for r in records if differs_in(r, names)]
    other = {group(r, *names) for r in mine if not is_papers(r)}
    mine = [r for r in mine if group(r, *names) in other]
    mine.sort(key=lambda r: (*order(r), *(str(r[name]) for name in names)))
    return [r | {"fcg": "yes" if r["reorthogonalize"] else "no"} for r in mine]


def _numbers(records: Sequence[Record]) -> list[Record]:
    """Number of subdomains at a fixed size of them."""
    names = ("subdomains_per_edge", "coarse_q")
    mine = [r for r in records if differs_in(r, names) and r["pc"] == "dirichlet"]
    several = {group(r, "subdomains_per_edge") for r in mine if r["subdomains_per_edge"] != 8}
    mine = [r for r in mine if group(r, "subdomains_per_edge") in several]
    mine.sort(key=lambda r: (*order(r), r["coarse_q"], r["subdomains_per_edge"]))
    return [r | {"share": 100 * r["seconds_coarse"] / r["seconds_setup"]} for r in mine]


def _jumps(records: Sequence[Record]) -> list[dict[str, object]]:
    """Iterations and condition numbers over the jump, by pattern, type, scaling and weight Q."""
    names = ("type", "scaling", "coarse_q", "gluing", "subdomains_per_edge", "level")
    stiff = [r for r in records if r["pattern"] != "none"]
    stiff.sort(key=lambda r: (r["pattern"], *(str(r[name]) for name in names)))
    even = {
        tuple(r[name] for name in names): r
        for r in records
        if (r["pattern"], r["pc"], r["coarse_modes"]) == ("none", "dirichlet", 0)
        and not r["reorthogonalize"]
    }
    rows = []
    for (_, *key), mine in groups(stiff, "pattern", *names):
        solves = {r["jump"]: r for r in mine}
        solves |= {1.0: even[tuple(key)]} if tuple(key) in even else {}
        at = {
            f"{jump:.0e}": f"{r['iterations']} ({r['condition_number']:.3g})"
            for jump, r in solves.items()
        }
        rows.append(mine[0] | {"at": at})
    places = sorted({(r["subdomains_per_edge"], r["level"]) for r in stiff})
    where = ", ".join(f"{edge}³ subdomains on level {level}" for edge, level in places)
    return section(rows, where=where)


def _solver(record: Record) -> Record:
    """Return a record of a solver; without results, and with its need, if it has failed."""
    row = record | {"name": SOLVERS[str(record["solver"])], "its": record.get("iterations")}
    if record["converged_reason"] > 0:
        return row | {"each": seconds_an_iteration(record)}
    need = FORMS["count"](record["estimated_mib"]) if record.get("estimated_mib") else "more"
    lost = ("seconds_setup", "seconds_solve", "seconds_streaming")
    return row | {"its": f"needs {need} MiB"} | dict.fromkeys(lost)


def is_papers(record: Record) -> bool:
    """Tell whether a record has the paper's parameters."""
    return is_solved(record) and differs_in(record, ())


def differs_in(record: Record, names: Sequence[str]) -> bool:
    """Tell whether a record has the paper's parameters but for some."""
    return all(record[name] == value for name, value in FIXED.items() if name not in names)


def group(record: Record, *names: str) -> tuple[object, ...]:
    """Return the parameters but for some, and but for those that change no result."""
    kept = [name for name in asdict(Case()) if name not in (*names, "source", "interior")]
    return tuple(record[name] for name in kept)


def order(record: Record) -> tuple[object, ...]:
    """Return what sorts the rows of a table."""
    pc = str(record["pc"])
    place = PRECONDITIONERS.index(pc) if pc in PRECONDITIONERS else len(PRECONDITIONERS)
    return record["degree"], record["type"], record["level"], place


def seconds_an_iteration(record: Record) -> float:
    """Return the seconds of an iteration; of a whole solution where they were not taken alone."""
    seconds = record.get("seconds_iterations", record["seconds_solve"])
    return float(seconds) / record["iterations"]


def growing(records: Sequence[Record]) -> list[list[Record]]:
    """Group the cases with the Dirichlet preconditioner that differ in their levels alone."""
    found: dict[tuple[object, ...], list[Record]] = {}
    for record in sorted(records, key=lambda r: (r["subdomains_per_edge"], *order(r))):
        if differs_in(record, ("subdomains_per_edge",)) and record["pc"] == "dirichlet":
            found.setdefault(group(record, "level"), []).append(record)
    return [mine for mine in found.values() if len(mine) > 1]


def fit_growth(records: Sequence[Record]) -> tuple[float, float, float]:
    """Fit √κ = a + b ln(H/h) over levels; return a, b, and the quotient for which κ is most off."""
    x = np.log([2.0 ** (r["level"] - 1) for r in records])
    condition = np.array([r["condition_number"] for r in records])
    b, a = np.polyfit(x, np.sqrt(condition), 1)
    return a, b, 1.0 + float(np.max(np.abs((a + b * x) ** 2 / condition - 1.0)))


def error_scale(records: Sequence[Record]) -> float:
    """Return the factor between the paper's L2 errors and ours, that of the source point."""
    quotients = [
        paper.L2_ERRORS[r["type"], r["level"]] / r["l2_error"]
        for r in records
        if is_papers(r) and r["degree"] == 1
    ]
    return math.exp(sum(map(math.log, quotients)) / len(quotients)) if quotients else math.nan


main = partial(write_page, __file__, "linear", known=_is_known, fields=fields)

if __name__ == "__main__":
    main()
