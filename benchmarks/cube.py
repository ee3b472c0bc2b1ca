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
            yield from _with_all_choices(Case(degree=degree, level=level))


def choices() -> Iterator[Case]:
    """Yield cases with one choice that is not the paper's, and with this package's choices."""
    packages = {"scaling": "stiffness", "coarse_q": "preconditioner"}
    changes = (
        {},
        {"reorthogonalize": True},
        {"coarse_q": "diagonal"},
        {"coarse_q": "preconditioner"},
        {"scaling": "stiffness"},
        packages,
        packages | {"coarse_modes": 12},
    )
    for kind in TYPES:
        for pc, is_full in itertools.product(("identity", "lumped"), (False, True)):
            yield Case(level=2, type=kind, pc=pc, reorthogonalize=is_full)
        for change in changes:
            yield Case(level=2, type=kind, **change)


def jumps() -> Iterator[Case]:
    """Yield cases whose Young's modulus jumps between subcubes: a checkerboard, a stiff layer."""
    for pattern, kind, weight in itertools.product(("checkerboard", "layer"), TYPES, WEIGHTS):
        yield from _jumps(pattern, kind, *weight)


def _jumps(pattern: str, kind: str, scaling: str, q: str) -> Iterator[Case]:
    """Yield the cases of one series of rising jumps, with 4 × 4 × 4 subdomains.

    Args:
        pattern: Which subcubes are stiff, a key of ``PATTERNS``.
        kind: ``feti_type``.
        scaling: ``feti_scaling``.
        q: ``feti_coarse_q``.
    """
    even = Case(1, 2, 4, kind, scaling=scaling, coarse_q=q)
    for jump in JUMPS:
        yield replace(even, jump=jump, pattern=pattern if jump > 1.0 else "none")


def growth() -> Iterator[Case]:
    """Yield cases with more and more cells in each of 64 subdomains."""
    for level in LEVELS:
        yield from _with_all_choices(Case(subdomains_per_edge=4, level=level))


def numbers() -> Iterator[Case]:
    """Yield cases with more and more subdomains of one size, with two weights Q."""
    for level, q, edge in itertools.product((1, 2), ("identity", "preconditioner"), (2, 4, 8, 16)):
        yield from _with_all_choices(
            Case(level=level, subdomains_per_edge=edge, coarse_q=q), ["dirichlet"]
        )
    yield from _with_all_choices(Case(subdomains_per_edge=32), ["dirichlet"])


def largest() -> Iterator[Case]:
    """Yield the largest cases: the paper's fourth level, and the third of quadratic elements."""
    for degree, level in ((1, 4), (2, 3)):
        yield from _with_all_choices(Case(degree=degree, level=level))


#: Sets of cases by name.
SETS = {
    "papers": papers,
    "choices": choices,
    "jumps": jumps,
    "growth": growth,
    "numbers": numbers,
    "largest": largest,
}


def _with_all_choices(
    case: Case, preconditioners: Sequence[str] = PRECONDITIONERS
) -> Iterator[Case]:
    """Yield a case with both types and each of the preconditioners."""
    for kind, pc in itertools.product(TYPES, preconditioners):
        yield replace(case, type=kind, pc=pc)


def _cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    """Yield the cases of the chosen sets, each once, that have a subdomain for each process."""
    cases = dict.fromkeys(case for name in args.sets for case in SETS[name]())
    yield from (asdict(case) for case in cases if case.subdomains_per_edge**3 >= comm.size)


def _run(key: Record, keep: Keep, _args: Arguments, comm: MPI.Comm) -> None:
    """Solve a case. Collective."""
    case = Case(**key)
    create_linear_problem, exact = create_problem(case, comm)
    peak = PeakMemory()
    linear = create_linear_problem()
    values = solve(linear)
    peak_mib = peak.mib(comm)
    values["l2_error"] = l2_error(linear.u, exact) if case.jump == 1.0 else None
    values["peak_mib"] = peak_mib if math.isfinite(peak_mib) else None
    values["processes"] = comm.size
    keep({}, values)


