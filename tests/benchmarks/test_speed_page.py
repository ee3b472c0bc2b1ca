# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The page of the comparison of solvers: tables of known records."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.common import machine
from benchmarks.common.compare import tables
from benchmarks.common.compare.path import PHASES
from benchmarks.compare import STUDY

pytest.importorskip("matplotlib")
pytestmark = pytest.mark.serial


MACHINE = machine.describe()


def record_of(
    solver: str,
    *,
    setup: float,
    solve: float,
    iterations: int = 1,
    mib: float = 100.0,
    geometry: str = "tube",
    kappa: float = 1000.0,
    dofs: int = 60_000,
    processes: int = 2,
    path: float | None = None,
    loaded: float | None = None,
    rounds: tuple[float, ...] = (),
    note: str = "",
) -> dict[str, object]:
    """Return the record of a first Newton step, or of a path of three linear solves."""
    case = {"solver": solver, "geometry": geometry, "kappa": kappa, "wanted_dofs": dofs}
    case |= {"wanted_subdomains": None, "processes": processes, "threads": 3 - processes}
    case |= {"degree": 2, "loaded_mmhg": loaded}
    case |= {"path_mmhg": path, "dofs": dofs, "subdomains": 32, "newton_iterations": 1}
    case["free_mib"] = 9_000.0
    found = {"seconds_setup": setup, "seconds_solve": solve, "iterations": iterations}
    found |= {"peak_mib": mib, "relative_residual": 3e-9, "difference_to_mumps": 2e-10}
    if note:
        found = {"relative_residual": None}
    if path is not None:
        found |= {"peak_mib": None, "newton_iterations": 3, "load_steps": 2, "linear_solves": 3}
        found |= {"iterations_per_solve": [iterations] * 3, "seconds_assembly": 7.0}
        found |= {"seconds_per_newton": (setup + solve) / 3.0}
        found |= {"seconds_end_to_end": setup + solve + 9.0}
    if rounds:
        found |= {"seconds_rounds": [[each, 0.0] for each in rounds]}
    found |= {"converged": not note, "note": note}
    return case | found | {"machine": MACHINE, "date": "2026-01-02T03:04:05+00:00"}


def write(tmp_path: Path, *records: dict[str, object]) -> str:
    """Make the page of some records."""
    (tmp_path / "records.json").write_text(json.dumps(records))
    return STUDY.write_page([tmp_path / "records.json"], tmp_path)


def test_ratios_are_those_of_the_faster_layouts(tmp_path):
    """FETI 2 s on two processes; MUMPS 4 s on two, 2.5 s on threads: the better one is told."""
    page = write(
        tmp_path,
        record_of("feti", setup=1.5, solve=0.5, iterations=34, mib=300.0),
        record_of("feti", setup=2.0, solve=1.0, iterations=34, mib=250.0, processes=1),
        record_of("mumps", setup=3.9, solve=0.1, mib=400.0),
        record_of("mumps", setup=2.4, solve=0.1, mib=200.0, processes=1),
    )
    first, second = "**1 process × 2 threads** | 2.40 | 0.10", "2 processes | 3.90 | 0.10"
    assert f"| MUMPS | {first} | 2.50 | 1 | 200 | 3e-9 | 0.80 | 1.50 |" in page
    assert f"| MUMPS | {second} | 4.00 | 1 | 400 | 3e-9 | 0.50 | 0.75 |" in page
    assert "| 32 | FETI | **2 processes** | 1.50 | 0.50 | 2.00 | 34 | 300 | 3e-9 | – | – |" in page
    assert MACHINE["processor"] in page
    assert "Cases without a solution" not in page


def test_against_the_best(tmp_path):
    """Of all others that come to the solution, with the spread of the rounds, case by case."""
    inaccurate = record_of("hypre", setup=0.1, solve=0.1)
    page = write(
        tmp_path,
        record_of("feti", setup=1.5, solve=0.5, iterations=34, mib=300.0, rounds=(1.9, 2.0, 2.2)),
        record_of("mumps", setup=9.0, solve=1.0, mib=600.0),
        record_of("cholmod", setup=8.0, solve=0.0, mib=400.0, processes=1),
        record_of("gamg", setup=4.0, solve=1.0, rounds=(4.9, 5.0)),
        inaccurate | {"note": "the residual is above 1e-08"},
        record_of("feti", setup=1.5, solve=0.5, loaded=10.0),
        record_of("mumps", setup=0.5, solve=0.5, loaded=10.0),
    )
    summary = page.split("## FETI and the best of the others")[1].split("## ")[0]
    case = "| tube | P2–P0 | 1000 |"
    first = "34 | 2.00 (1.90–2.20) | GAMG | 2 processes | 5.00 (4.90–5.00) | 0.40 | 0.75 |"
    assert f"{case} at rest | 60 000 | {first}" in summary
    assert f"{case} at 10 mmHg | 60 000 | 1 | 2.00 | MUMPS | 2 processes | 1.00 | 2.00" in summary


