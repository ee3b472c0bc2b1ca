# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The tables of the comparison, and its figure.

The figure, which ``scripts/images.py`` draws for README, shows seconds of one linear solve over
dofs: first Newton steps with P2–P0 and κ = 1000 kPa, each solver in its faster layout.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from matplotlib.ticker import EngFormatter, LogLocator, NullLocator, StrMethodFormatter

from benchmarks.common.compare.geometries import GEOMETRIES
from benchmarks.common.compare.opponents import DIRECT, OPPONENTS
from benchmarks.common.pages import Fields, groups, section
from benchmarks.common.plots import COLOURS, Style, curve, picture
from benchmarks.common.records import Record

#: Keys that distinguish the cases of a page, in addition to the layout.
CASE = ("geometry", "degree", "kappa", "dofs", "wanted_subdomains", "path_mmhg", "loaded_mmhg")

#: κ between which the growth of iterations is shown [kPa]; the first is the base.
KAPPAS = (10.0, 1000.0, 1e5)

#: Names of the compressible bodies on the page.
COMPRESSIBLE = {
    name: geometry.title for name, geometry in GEOMETRIES.items() if geometry.is_compressible
}

#: Place of each body in the tables.
ORDER = {name: place for place, name in enumerate(GEOMETRIES)}

#: κ of the figure [kPa].
KAPPA = 1000.0

#: Keys that are None in a first step with the package's defaults.
SPECIAL = ("loaded_mmhg", "path_mmhg", "wanted_subdomains", "per")

#: Bodies of the figure.
BODIES = {name: GEOMETRIES[name].title for name in ("tube", "vessel", "block")}

#: Width and height of a panel of the figure in inches: its text is legible if the figure is 600
#: pixels wide.
PANEL = (2.6, 2.5)
#: Pixels per inch of the figure.
PANEL_DPI = 200
#: Leading digits of the ticks.
TICKS = (1.0, 2.0, 5.0)

#: The curves of the figure: their solvers, of which the fastest counts at each size, and their
#: style.
CURVES: dict[str, tuple[tuple[str, ...], Style]] = {
    "FETI": (("feti",), {"color": COLOURS[0], "marker": "o", "lw": 2}),
    "direct: MUMPS, CHOLMOD or PARDISO": (
        ("mumps", "cholmod", "pardiso"),
        {"color": COLOURS[1], "marker": "s"},
    ),
    "multigrid: GAMG or BoomerAMG": (
        ("gamg", "gamg-elasticity", "hypre-elasticity"),
        {"color": COLOURS[2], "marker": "^"},
    ),
}


#: The marks of the figure of compressible bodies: their solvers, of which the fastest counts on
#: each body, and their style.
FORMULATIONS: dict[str, tuple[tuple[str, ...], Style]] = {
    "FETI": (("feti",), {"color": COLOURS[0], "marker": "o", "ls": ""}),
    "FETI, dual": (("feti-dual",), {"color": COLOURS[0], "marker": "o", "ls": "", "mfc": "none"}),
    "MUMPS": (("mumps",), {"color": COLOURS[1], "marker": "s", "ls": ""}),
    "GAMG": (("gamg", "gamg-elasticity"), {"color": COLOURS[2], "marker": "^", "ls": ""}),
    "BoomerAMG": (("hypre-elasticity",), {"color": COLOURS[3], "marker": "v", "ls": ""}),
    "BDDC": (("bddc",), {"color": COLOURS[4], "marker": "D", "ls": ""}),
}


def fields(records: Sequence[Record]) -> Fields:
    """Return the values of the page.

    A case is the list of the records of all solvers in all layouts, processes and threads.
    """
    sweep = [r for r in records if r.get("per")]
    others = [r for r in records if not r.get("per")]
    all_cases = sorted((case for _, case in groups(others, *CASE)), key=_order)
    compressible = [case for case in all_cases if case[0]["geometry"] in COMPRESSIBLE]
    cases = [case for case in all_cases if case[0]["geometry"] not in COMPRESSIBLE]
    single_steps = [case for case in cases if case[0]["path_mmhg"] is None]
    paths = [case for case in cases if case[0]["path_mmhg"] is not None]
    by_body = itertools.groupby(single_steps, lambda case: (case[0]["geometry"], case[0]["kappa"]))
    return {
        "summary": section(_compared_rows(cases)),
        "steps": [_step_section(body, kappa, list(of_body)) for (body, kappa), of_body in by_body],
        "formulations": section(map(_formulations_row, compressible)),
        "compressible": section(row for case in compressible for row in _rows(case)),
        "paths": section(row for case in paths for row in _rows(case)),
        "sweep": section(_sweep_rows(sweep)),
        "growth": section(_growth_rows(single_steps), low=KAPPAS[0]),
        "failures": section(
            _row(r) for case in (*cases, *compressible) for r in case if not r["converged"]
        ),
    }