def case_of(record: Record) -> Case:
    """Return the parameters of a record."""
    return Case(**{field.name: record[field.name] for field in fields(Case)})


def _fields(records: Sequence[Record]) -> dict[str, object]:
    """Return the values of the page."""
    by_case = {case_of(record): record | {"name": TYPES[record["type"]]} for record in records}

    def recorded(cases: Iterable[Case]) -> list[Record]:
        return [by_case[case] for case in dict.fromkeys(cases) if case in by_case]

    with_papers_choices = recorded(
        Case(degree, level, type=kind, pc=pc)
        for degree, kind, level, pc in itertools.product((1, 2), TYPES, LEVELS, PRECONDITIONERS)
    )
    condition, iterations = deviations(with_papers_choices)
    growing = [
        recorded(Case(degree, level, edge, kind) for level in LEVELS)
        for edge, degree, kind in itertools.product((4, 8), (1, 2), TYPES)
    ]
    jumping = [
        recorded(_jumps(pattern, kind, *weight))
        for pattern in ("checkerboard", "layer")
        for kind, weight in itertools.product(TYPES, WEIGHTS)
    ]
    names = ("type", "level", "coarse_q", "subdomains_per_edge")
    of_numbers = sorted(recorded(numbers()), key=lambda record: [record[name] for name in names])
    of_choices = recorded(choices())
    if all(record in with_papers_choices for record in of_choices):
        of_choices = []  # no other choice is on record
    if all(record in with_papers_choices for record in of_numbers):
        of_numbers = []
    return {
        "deviations": []
        if math.isnan(condition)
        else [
            {
                "condition": 100 * condition,
                "iterations": iterations,
                "scale": error_scale(with_papers_choices),
            }
        ],
        "linear": list(_solve_sections(with_papers_choices, 1, TYPES)),
        "floating": list(_solve_sections(with_papers_choices, 2, ["all_floating"])),
        "classical": list(_solve_sections(with_papers_choices, 2, ["classical"])),
        "errors": section(_error_rows(with_papers_choices)),
        "larger": section(
            row for levels in growing if len(levels) > 1 for row in _growth_rows(levels)
        ),
        "fits": section(_fit_row(levels) for levels in growing if len(levels) > 2),
        "choices": section(
            record | {"fcg": "yes" if record["reorthogonalize"] else "no"} for record in of_choices
        ),
        "jumps": section(
            _jump_row(series) for series in jumping if any(r["jump"] > 1.0 for r in series)
        ),
        "more": section(
            record | {"share": 100 * record["seconds_coarse"] / record["seconds_setup"]}
            for record in of_numbers
        ),
        "costs": section(
            record | {"each": record["cpu_seconds_solve"] / record["iterations"]}
            for record in with_papers_choices
        ),
    }


def deviations(records: Sequence[Record]) -> tuple[float, int]:
    """Return the largest deviations of records from the paper.

    Returns:
        That of the condition number, relative to the paper's, NaN without one; and that of the
        number of iterations.
    """
    conditions = []
    iterations = []
    for record in records:
        printed = _printed_solve(record)
        if printed is not None:
            printed_iterations, printed_condition = printed
            iterations.append(abs(record["iterations"] - printed_iterations))
            conditions.append(abs(record["condition_number"] / printed_condition - 1.0))
    return max(conditions, default=math.nan), max(iterations, default=0)


def _printed_solve(record: Record) -> tuple[int, float] | None:
    """Return iterations and condition number of the paper for a case, or None."""
    if record["degree"] != 1:
        return None
    return paper.LINEAR.get((record["type"], record["pc"], record["level"]))