def test_figure_shows_the_fastest_of_plain_first_steps(tmp_path):
    """Not a path, nor another κ, nor subdomains or bounds that the user chose."""
    records = [
        record_of("mumps", setup=4.0, solve=1.0),
        record_of("pardiso", setup=3.0, solve=0.5),
        record_of("cholmod", setup=1.0, solve=0.0) | {"wanted_subdomains": 7},
        record_of("cholmod", setup=1.0, solve=0.0) | {"per": 2000},
        record_of("cholmod", setup=1.0, solve=0.0, kappa=10.0),
        record_of("cholmod", setup=1.0, solve=0.0, path=10.0),
        record_of("cholmod", setup=1.0, solve=0.0, note="failed: no memory"),
        record_of("mumps", setup=0.5, solve=0.0) | {"dofs": 100},
    ]
    direct = ("mumps", "cholmod", "pardiso")
    assert tables.points(records, "tube", direct) == [(100, 0.5), (60_000, 3.5)]
    assert tables.points(records, "block", direct) == []
    tables.draw(records, tmp_path / "speed.png")
    assert (tmp_path / "speed.png").stat().st_size > 10_000


def test_growth_with_kappa(tmp_path):
    """Of iterative solvers only."""
    page = write(
        tmp_path,
        record_of("feti", setup=1.0, solve=1.0, geometry="block", kappa=10.0, iterations=40),
        record_of("feti", setup=1.0, solve=1.0, geometry="block", iterations=52),
        record_of("feti", setup=1.0, solve=1.0, kappa=10.0, iterations=10),
        record_of("feti", setup=1.0, solve=1.0, iterations=90),
        record_of("mumps", setup=1.0, solve=1.0, geometry="block", kappa=10.0),
        record_of("mumps", setup=1.0, solve=1.0, geometry="block"),
    )
    case = "P2–P0 | 60 000 | 32 | FETI | 2 processes | 1000"
    assert f"| block | {case} | 40 | 52 | 1.30 |" in page
    assert f"| tube | {case} | 10 | 90 | 9.00 |" in page
    growth = page.split("## How the iterations grow")[1]
    assert "MUMPS" not in growth


def test_path(tmp_path):
    page = write(
        tmp_path,
        record_of("feti", setup=2.0, solve=1.0, iterations=20, path=10.0),
        record_of("mumps", setup=5.0, solve=1.0, path=10.0),
    )
    mumps = "| 2 | 3 | 3 | 1.0 | 5.00 | 1.00 | 6.0 | 2.00 | 0.50 | 7.0 | 15.0 | 0.80 |"
    assert f"| tube | 1000 | 60 000 | – | 10 | MUMPS | 2 processes {mumps}" in page
    assert "A Newton step:" not in page


def test_phases(tmp_path):
    """Each in percent, and the rest."""
    spent = dict.fromkeys(PHASES, 0.0) | {"FETISchur": 1.0, "FETILocalSolve": 0.5}
    feti = record_of("feti", setup=3.0, solve=1.0) | {"seconds_phases": spent}
    page = write(tmp_path, feti, record_of("mumps", setup=1.0, solve=1.0))
    (row,) = page.split("## Where FETI's time goes")[1].split("| --: |\n")[1].splitlines()[:1]
    shares = [int(cell) for cell in row.split("|")[8:-1]]
    assert shares == [0, 25, 0, 0, 0, 12, 0, 62]
    assert "| at rest | 2 processes | 4.00 |" in row
    before = write(tmp_path, record_of("feti", setup=3.0, solve=1.0))
    assert "Where FETI's time goes" not in before


def test_failures_are_shown(tmp_path):
    """With the reason; a path, too, and what is left is compared."""
    page = write(
        tmp_path,
        record_of("feti", setup=1.0, solve=1.0),
        record_of("mumps", setup=0.0, solve=0.0, note="failed: out of memory"),
        record_of("feti", setup=1.0, solve=1.0, path=10.0, note="failed: no equilibrium"),
    )
    assert "| MUMPS | 2 processes | failed | – |" in page
    assert (
        "| tube | 1000 | 60 000 | – | MUMPS | 2 processes | 9 000 | failed: out of memory |" in page
    )
    assert (
        "| tube | 1000 | 60 000 | 10 | FETI | 2 processes | 9 000 | failed: no equilibrium |"
        in page
    )
    heads = {line.count("|") for line in page.split("## Load paths")[1].splitlines()[4:7]}
    assert len(heads) == 1, "rows as long as the head"
