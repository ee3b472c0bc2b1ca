# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The linear study of the paper: the unit cube in 512 subdomains, in all variants.

    mpirun -n 2 python3 -m benchmarks.cube --sets papers,choices --json build/linear.json
    python3 -m benchmarks.cube --sets papers --only degree=1,level=2,type=classical,pc=lumped

Without --sets all sets run: the paper's table, and what goes beyond it. Unless a set changes them,
the choices are the paper's: 8 × 8 × 8 subdomains, multiplicity scaling, Q = I, full gluing, and a
reduction of the dual residual by 1e-8. The body has E = 210 and ν = 0.45, and on the whole surface
the displacements of the fundamental solution with its source at (2, 2, 2).
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, fields, replace

from mpi4py import MPI

import numpy as np

from benchmarks.common import command, paper
from benchmarks.common.cube import Case, create_problem, l2_error, solve
from benchmarks.common.pages import FORMS, groups, section
from benchmarks.common.records import Record
from benchmarks.common.study import Arguments, Keep, Study
from benchmarks.common.walls.first_step import PRECONDITIONERS, TYPES
from dolfinx_feti.comparison import PeakMemory

LEVELS = (1, 2, 3, 4)

#: Coefficients of the stiff subcubes, and the scalings and weights Q that are tried on them.
JUMPS = (1.0, 1e2, 1e4, 1e6)

WEIGHTS = tuple(itertools.product(("multiplicity", "stiffness"), ("identity", "preconditioner")))


def papers() -> Iterator[Case]:
    """Yield the cases of the paper's table, and the same with quadratic elements."""
    for degree, levels in ((1, (1, 2, 3)), (2, (1, 2))):
        for level in levels:
            yield from _all(Case(degree=degree, level=level))


def choices() -> Iterator[Case]:
    """Yield cases with one choice that is not the paper's, and with this package's choices."""
    own = {"scaling": "stiffness", "coarse_q": "preconditioner"}
    changes = (
        {},
        {"reorthogonalize": True},
        {"coarse_q": "diagonal"},
        {"coarse_q": "preconditioner"},
        {"scaling": "stiffness"},
        own,
        own | {"coarse_modes": 12},
    )
    for kind in TYPES:
        for pc, full in itertools.product(("identity", "lumped"), (False, True)):
            yield Case(level=2, type=kind, pc=pc, reorthogonalize=full)
        for change in changes:
            yield Case(level=2, type=kind, **change)


def jumps() -> Iterator[Case]:
    """Yield cases whose Young's modulus jumps between subcubes: a checkerboard, a stiff layer."""
    for pattern, kind, weight in itertools.product(("checkerboard", "layer"), TYPES, WEIGHTS):
        yield from _jumps(pattern, kind, *weight)


def _jumps(pattern: str, kind: str, scaling: str, q: str) -> Iterator[Case]:
    usual = Case(1, 2, 4, kind, scaling=scaling, coarse_q=q)
    for jump in JUMPS:
        yield replace(usual, jump=jump, pattern=pattern if jump > 1.0 else "none")


def growth() -> Iterator[Case]:
    """Yield cases with more and more cells in each of 64 subdomains."""
    for level in LEVELS:
        yield from _all(Case(subdomains_per_edge=4, level=level))


def numbers() -> Iterator[Case]:
    """Yield cases with more and more subdomains of one size, with two weights Q."""
    for level, q, edge in itertools.product((1, 2), ("identity", "preconditioner"), (2, 4, 8, 16)):
        yield from _all(Case(level=level, subdomains_per_edge=edge, coarse_q=q), ["dirichlet"])
    yield from _all(Case(subdomains_per_edge=32), ["dirichlet"])


def largest() -> Iterator[Case]:
    """Yield the largest cases: the paper's fourth level, and the third of quadratic elements."""
    for degree, level in ((1, 4), (2, 3)):
        yield from _all(Case(degree=degree, level=level))


#: Parts of the study by name.
SETS = {each.__name__: each for each in (papers, choices, jumps, growth, numbers, largest)}