def _solve_sections(
    records: Sequence[Record], degree: int, kinds: Iterable[str]
) -> Iterator[Record]:
    """Yield a section for each type: iterations and condition numbers over the levels.

    Args:
        records: Records with the paper's choices.
        degree: Degree of the displacement.
        kinds: Values of ``feti_type``.
    """
    for kind in kinds:
        of_kind = [r for r in records if (r["degree"], r["type"]) == (degree, kind)]
        rows = [
            of_level[0] | {"sources": of_level} | {r["pc"]: _solve_texts(r) for r in of_level}
            for _, of_level in groups(of_kind, "level")
        ]
        yield from section(rows, name=TYPES[kind])


def _solve_texts(record: Record) -> dict[str, str]:
    """Return iterations and condition number as text, with the paper's in brackets."""
    iterations = record["iterations"]
    condition = record["condition_number"]
    number = FORMS["number"](condition)
    printed = _printed_solve(record)
    if printed is None:
        return {"its": str(iterations), "kappa": number}
    printed_iterations, printed_condition = printed
    deviation = FORMS["off"](condition / printed_condition)
    return {
        "its": f"{iterations} ({printed_iterations})",
        "kappa": f"{number} ({printed_condition:.1f}, {deviation})",
    }


def _error_rows(records: Sequence[Record]) -> Iterator[dict[str, object]]:
    """Yield L2 errors and their order (eq. 54), which do not depend on the preconditioner."""
    scale = error_scale(records)
    by_mesh = {(r["degree"], r["type"], r["level"]): r for r in records}
    for (degree, kind, level), record in by_mesh.items():
        error = record["l2_error"]
        coarser = by_mesh.get((degree, kind, level - 1))
        printed_error = paper.L2_ERRORS.get((kind, level)) if degree == 1 else None
        yield record | {
            "eoc": math.log2(coarser["l2_error"] / error) if coarser else None,
            "paper": printed_error,
            "ratio": scale * error / printed_error if printed_error else None,
        }


def _growth_rows(levels: Sequence[Record]) -> Iterator[Record]:
    """Yield a row of condition numbers and one of iterations over H/h."""
    for what, name, form in (("κ", "condition_number", ".4g"), ("it.", "iterations", "d")):
        at = {record["level"]: f"{record[name]:{form}}" for record in levels}
        yield levels[0] | {"what": what, "at": at, "sources": levels}


def _fit_row(levels: Sequence[Record]) -> Record:
    """Return a row with the fitted growth of the condition number over H/h."""
    a, b, deviation = fit_growth(levels)
    return levels[0] | {"sources": levels, "a": a, "b": b, "off": deviation}


def _jump_row(series: Sequence[Record]) -> Record:
    """Return a row of iterations and condition numbers over the jump."""
    at = {f"{r['jump']:.0e}": f"{r['iterations']} ({r['condition_number']:.3g})" for r in series}
    return series[-1] | {"at": at, "sources": series}


def fit_growth(records: Sequence[Record]) -> tuple[float, float, float]:
    """Fit √κ = a + b ln(H/h) over levels.

    Returns:
        a, b, and one plus the largest relative error of κ.
    """
    x = np.log([2.0 ** (r["level"] - 1) for r in records])
    condition = np.array([r["condition_number"] for r in records])
    b, a = np.polyfit(x, np.sqrt(condition), 1)
    return a, b, 1.0 + float(np.max(np.abs((a + b * x) ** 2 / condition - 1.0)))


def error_scale(records: Sequence[Record]) -> float:
    """Return the geometric mean of the paper's L2 errors over ours; NaN without linear elements.

    The quotient differs from one because the paper's source point is unknown.
    """
    quotients = [
        paper.L2_ERRORS[r["type"], r["level"]] / r["l2_error"] for r in records if r["degree"] == 1
    ]
    return math.exp(sum(map(math.log, quotients)) / len(quotients)) if quotients else math.nan


def _is_known(record: Record) -> bool:
    """Return True if a record has the parameters of a case and its spectrum."""
    return record.keys() >= {field.name for field in fields(Case)} | {"condition_number"}


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
