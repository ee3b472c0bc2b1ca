# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tables and checks of the linear study, from records with known values."""

from __future__ import annotations

import numpy as np
import pytest
from collective import agree, small
from linear_study import EVERYTHING, record_of

from benchmarks.unit_cube.case import Case
from benchmarks.unit_cube.checks import checks, error_scale, speed_checks
from benchmarks.unit_cube.growth import fit_growth
from benchmarks.unit_cube.tables import deviations, tables

pytestmark = pytest.mark.serial


def test_tables_hold_the_papers_values_against_ours():
    agree(deviations(EVERYTHING) == (0.0, 0))
    small(error_scale(EVERYTHING) - 2.0, 1e-12)
    table = next(t for t in tables(EVERYTHING) if t.title.startswith("P1, classical"))
    row = [*table.rows[2]]
    agree(row[:3] == ["3", "2", "38 052"], row)
    agree(row[3:5] == ["140 (140)", "295.7 (295.7, +0.0 %)"], row)
    worse = record_of("classical", "lumped", 3, condition_number=100.0, iterations=90)
    agree(deviations([worse])[1] == 5)
    small(deviations([worse])[0] - (1.0 - 100.0 / 105.9), 1e-12)
    table = tables([worse])[0]
    agree("90 (85) | 100 (105.9, −5.6 %) |" in table.markdown(), table.markdown())
    agree(r"90 (85) & 100 (105.9, $-$5.6 \%) &" in table.latex(), table.latex())


def test_tables_are_made_of_what_is_there():
    """A jump, another number of subdomains or level, another scaling: each in its own table."""
    usual = record_of("all_floating", "dirichlet", 2)
    names = {
        "Young's modulus jumps": {"jump": 1e3, "pattern": "layer"},
        "More subdomains": {"subdomains_per_edge": 4},
        "Larger subdomains": {"level": 1},
        "Other choices": {"gluing": "nonred"},
    }
    for title, change in names.items():
        titles = [table.title for table in tables([usual, usual | change])]
        found = {name for name in names if any(t.startswith(name) for t in titles)}
        agree(found == {title}, titles)
    agree(tables([]) == [])


def test_refusals_have_a_table_of_their_own():
    case = Case(level=4).key() | {"estimated_mib": 27940.0, "available_mib": 15360.0}
    failed = Case(level=1).key() | {"failure": "stagnation"}
    (table,) = tables([case, failed])
    agree(table.title == "Cases without results")
    agree([row[5:] for row in table.rows] == [["did not converge", "–", "–"],
                                              ["does not fit", "27 940", "15 360"]])  # fmt: skip


def test_growth_is_fitted_to_the_square_of_a_logarithm():
    levels = np.arange(1, 5)
    values = (2.0 + 0.7 * np.log(2.0 ** (levels - 1))) ** 2
    records = [
        record_of("classical", "dirichlet", int(level), condition_number=float(value))
        for level, value in zip(levels, values, strict=True)
    ]
    a, b, worst = fit_growth(records)
    small(a - 2.0, 1e-13)
    small(b - 0.7, 1e-13)
    small(worst, 1e-13)
    records[-1]["condition_number"] *= 2.0
    agree(fit_growth(records).worst > 0.1)


def test_checks_see_what_does_not_hold():
    agree(all(check.holds for check in checks(EVERYTHING)), list(checks(EVERYTHING)))
    usual = ("classical", "dirichlet", 2)
    jump = {"jump": 1e6, "pattern": "layer", "coarse_q": "preconditioner"}
    for changes, what in (
        ({"condition_number": 20.0}, "κ, P1, off the paper's"),
        ({"iterations": 44}, "iterations, P1, off the paper's"),
        ({"l2_error": 3e-5}, "L2 errors, P1, off the paper's after one factor"),
        ({"lambda_min": 0.99}, "λ_min with the Dirichlet preconditioner"),
        (jump | {"scaling": "stiffness", "iterations": 61}, "iterations over jumps to 1e6, stiff"),
    ):
        worse = [*EVERYTHING, record_of(*usual, **changes)]
        wrong = [check.what for check in checks(worse) if not check.holds]
        agree(any(each.startswith(what) for each in wrong), (what, wrong))
    sizes = [record_of(*usual, subdomains_per_edge=edge, iterations=30) for edge in (4, 16)]
    agree([c.holds for c in checks(sizes) if "from 4³" in c.what] == [])
    flat = [*sizes, record_of(*usual, iterations=34)]
    agree([c.holds for c in checks(flat) if "from 4³" in c.what] == [True])
    growing = [*sizes, record_of(*usual, iterations=35)]
    agree([c.holds for c in checks(growing) if "from 4³" in c.what] == [False])


def test_speed_is_held_against_streaming():
    record = {"solver": "feti_classical", "level": 3, "subdomains": 512, "processes": 2}
    record |= {"seconds_setup": 8.0, "seconds_coarse": 0.7, "iterations": 40}
    record |= {"seconds_solve": 9.0, "seconds_iterations": 6.0, "seconds_streaming": 0.11}
    agree([check.holds for check in speed_checks([record])] == [True] * 3)
    slow = record | {"seconds_setup": 8.1, "seconds_coarse": 0.9, "seconds_streaming": 0.09}
    agree([check.holds for check in speed_checks([slow])] == [False] * 3)
    agree(list(speed_checks([record | {"level": 2}, record | {"solver": "gamg"}])) == [])