def _all(case: Case, preconditioners: Sequence[str] = PRECONDITIONERS) -> Iterator[Case]:
    """Yield a case with both types and each of the preconditioners."""
    for kind, pc in itertools.product(TYPES, preconditioners):
        yield replace(case, type=kind, pc=pc)


def _cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    """Yield the cases of some sets, each once, that have a subdomain for each process."""
    cases = dict.fromkeys(case for name in args.sets for case in SETS[name]())
    yield from (asdict(case) for case in cases if case.subdomains_per_edge**3 >= comm.size)


def _run(key: Record, keep: Keep, _args: Arguments, comm: MPI.Comm) -> None:
    """Solve a case. Collective."""
    case = Case(**key)
    tear, exact = create_problem(case, comm)
    peak = PeakMemory()
    linear = tear()
    found = solve(linear)
    peak_mib = peak.mib(comm)
    error = l2_error(linear.u, exact) if case.jump == 1.0 else None
    own = {"l2_error": error, "peak_mib": peak_mib if math.isfinite(peak_mib) else None}
    keep({}, found | own | {"processes": comm.size})


def case_of(record: Record) -> Case:
    """Return the parameters of a record."""
    return Case(**{field.name: record[field.name] for field in fields(Case)})


def _fields(records: Sequence[Record]) -> dict[str, object]:
    """Return the values of the page."""
    known = {case_of(r): r | {"name": TYPES[r["type"]]} for r in records}

    def of(cases: Iterable[Case]) -> list[Record]:
        return [known[case] for case in dict.fromkeys(cases) if case in known]

    both = list(itertools.product((1, 2), TYPES))
    every = itertools.product((1, 2), TYPES, LEVELS, PRECONDITIONERS)
    own = of(Case(degree, level, type=kind, pc=pc) for degree, kind, level, pc in every)
    condition, iterations = deviations(own)
    whole = {"condition": 100 * condition, "iterations": iterations, "scale": error_scale(own)}
    growing = [
        of(Case(degree, level, edge, kind) for level in LEVELS)
        for edge, (degree, kind) in itertools.product((4, 8), both)
    ]
    jumping = [
        of(_jumps(pattern, kind, *weight))
        for pattern in ("checkerboard", "layer")
        for kind, weight in itertools.product(TYPES, WEIGHTS)
    ]
    names = ("type", "level", "coarse_q", "subdomains_per_edge")
    more = sorted(of(numbers()), key=lambda r: [r[name] for name in names])
    chosen = of(choices())
    if all(r in own for r in chosen):
        chosen = []
    if all(r in own for r in more):
        more = []
    return {
        "deviations": [] if math.isnan(condition) else [whole],
        "linear": list(_papers(own, 1, TYPES)),
        "floating": list(_papers(own, 2, ["all_floating"])),
        "classical": list(_papers(own, 2, ["classical"])),
        "errors": section(_errors(own)),
        "larger": section(row for mine in growing if len(mine) > 1 for row in _growth(mine)),
        "fits": section(
            mine[0]
            | {"sources": mine}
            | dict(zip(("a", "b", "off"), fit_growth(mine), strict=True))
            for mine in growing
            if len(mine) > 2
        ),
        "choices": section(r | {"fcg": "yes" if r["reorthogonalize"] else "no"} for r in chosen),
        "jumps": section(_jumping(mine) for mine in jumping if any(r["jump"] > 1.0 for r in mine)),
        "more": section(
            r | {"share": 100 * r["seconds_coarse"] / r["seconds_setup"]} for r in more
        ),
        "costs": section(r | {"each": r["cpu_seconds_solve"] / r["iterations"]} for r in own),
    }


def deviations(own: Sequence[Record]) -> tuple[float, int]:
    """Return the largest deviations from the paper: κ, relative; iterations."""
    both = [(r, theirs) for r in own if (theirs := _papers_solve(r)) is not None]
    iterations = [abs(r["iterations"] - its) for r, (its, _) in both]
    condition = [abs(r["condition_number"] / known - 1.0) for r, (_, known) in both]
    return max(condition, default=math.nan), max(iterations, default=0)