def _step_section(body: str, kappa: float, cases: Sequence[Sequence[Record]]) -> Fields:
    """Return the section of a body and a κ: its rows, and the range of FETI's time ratios.

    Args:
        body: Name of the body.
        kappa: κ [kPa].
        cases: Its cases, of a single Newton step each.
    """
    compared = _compared_rows(cases)
    ratios = [row["time_ratio"] for row in compared]
    return {
        "geometry": body,
        "kappa": kappa,
        "rows": [row for case in cases for row in _rows(case)],
        "least_ratio": min(ratios, default=math.nan),
        "largest_ratio": max(ratios, default=math.nan),
        "compared": len(compared),
    }


def _order(case: Sequence[Record]) -> tuple[float, ...]:
    """Return the key that sorts the cases of the page."""
    record = case[0]
    return (
        ORDER[record["geometry"]],
        record["kappa"] or 0.0,
        record["path_mmhg"] or 0.0,
        record["loaded_mmhg"] or 0.0,
        -record["degree"],
        record["dofs"],
        record["wanted_subdomains"] or 0,
    )


def _of_solver(case: Sequence[Record], *solvers: str) -> list[Record]:
    """Return the records of some solvers in a case, the fastest first, failures at the end."""
    return sorted((r for r in case if r["solver"] in solvers), key=_ranking_seconds)


def _best(case: Sequence[Record], *solvers: str) -> Record | None:
    """Return the fastest record of some solvers in a case; None if none solved it."""
    return next((r for r in _of_solver(case, *solvers) if math.isfinite(_ranking_seconds(r))), None)


def _rows(case: Sequence[Record]) -> Iterator[dict[str, object]]:
    """Yield a row for each record, with the ratios of FETI's faster layout to it."""
    feti = _best(case, "feti")
    for solver in OPPONENTS:
        of_solver = _of_solver(case, solver)
        for record in of_solver:
            row = _row(record)
            if len(of_solver) > 1 and record is _best(case, solver):
                row["layout"] = f"**{row['layout']}**"
            if feti and record["converged"] and solver != "feti":
                row |= _ratios(feti, record)
            yield row


def _compared_rows(cases: Sequence[Sequence[Record]]) -> list[dict[str, Any]]:
    """Return a row with FETI and the best other solver for each case that both solved."""
    rows = (_compared_row(case) for case in cases)
    return [row for row in rows if row is not None]


def _compared_row(case: Sequence[Record]) -> dict[str, Any] | None:
    """Return a row with FETI's faster layout and the best other solver, or None without both.

    The values of the other solver have names that begin with ``other_``.
    """
    feti = _best(case, "feti")
    other = _best(case, *(name for name in OPPONENTS if name != "feti"))
    if feti is None or other is None:
        return None
    direct = _best(case, *DIRECT)
    row = _row(feti) | _ratios(feti, other)
    row |= {f"other_{name}": value for name, value in _row(other).items()}
    row["memory_ratio"] = None if direct is None else _ratios(feti, direct)["memory_ratio"]
    row["sources"] = [record for record in (feti, other, direct) if record is not None]
    return row


def seconds(record: Record) -> float:
    """Return the seconds of set-up and solution; infinite without a solution."""
    if not record["converged"]:
        return math.inf
    return record["seconds_setup"] + record["seconds_solve"]


