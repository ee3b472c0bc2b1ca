# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The linear study of the paper: the unit cube in 512 subdomains, in all variants.

    mpirun -n 2 python3 -m benchmarks.cube --sets all --json build/linear.json
    python3 -m benchmarks.cube --degree 2 --level 1,2 --type classical --pc lumped

--sets runs the cases of the whole study: the paper's table, and what goes beyond it. Without it an
option that takes several values runs all combinations. The defaults are the paper's choices: 8 × 8
× 8 subdomains, multiplicity scaling, Q = I, full gluing, a reduction of the dual residual by 1e-8;
E = 210, ν = 0.45, and on the whole surface the displacements of the fundamental solution with its
source at (2, 2, 2).
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, replace

from mpi4py import MPI

import numpy as np

from benchmarks.common import command, paper
from benchmarks.common.cube import (
    LEVELS,
    PATTERNS,
    Case,
    l2_error,
    solve,
)
from benchmarks.common.pages import FORMS, groups, section
from benchmarks.common.records import Record
from benchmarks.common.study import Keep, Study
from dolfinx_feti.comparison import PeakMemory
from dolfinx_feti.feti.options import CHOICES
from meshes.arguments import count, positive

TYPES = {"all_floating": "all-floating", "classical": "classical"}

PRECONDITIONERS = ("identity", "lumped", "dirichlet")

#: Parameters that the paper's own cases do not vary.
FIXED = {
    name: value
    for name, value in asdict(Case()).items()
    if name not in ("degree", "level", "type", "pc", "source", "interior")
}


#: Coefficients of the stiff subcubes, and the scalings and weights Q that are tried on them.
JUMPS = (1e2, 1e4, 1e6)

WEIGHTS = tuple(itertools.product(("multiplicity", "stiffness"), ("identity", "preconditioner")))

#: Options that take several of some values, the first of which is the default.
VARIED = {
    "degree": (1, 2),
    "level": tuple(LEVELS),
    "type": CHOICES["type"],
    "pc": CHOICES["pc_type"],
    "scaling": ("multiplicity", "stiffness"),
    "coarse_q": ("identity", *(q for q in CHOICES["coarse_q"] if q != "identity")),
    "pattern": tuple(PATTERNS),
}
NUMBERS = {
    "subdomains_per_edge": (count, 8),
    "jump": (positive, 1.0),
    "coarse_modes": (command.count_or_zero, 0),
}


def papers() -> Iterator[Case]:
    """The paper's table, and the same with quadratic elements."""
    for degree, levels in ((1, (1, 2, 3)), (2, (1, 2))):
        for level in levels:
            yield from _all(Case(degree=degree, level=level))


def choices() -> Iterator[Case]:
    """One choice at a time that is not the paper's, and this package's own."""
    own = {"scaling": "stiffness", "coarse_q": "preconditioner"}
    changes = (
        {"reorthogonalize": True},
        {"coarse_q": "diagonal"},
        {"coarse_q": "preconditioner"},
        {"scaling": "stiffness"},
        own,
        own | {"coarse_modes": 12},
    )
    for kind, change in itertools.product(TYPES, changes):
        yield Case(level=2, type=kind, **change)
    for kind, pc in itertools.product(TYPES, ("identity", "lumped")):
        yield Case(level=2, type=kind, pc=pc, reorthogonalize=True)


def jumps() -> Iterator[Case]:
    """Young's modulus jumps between subcubes: a checkerboard, and a stiff layer."""
    patterns = [("none", 1.0), *itertools.product(("checkerboard", "layer"), JUMPS)]
    for (pattern, jump), kind, (scaling, q) in itertools.product(patterns, TYPES, WEIGHTS):
        choice = {"type": kind, "scaling": scaling, "coarse_q": q}
        yield Case(subdomains_per_edge=4, level=2, pattern=pattern, jump=jump, **choice)


def growth() -> Iterator[Case]:
    """More cells in a subdomain, in a cube of 64."""
    for level in (1, 2, 3, 4):
        yield from _all(Case(subdomains_per_edge=4, level=level))


def numbers() -> Iterator[Case]:
    """More subdomains of the same size, with the paper's weight Q and this package's."""
    for level, edge, q in itertools.product((1, 2), (2, 4, 8, 16), ("identity", "preconditioner")):
        yield from _all(Case(level=level, subdomains_per_edge=edge, coarse_q=q), ["dirichlet"])
    yield from _all(Case(subdomains_per_edge=32), ["dirichlet"])


def largest() -> Iterator[Case]:
    """What takes the most memory: the paper's fourth level, and the third of quadratic elements."""
    for degree, level in ((1, 4), (2, 3)):
        yield from _all(Case(degree=degree, level=level))


