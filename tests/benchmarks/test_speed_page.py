# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The page of the comparison of solvers: tables of known records."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.common.compare import tables
from benchmarks.common.records import describe_machine
from benchmarks.compare import STUDY

pytest.importorskip("matplotlib")
pytestmark = pytest.mark.serial


MACHINE = describe_machine()


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


def test_failures_are_shown(tmp_path):
    """With the reason; a path, too, and what is left is compared."""
    page = write(
        tmp_path,
        record_of("feti", setup=1.0, solve=1.0),
        record_of("mumps", setup=0.0, solve=0.0, note="failed: out of memory"),
        record_of("feti", setup=1.0, solve=1.0, path=10.0, note="failed: no equilibrium"),
    )
    assert "| MUMPS | 2 processes | failed | – |" in page
    assert "| tube | 1000 | 60 000 | – | MUMPS | 2 processes | failed: out of memory |" in page
    assert "| tube | 1000 | 60 000 | 10 | FETI | 2 processes | failed: no equilibrium |" in page
    heads = {line.count("|") for line in page.split("## Load paths")[1].splitlines()[4:7]}
    assert len(heads) == 1, "rows as long as the head"
