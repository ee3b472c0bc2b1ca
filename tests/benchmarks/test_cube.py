# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The linear study: errors, counts, condition numbers, its plan and its page."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import paper_cube
import pytest
from collective import COMM, agree, small
from wall_files import on_first

from benchmarks import cube
from benchmarks.common import paper
from benchmarks.common.cube import PATTERNS, Case

pytest.importorskip("matplotlib")


@pytest.fixture
def study_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[dict]]:
    """Run some cases with one file of records; return all of its records."""
    file = COMM.bcast(str(tmp_path / "linear.json"))

    def run(*cases: Case) -> list[dict]:
        monkeypatch.setattr(cube, "SETS", {"few": lambda: iter(cases)})
        cube.STUDY.main(["--sets", "few", "--json", file], COMM)
        return on_first(lambda: json.loads(Path(file).read_text()))

    return run


#: A subdomain for each of three processes, and more.
SMALL = Case(subdomains_per_edge=2)

#: What a record has to hold, whatever else it holds.
KEYS = set(
    "degree level type pc scaling subdomains dofs_local_max dofs multipliers coarse_size "
    "iterations condition_number lambda_min lambda_max l2_error seconds_setup seconds_solve "
    "peak_mib".split()
)


def test_patterns_of_stiff_subcubes():
    place = np.stack(np.meshgrid(*3 * [np.arange(4)], indexing="ij"), axis=-1).reshape(-1, 3)
    stiff = {name: mark(place, 4).reshape(4, 4, 4) for name, mark in PATTERNS.items()}
    agree(not stiff["none"].any() and stiff["checkerboard"].sum() == 32)
    agree(not np.any(stiff["checkerboard"][1:] & stiff["checkerboard"][:-1]))
    agree(stiff["layer"].sum() == 16 and stiff["layer"][:, :, 2].all())


@pytest.mark.serial
@pytest.mark.parametrize(("degree", "levels"), [(1, (2, 3)), (2, (1, 2))])
def test_error_converges_to_the_fundamental_solution(degree, levels, study_of):
    """Order two for linear and three for quadratic elements."""
    records = study_of(*(replace(SMALL, degree=degree, level=level) for level in levels))
    agree([r["level"] for r in records] == list(levels))
    coarse, fine = (r["l2_error"] for r in records)
    agree(np.log2(coarse / fine) > degree + 0.9, (coarse, fine))


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
def test_records_say_what_the_hand_torn_cube_says(kind, study_of, create_ksp):
    """Counts and condition numbers agree with a cube torn by NumPy; only the solver is shared."""
    cases = (Case(subdomains_per_edge=3, type=kind, pc=pc) for pc in cube.PRECONDITIONERS)
    records = study_of(*cases)
    agree(len(records) == 3)
    problem = paper_cube.cube(3)
    for record in records:
        agree(set(record) >= KEYS, KEYS - set(record))
        options = {"type": kind, "pc_type": record["pc"], "scaling": "multiplicity"}
        options |= {"coarse_q": "identity", "coarse_modes": 0, "dual_ksp_rtol": 1e-8}
        ksp = create_ksp(problem.A, **{f"feti_{name}": value for name, value in options.items()})
        load = np.random.default_rng(5).standard_normal(len(problem.dirichlet))
        b = problem.vector(np.where(problem.dirichlet, load, 0.0))
        ksp.solve(b, problem.A.createVecRight())
        context = ksp.getPythonContext()
        found = context.report()
        agree(record["multipliers"] == found.multipliers)
        agree(record["coarse_size"] == found.coarse_size)
        agree(record["dofs"] == found.dofs and record["dofs_local_max"] == 45)
        agree(record["subdomains"] == 27 and record["kernels"] == list(found.kernels))
        small(record["condition_number"] / context.condition_number - 1.0, 0.02)
        small(record["lambda_max"] / record["lambda_min"] / record["condition_number"] - 1, 1e-12)
        if record["pc"] != "identity":
            agree(record["lambda_min"] > 1.0 - 1e-6)
    problem.destroy()


@pytest.mark.serial
def test_stiffness_scaling_and_weight_bear_a_jump(study_of):
    """Neither the scaling alone nor the weight Q alone bounds κ."""
    stiff = replace(SMALL, jump=1e4, pattern="layer", level=2)
    choices = itertools.product(("multiplicity", "stiffness"), ("identity", "diagonal"))
    records = study_of(*(replace(stiff, scaling=scaling, coarse_q=q) for scaling, q in choices))
    agree(all(r["l2_error"] is None for r in records))
    condition = {(r["scaling"], r["coarse_q"]): r["condition_number"] for r in records}
    bounded = condition.pop(("stiffness", "diagonal"))
    agree(bounded < 20.0 and min(condition.values()) > 10 * bounded, (bounded, condition))


def test_plan_holds_the_papers_table_first_and_no_case_twice():
    plan = [case for each in cube.SETS.values() for case in each()]
    agree(len(set(plan)) > 100)
    agree(
        set(plan[:18])
        == {Case(type=kind, pc=pc, level=level) for kind, pc, level in paper.LINEAR if level < 4}
    )
    agree({case.jump for case in plan} == {1.0, 1e2, 1e4, 1e6})
    agree({case.subdomains_per_edge for case in plan} == {2, 4, 8, 16, 32})


def record_of(kind: str, pc: str, level: int, **changes: object) -> dict:
    """Return a record with the paper's own values, and half of its error."""
    its, condition = paper.LINEAR[kind, pc, level]
    case = {"type": kind, "pc": pc, "level": level, "degree": 1, "iterations": its}
    found = {"condition_number": condition, "l2_error": 0.5 * paper.L2_ERRORS[kind, level]}
    return case | found | changes


def test_deviations_from_the_paper():
    everything = [record_of(*key) for key in paper.LINEAR]
    agree(cube.deviations(everything) == (0.0, 0))
    small(cube.error_scale(everything) - 2.0, 1e-12)
    worse = record_of("classical", "lumped", 3, condition_number=100.0, iterations=90)
    condition, iterations = cube.deviations([*everything, worse])
    small(condition - (1.0 - 100.0 / 105.9), 1e-12)
    agree(iterations == 5)


def test_growth_is_fitted_to_the_square_of_a_logarithm():
    """√κ = 2 + 0.7 ln 2^(l − 1)."""
    of_level = ((2.0 + 0.7 * np.log(2.0 ** (level - 1))) ** 2 for level in range(1, 5))
    key = ("classical", "dirichlet")
    records = [record_of(*key, i, condition_number=κ) for i, κ in enumerate(of_level, start=1)]
    small(max(abs(np.subtract(cube.fit_growth(records), (2.0, 0.7, 1.0)))), 1e-13)
    records[-1]["condition_number"] *= 2.0
    agree(cube.fit_growth(records)[2] > 1.1)


def test_cube_of_fewer_subdomains_than_processes_is_left(study_of):
    """A case with fewer subdomains than processes is left out, and each other case runs once."""
    cases = [replace(SMALL, level=level) for level in (1, 2)]
    cases_of_file = [*cases, cases[0]]
    if COMM.size > 1:
        cases_of_file.append(Case(subdomains_per_edge=1))
    records = study_of(*cases_of_file)
    agree([r["level"] for r in records] == [1, 2])
    agree(all(0.0 < r["seconds_coarse"] < r["seconds_setup"] for r in records), records)