#: Parts of the study by name.
SETS = {each.__name__: each for each in (papers, choices, jumps, growth, numbers, largest)}


def _all(case: Case, preconditioners: Sequence[str] = PRECONDITIONERS) -> Iterator[Case]:
    """Both types with some preconditioners."""
    for kind, pc in itertools.product(TYPES, preconditioners):
        yield replace(case, type=kind, pc=pc)


def _options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    every = ["all", *SETS]
    add("--sets", type=command.some_of(every), help=f"some of {command.names(every)}")
    for name, values in VARIED.items():
        kind = {"type": command.some_of(values), "default": [values[0]]}
        add("--" + name.replace("_", "-"), **kind, help=command.names(values))
    for name, (read, value) in NUMBERS.items():
        kind = {"type": command.several(read), "default": [value]}
        add("--" + name.replace("_", "-"), **kind, help=str(value))
    add("--reorthogonalize", action="store_true", help="CG with full reorthogonalisation")


def _cases(
    args: argparse.Namespace, _parser: argparse.ArgumentParser, comm: MPI.Comm
) -> Iterator[Record]:
    """Yield the cases of some sets, each once, or all combinations."""
    if args.sets:
        names = SETS if "all" in args.sets else args.sets
        cases = dict.fromkeys(case for name in names for case in SETS[name]())
        yield from (c.key() for c in cases if c.subdomains_per_edge**3 >= comm.size)
        return
    fewest = min(args.subdomains_per_edge) ** 3
    if comm.size > fewest:
        raise ValueError(
            f"--subdomains-per-edge {min(args.subdomains_per_edge)} gives {fewest} subdomain(s) to "
            f"{comm.size} processes: take fewer processes, or as many subdomains at least"
        )
    if any((pattern == "none") != (jump == 1.0)
           for pattern, jump in itertools.product(args.pattern, args.jump)):  # fmt: skip
        raise ValueError(
            f"--jump {args.jump} and --pattern {args.pattern}: give both, how stiff and which "
            "subdomains, or none of them"
        )
    names = (*VARIED, *NUMBERS)
    for values in itertools.product(*(getattr(args, name) for name in names)):
        case = Case(reorthogonalize=args.reorthogonalize, **dict(zip(names, values, strict=True)))
        yield case.key()


def _run(key: Record, keep: Keep, _args: argparse.Namespace, comm: MPI.Comm) -> None:
    """Solve a case. Collective."""
    case = Case(**key | {"source": tuple(key["source"])})
    problem, peak = case.problem(comm), PeakMemory()
    linear, found = solve(problem, case.options())
    peak_mib = peak.mib(comm)
    error = l2_error(linear.u, problem.exact) if case.jump == 1.0 else None
    own = {"l2_error": error, "peak_mib": peak_mib if math.isfinite(peak_mib) else None}
    keep({}, found | own | {"processes": comm.size})


def _line(record: Record) -> str:
    error = "–" if record["l2_error"] is None else f"{record['l2_error']:.2e}"
    return (
        f"P{record['degree']}, level {record['level']}, {record['subdomains']} subdomains, "
        f"{record['type']}, {record['pc']}: {record['iterations']} it., κ = "
        f"{record['condition_number']:.4g}, L2 error {error}, set-up "
        f"{record['seconds_setup']:.2f} s, solve {record['seconds_solve']:.2f} s"
    )


def _fields(records: Sequence[Record]) -> dict[str, object]:
    """Return the values of the page."""
    solved = sorted((r | {"name": TYPES[r["type"]]} for r in records), key=order)
    own = [record for record in solved if is_papers(record)]
    condition, iterations = deviations(own)
    whole = {"condition": 100 * condition, "iterations": iterations, "scale": error_scale(own)}
    points = {tuple(record["source"]) for record in solved}
    return {
        "sources": ", ".join(f"({x:g}, {y:g}, {z:g})" for x, y, z in sorted(points)),
        "deviations": [] if math.isnan(condition) else [whole],
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
        "costs": section(r | {"each": r["cpu_seconds_solve"] / r["iterations"]} for r in own),
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
    return paper.LINEAR.get((record["type"], record["pc"], record["level"]))


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


def is_papers(record: Record) -> bool:
    """Tell whether a record has the paper's parameters."""
    return differs_in(record, ())


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


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="linear",
    known=lambda record: "condition_number" in record and "machine" in record,
    options=_options,
    cases=_cases,
    run=_run,
    line=_line,
    fields=_fields,
)

if __name__ == "__main__":
    STUDY.main()