def _papers_solve(record: Record) -> tuple[int, float] | None:
    if record["degree"] != 1:
        return None
    return paper.LINEAR.get((record["type"], record["pc"], record["level"]))


def _papers(own: Sequence[Record], degree: int, kinds: Iterable[str]) -> Iterator[Record]:
    """Yield a section for each type: iterations and condition numbers over the levels."""
    for kind in kinds:
        mine = [r for r in own if (r["degree"], r["type"]) == (degree, kind)]
        by_level = [of_level for _, of_level in groups(mine, "level")]
        rows = [
            of_level[0] | {"sources": of_level} | {r["pc"]: _solve(r) for r in of_level}
            for of_level in by_level
        ]
        yield from section(rows, name=TYPES[kind])


def _solve(record: Record) -> dict[str, str]:
    """Return iterations and condition number as text, with the paper's in brackets."""
    its = record["iterations"]
    condition = record["condition_number"]
    number = FORMS["number"](condition)
    if (theirs := _papers_solve(record)) is None:
        return {"its": str(its), "kappa": number}
    off = FORMS["off"](condition / theirs[1])
    return {"its": f"{its} ({theirs[0]})", "kappa": f"{number} ({theirs[1]:.1f}, {off})"}


def _errors(records: Sequence[Record]) -> Iterator[dict[str, object]]:
    """Yield L2 errors and their order (eq. 54), which do not depend on the preconditioner."""
    scale = error_scale(records)
    known = {(r["degree"], r["type"], r["level"]): r for r in records}
    for (degree, kind, level), record in known.items():
        error = record["l2_error"]
        coarser = known.get((degree, kind, level - 1))
        eoc = math.log2(coarser["l2_error"] / error) if coarser else None
        theirs = paper.L2_ERRORS.get((kind, level)) if degree == 1 else None
        ratio = scale * error / theirs if theirs else None
        yield record | {"eoc": eoc, "paper": theirs, "ratio": ratio}


def _growth(mine: Sequence[Record]) -> Iterator[Record]:
    """Yield a row of condition numbers and one of iterations over H/h."""
    for what, name, form in (("κ", "condition_number", ".4g"), ("it.", "iterations", "d")):
        at = {r["level"]: f"{r[name]:{form}}" for r in mine}
        yield mine[0] | {"what": what, "at": at, "sources": mine}


def _jumping(mine: Sequence[Record]) -> Record:
    """Return a row of iterations and condition numbers over the jump."""
    at = {f"{r['jump']:.0e}": f"{r['iterations']} ({r['condition_number']:.3g})" for r in mine}
    return mine[-1] | {"at": at, "sources": mine}


def fit_growth(records: Sequence[Record]) -> tuple[float, float, float]:
    """Fit √κ = a + b ln(H/h) over levels; return a, b, and one plus the largest error of κ."""
    x = np.log([2.0 ** (r["level"] - 1) for r in records])
    condition = np.array([r["condition_number"] for r in records])
    b, a = np.polyfit(x, np.sqrt(condition), 1)
    return a, b, 1.0 + float(np.max(np.abs((a + b * x) ** 2 / condition - 1.0)))


def error_scale(own: Sequence[Record]) -> float:
    """Return the mean quotient of the paper's L2 errors and ours; its source point is unknown."""
    quotients = [
        paper.L2_ERRORS[r["type"], r["level"]] / r["l2_error"] for r in own if r["degree"] == 1
    ]
    return math.exp(sum(map(math.log, quotients)) / len(quotients)) if quotients else math.nan


def _is_known(record: Record) -> bool:
    return "condition_number" in record


def _options(parser: argparse.ArgumentParser) -> None:
    command.add_choices(parser, "--sets", list(SETS))


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="linear",
    known=_is_known,
    options=_options,
    cases=_cases,
    run=_run,
    fields=_fields,
)

if __name__ == "__main__":
    STUDY.main()
