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

from matplotlib.ticker import EngFormatter, LogLocator, NullLocator, StrMethodFormatter

from benchmarks.common.compare.geometries import GEOMETRIES
from benchmarks.common.compare.opponents import DIRECT, OPPONENTS
from benchmarks.common.pages import Fields, groups, section
from benchmarks.common.plots import COLOURS, Style, curve, picture
from benchmarks.common.records import Record

#: Keys that distinguish the cases of a page, in addition to the layout.
CASE = ("geometry", "degree", "kappa", "dofs", "wanted_subdomains", "path_mmhg", "loaded_mmhg")

#: Volume stiffness at the ends of the comparison [kPa].
KAPPAS = (10.0, 1000.0, 1e5)

#: Names of the compressible bodies on the page.
COMPRESSIBLE = {
    name: geometry.title for name, geometry in GEOMETRIES.items() if geometry.is_compressible
}

#: Places of the bodies in the tables.
ORDER = {name: place for place, name in enumerate(GEOMETRIES)}

KAPPA = 1000.0

#: Keys that are None in a first step with the package's defaults.
SPECIAL = ("loaded_mmhg", "path_mmhg", "wanted_subdomains", "per")

#: Bodies of the figure.
BODIES = {name: GEOMETRIES[name].title for name in ("tube", "vessel", "block")}

#: Width and height of a panel of the figure in inches: its text is legible if the figure is 600
#: pixels wide. Pixels per inch, and leading digits of the ticks.
PANEL = (2.6, 2.5)
PANEL_DPI = 200
TICKS = (1.0, 2.0, 5.0)