def _row(record: Record) -> dict[str, Any]:
    """Return the row of a record: names, layout and means; no results if the solver failed."""
    solver = OPPONENTS[record["solver"]]
    geometry = GEOMETRIES[record["geometry"]]
    row = dict(record) | {"name": solver.title, "layout": _layout(record)}
    path = record["path_mmhg"]
    loaded = record["loaded_mmhg"]
    row["load"] = "at rest" if path is None else f"path to {path:g} mmHg"
    row["load"] = row["load"] if loaded is None else f"at {loaded:g} mmHg"
    row["element"] = f"{geometry.family}{record['degree']}"
    if geometry.is_compressible:
        row["body"] = geometry.title
        row["load"] = "weight"
        row["difference"] = record.get("difference_to_mumps")
    else:
        row["element"] += "–P0"
    if not solver.is_torn:
        row["subdomains"] = None
    if not record["converged"]:
        results = ("seconds_solve", "iterations", "peak_mib", "relative_residual", "spread")
        results += ("linear_solves", "seconds_per_newton", "seconds_assembly", "seconds_end_to_end")
        return row | dict.fromkeys(results) | {"seconds_setup": None, "setup": "failed"}
    row |= {"seconds": seconds(record), "setup": f"{record['seconds_setup']:.2f}"}
    row["spread"] = _spread(record)
    later = record.get("iterations_per_solve", [])[1:]
    return row | {"later": sum(later) / len(later) if later else None}


def _spread(record: Record) -> str:
    """Return the seconds as text, with the least and the most of all rounds in brackets."""
    rounds = [sum(pair) for pair in record.get("seconds_rounds", []) if None not in pair]
    if len(rounds) < 2:
        return f"{_ranking_seconds(record):.2f}"
    return f"{_ranking_seconds(record):.2f} ({min(rounds):.2f}–{max(rounds):.2f})"


def _formulations_row(case: Sequence[Record]) -> dict[str, Any]:
    """Return a row with FETI's two formulations and the best other solver."""
    primal = _best(case, "feti")
    dual = _best(case, "feti-dual")
    other = _best(case, *(name for name in OPPONENTS if name not in ("feti", "feti-dual")))
    compared = {"primal": primal, "dual": dual, "other": other}
    row = _row(case[0])
    row["sources"] = [record for record in compared.values() if record is not None]
    unsolved = dict.fromkeys(("iterations", "spread", "peak_mib", "name"))
    for prefix, record in compared.items():
        values = unsolved if record is None else _row(record)
        row |= {f"{prefix}_{name}": value for name, value in values.items()}
    row["of_dual"] = _ranking_seconds(primal) / _ranking_seconds(dual) if primal and dual else None
    row["of_other"] = (
        _ranking_seconds(primal) / _ranking_seconds(other) if primal and other else None
    )
    return row


def _ratios(feti: Record, other: Record) -> dict[str, float | None]:
    """Return FETI's time and memory over those of another solver."""
    feti_mib = feti["peak_mib"]
    other_mib = other["peak_mib"]
    return {
        "time_ratio": _ranking_seconds(feti) / _ranking_seconds(other),
        "linear_ratio": seconds(feti) / seconds(other),
        "memory_ratio": feti_mib / other_mib if feti_mib and other_mib else None,
    }


def _growth_rows(cases: Sequence[Sequence[Record]]) -> Iterator[dict[str, Any]]:
    """Yield a row for each iterative solver, size and layout: the least κ and a larger one."""
    names = ("solver", *(name for name in CASE if name != "kappa"), "processes", "threads")
    solved = [
        record
        for case in cases
        for solver in OPPONENTS
        if solver not in DIRECT
        for record in _of_solver(case, solver)
        if record["converged"] and record["kappa"] in KAPPAS
    ]
    solved.sort(key=lambda record: record["kappa"])
    for _, (low, *larger) in groups(solved, *names):
        for high in larger:
            yield _row(low) | {
                "low_its": low["iterations"],
                "high_its": high["iterations"],
                "quotient": high["iterations"] / low["iterations"],
                "high": high["kappa"],
                "sources": [low, high],
            }


def _ranking_seconds(record: Record) -> float:
    """Return the seconds that solvers are ranked by: of a path end to end; infinite if unsolved."""
    is_solved = record["converged"] and not record["note"].startswith("the residual is above")
    return record.get("seconds_end_to_end", seconds(record)) if is_solved else math.inf


def _layout(record: Record) -> str:
    """Return processes and threads as text."""
    processes = record["processes"]
    threads = record["threads"]
    plural = "" if processes == 1 else "es"
    times_threads = "" if threads == 1 else f" × {threads} threads"
    return f"{processes} process{plural}{times_threads}"