#: The curves of the figure: their solvers, of which the fastest counts at each size, and their
#: style. A name that is not in OPPONENTS has no records.
CURVES: dict[str, tuple[tuple[str, ...], Style]] = {
    "FETI": (("feti",), {"color": COLOURS[0], "marker": "o", "lw": 2}),
    "direct: MUMPS, CHOLMOD or PARDISO": (
        ("mumps", "cholmod", "pardiso"),
        {"color": COLOURS[1], "marker": "s"},
    ),
    "multigrid: GAMG or BoomerAMG": (
        ("gamg", "gamg-elasticity", "hypre", "hypre-elasticity"),
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
    plain = [r for r in records if not r.get("per")]
    cases = sorted((mine for _, mine in groups(plain, *CASE)), key=_order)
    compressible = [case for case in cases if case[0]["geometry"] in COMPRESSIBLE]
    cases = [case for case in cases if case[0]["geometry"] not in COMPRESSIBLE]
    first = [case for case in cases if case[0]["path_mmhg"] is None]
    paths = [case for case in cases if case[0]["path_mmhg"] is not None]
    steps = itertools.groupby(first, lambda case: (case[0]["geometry"], case[0]["kappa"]))
    return {
        "summary": section(row for case in cases if (row := _against_the_best(case))),
        "steps": [_steps(body, kappa, list(mine)) for (body, kappa), mine in steps],
        "formulations": section(map(_formulations, compressible)),
        "compressible": section(row for case in compressible for row in _rows(case)),
        "paths": section(row for case in paths for row in _rows(case)),
        "sweep": section(_subdomains(sweep)),
        "growth": section(_growth(first), low=KAPPAS[0]),
        "failures": section(
            _row(r) for case in (*cases, *compressible) for r in case if not r["converged"]
        ),
    }


def _steps(body: str, kappa: float, cases: Sequence[Sequence[Record]]) -> dict[str, object]:
    """Return the section of a body and a κ: its rows, and how FETI compares with the best other."""
    compared = [row for case in cases if (row := _against_the_best(case)) is not None]
    ratios = [row["time_ratio"] for row in compared]
    return {
        "geometry": body,
        "kappa": kappa,
        "rows": [row for case in cases for row in _rows(case)],
        "least_ratio": min(ratios, default=math.nan),
        "largest_ratio": max(ratios, default=math.nan),
        "compared": len(compared),
    }


def _order(case: Sequence[Record]) -> tuple[object, ...]:
    r = case[0]
    place = ORDER[r["geometry"]]
    loads = (r["path_mmhg"] or 0.0, r["loaded_mmhg"] or 0.0)
    return place, r["kappa"] or 0.0, *loads, -r["degree"], r["dofs"], r["wanted_subdomains"] or 0


def _of_solver(case: Sequence[Record], *solvers: str) -> list[Record]:
    """Return the records of some solvers in a case, the fastest first, failures at the end."""
    return sorted((r for r in case if r["solver"] in solvers), key=_whole)


def _best(case: Sequence[Record], *solvers: str) -> Record | None:
    """Return the fastest record of some solvers in a case; None if none solved it."""
    return next((r for r in _of_solver(case, *solvers) if math.isfinite(_whole(r))), None)


def _rows(case: Sequence[Record]) -> Iterator[dict[str, object]]:
    """Yield a row for each record, with the quotients of FETI's faster layout and it."""
    feti = _best(case, "feti")
    for solver in OPPONENTS:
        mine = _of_solver(case, solver)
        for record in mine:
            row = _row(record)
            if len(mine) > 1 and record is _best(case, solver):
                row["layout"] = f"**{row['layout']}**"
            if feti and record["converged"] and solver != "feti":
                row |= _ratios(feti, record)
            yield row


def _against_the_best(case: Sequence[Record]) -> dict[str, object] | None:
    """Return a row with FETI's faster layout and the best other solver, or None without both."""
    feti = _best(case, "feti")
    other = _best(case, *(name for name in OPPONENTS if name != "feti"))
    if feti is None or other is None:
        return None
    direct = _best(case, *DIRECT)
    its = {f"its_{k}": v for k, v in _row(other).items()}
    memory = None if direct is None else _ratios(feti, direct)["memory_ratio"]
    sources = [record for record in (feti, other, direct) if record is not None]
    more = {"memory_ratio": memory, "sources": sources}
    return _row(feti) | its | _ratios(feti, other) | more


def seconds(record: Record) -> float:
    """Return the seconds of set-up and solution; infinite without a solution."""
    if not record["converged"]:
        return math.inf
    return record["seconds_setup"] + record["seconds_solve"]


def _row(record: Record) -> dict[str, object]:
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
    each = [sum(pair) for pair in record.get("seconds_rounds", []) if None not in pair]
    if len(each) < 2:
        return f"{_whole(record):.2f}"
    return f"{_whole(record):.2f} ({min(each):.2f}–{max(each):.2f})"


def _formulations(case: Sequence[Record]) -> dict[str, object]:
    """Return a row with FETI's two formulations and the best other solver."""
    best = {"primal": _best(case, "feti"), "dual": _best(case, "feti-dual")}
    best["other"] = _best(case, *(name for name in OPPONENTS if name not in ("feti", "feti-dual")))
    row: dict[str, object] = dict(_row(case[0]))
    row["sources"] = [record for record in best.values() if record is not None]
    for which, record in best.items():
        found = dict.fromkeys(("iterations", "spread", "peak_mib", "name"))
        row |= {f"{which}_{k}": v for k, v in (found if record is None else _row(record)).items()}
    primal = best["primal"]
    dual = best["dual"]
    other = best["other"]
    row["of_dual"] = _whole(primal) / _whole(dual) if primal and dual else None
    row["of_other"] = _whole(primal) / _whole(other) if primal and other else None
    return row


def _ratios(feti: Record, other: Record) -> dict[str, object]:
    """Return FETI's time and memory over those of another solver."""
    mine = feti["peak_mib"]
    its = other["peak_mib"]
    return {
        "time_ratio": _whole(feti) / _whole(other),
        "linear_ratio": seconds(feti) / seconds(other),
        "memory_ratio": mine / its if mine and its else None,
    }


def _growth(first: Sequence[Sequence[Record]]) -> Iterator[dict[str, object]]:
    """Yield a row for each iterative solver, size and layout: the least κ and a larger one."""
    names = ("solver", *(name for name in CASE if name != "kappa"), "processes", "threads")
    found = [r for case in first for solver in OPPONENTS for r in _of_solver(case, solver)]
    solved = [r for r in found if r["converged"] and r["kappa"] in KAPPAS]
    iterative = sorted((r for r in solved if r["solver"] not in DIRECT), key=lambda r: r["kappa"])
    for _, (low, *rest) in groups(iterative, *names):
        for high in rest:
            its = {"low_its": low["iterations"], "high_its": high["iterations"]}
            its["quotient"] = its["high_its"] / its["low_its"]
            yield _row(low) | its | {"high": high["kappa"], "sources": [low, high]}


def _whole(record: Record) -> float:
    """Return the seconds that solvers are ranked by, of a path end to end; infinite if unsolved."""
    solved = record["converged"] and not record["note"].startswith("the residual is above")
    return record.get("seconds_end_to_end", seconds(record)) if solved else math.inf


def _layout(record: Record) -> str:
    """Return processes and threads as text."""
    processes = record["processes"]
    threads = record["threads"]
    of_each = "" if threads == 1 else f" × {threads} threads"
    return f"{processes} process{'' if processes == 1 else 'es'}{of_each}"


def _subdomains(records: Sequence[Record]) -> list[dict[str, object]]:
    """Return a row for each body, size and number of processes of a sweep over subdomains."""
    rows = []
    alike = ("geometry", "degree", "processes", "wanted_dofs")
    for (geometry, degree, processes, wanted), mine in groups(records, *alike):
        least = min(r["seconds_cpu"] for r in mine if r["converged"])
        its = [r["iterations"] for r in mine if r["subdomains"] > 1]
        place = (processes, ORDER[geometry], degree, wanted)
        at = {r["per"]: f"{r['seconds_cpu'] / least:.2f}" for r in mine}
        ends = {"fewest": min(its, default=None), "most": max(its, default=None)}
        rows.append(mine[0] | ends | {"place": place, "at": at, "sources": mine})
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
    plain = [r for r in records if case.items() <= r.items() and r["solver"] in solvers]
    found = groups((r for r in plain if not any(r.get(name) for name in SPECIAL)), "dofs")
    return sorted((dofs, min(map(seconds, mine))) for (dofs,), mine in found)


def draw(records: Sequence[Record], path: Path, *, dark: bool = False) -> None:
    """Draw the panels of all bodies into a file, for light or for dark pages."""
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
    plain = [r for r in records if not any(r.get(name) for name in SPECIAL)]
    mine = [r for r in plain if r["geometry"] in COMPRESSIBLE and r["converged"]]
    found = {
        name: [
            (body, min(map(seconds, of_body)))
            for (body,), of_body in groups((r for r in mine if r["solver"] in solvers), "geometry")
        ]
        for name, (solvers, _) in FORMULATIONS.items()
    }
    bodies = [name for name in COMPRESSIBLE if any(name in dict(times) for times in found.values())]
    if not found["FETI, dual"]:
        return []
    legend = {name: style for name, (_, style) in FORMULATIONS.items()}
    with picture(folder / "speed_compressible.png", 1, 2, legend, sharey=True) as axes:
        for ax, part in zip(
            axes[0], (bodies[: len(bodies) // 2], bodies[len(bodies) // 2 :]), strict=True
        ):
            for name, (_, style) in FORMULATIONS.items():
                times = dict(found[name])
                curve(
                    ax, [(i, times[body]) for i, body in enumerate(part) if body in times], **style
                )
            ax.set_yscale("log")
            ax.set_xticks(
                range(len(part)), [COMPRESSIBLE[body].replace(", ", ",\n") for body in part]
            )
            ax.set_xlim(-0.5, max(len(part), 1) - 0.5)
        axes[0, 0].set_ylabel("set-up and solve [s]")
    return [{"picture": "speed_compressible.png"}]