def _sweep_rows(records: Sequence[Record]) -> list[dict[str, Any]]:
    """Return a row for each body, size and number of processes of a sweep over subdomains."""
    rows = []
    names = ("geometry", "degree", "processes", "wanted_dofs")
    for (geometry, degree, processes, wanted), of_row in groups(records, *names):
        least = min(r["seconds_cpu"] for r in of_row if r["converged"])
        iterations = [r["iterations"] for r in of_row if r["subdomains"] > 1]
        place = (processes, ORDER[geometry], degree, wanted)
        at = {r["per"]: f"{r['seconds_cpu'] / least:.2f}" for r in of_row}
        fewest = min(iterations, default=None)
        most = max(iterations, default=None)
        row = {"fewest": fewest, "most": most, "place": place, "at": at, "sources": of_row}
        rows.append(of_row[0] | row)
    return sorted(rows, key=lambda row: row["place"])


def points(
    records: Sequence[Record], geometry: str, solvers: Sequence[str]
) -> list[tuple[float, float]]:
    """Return dofs and seconds of the fastest of some solvers on a body, by size.

    Args:
        records: Records of the study.
        geometry: Name of the body.
        solvers: Names of the solvers.
    """
    case = {"geometry": geometry, "kappa": KAPPA, "degree": 2, "converged": True}
    of_solvers = [r for r in records if case.items() <= r.items() and r["solver"] in solvers]
    by_size = groups((r for r in of_solvers if _is_plain(r)), "dofs")
    return sorted((dofs, min(map(seconds, of_size))) for (dofs,), of_size in by_size)


def _is_plain(record: Record) -> bool:
    """Return True if a record is that of a first step with the package's defaults."""
    return not any(record.get(name) for name in SPECIAL)


def draw(records: Sequence[Record], path: Path, *, dark: bool = False) -> None:
    """Draw the panels of BODIES.

    Args:
        records: Records of the study.
        path: The picture's file.
        dark: Whether it is for dark pages.
    """
    legend = {name: style for name, (_, style) in CURVES.items()}
    with picture(
        path, 1, len(BODIES), legend, dark=dark, panel=PANEL, dpi=PANEL_DPI, sharey=True
    ) as axes:
        for ax, (geometry, title) in zip(axes[0], BODIES.items(), strict=True):
            for solvers, style in CURVES.values():
                curve(ax, points(records, geometry, solvers), **style)
            ax.set(title=title, xlabel="dofs", xscale="log", yscale="log")
            for axis in (ax.xaxis, ax.yaxis):
                axis.set_major_locator(LogLocator(subs=TICKS))
                axis.set_minor_locator(NullLocator())
            ax.xaxis.set_major_formatter(EngFormatter(sep=""))
            ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes[0, 0].set_ylabel("set-up and solve [s],\ntwo cores")


def draw_compressible(records: Sequence[Record], folder: Path) -> list[Fields]:
    """Draw the seconds of each solver on each compressible body, and of both formulations."""
    solved = [
        record
        for record in records
        if _is_plain(record) and record["geometry"] in COMPRESSIBLE and record["converged"]
    ]
    times_of = {  # the least seconds by name of the mark and of the body
        name: {
            body: min(map(seconds, of_body))
            for (body,), of_body in groups(
                (record for record in solved if record["solver"] in solvers), "geometry"
            )
        }
        for name, (solvers, _) in FORMULATIONS.items()
    }
    bodies = [name for name in COMPRESSIBLE if any(name in times for times in times_of.values())]
    if not times_of["FETI, dual"]:
        return []
    legend = {name: style for name, (_, style) in FORMULATIONS.items()}
    with picture(folder / "speed_compressible.png", 1, 2, legend, sharey=True) as axes:
        half = len(bodies) // 2
        for ax, of_panel in zip(axes[0], (bodies[:half], bodies[half:]), strict=True):
            for name, (_, style) in FORMULATIONS.items():
                times = times_of[name]
                marks = [(i, times[body]) for i, body in enumerate(of_panel) if body in times]
                curve(ax, marks, **style)
            titles = [COMPRESSIBLE[body].replace(", ", ",\n") for body in of_panel]
            ax.set_yscale("log")
            ax.set_xticks(range(len(of_panel)), titles)
            ax.set_xlim(-0.5, max(len(of_panel), 1) - 0.5)
        axes[0, 0].set_ylabel("set-up and solve [s]")
    return [{"picture": "speed_compressible.png"}]
