# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tables of the linear study, from records with known values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from collective import agree, small
from linear_study import EVERYTHING, record_of

from benchmarks.common.pages import fill
from benchmarks.cube import page
from benchmarks.cube.case import Case
from benchmarks.cube.page import deviations, error_scale, fields, fit_growth

pytestmark = pytest.mark.serial

#: Fields of sections that are there if there is something to show.
SECTIONS = {"linear", "floating", "classical", "errors", "larger", "fits", "choices", "jumps"}
SECTIONS |= {"more", "costs", "refused"}


def text(*records: dict) -> str:
    """Return the page of some records."""
    template = Path(page.__file__).with_suffix(".md").read_text()
    return fill(template, fields(records) | {"machines": []})


def test_tables_hold_the_papers_values_against_ours():
    agree(deviations(EVERYTHING) == (0.0, 0))
    small(error_scale(EVERYTHING) - 2.0, 1e-12)
    row = "| 3 | 2 | 38 052 | 140 (140) | 295.7 (295.7, +0.0 %) | 85 (85) |"
    classical = text(*EVERYTHING).split("## P1, classical")[1]
    agree(row in classical, classical)
    worse = record_of("classical", "lumped", 3, condition_number=100.0, iterations=90)
    agree(deviations([worse])[1] == 5)
    small(deviations([worse])[0] - (1.0 - 100.0 / 105.9), 1e-12)
    agree("90 (85) | 100 (105.9, −5.6 %) |" in text(worse), text(worse))


def test_tables_are_made_of_what_is_there():
    """A jump, another number of subdomains or level, another scaling: each in its own table."""
    usual = record_of("all_floating", "dirichlet", 2)
    names = {
        "jumps": {"jump": 1e4, "pattern": "layer"},
        "more": {"subdomains_per_edge": 4},
        "larger": {"level": 1},
        "choices": {"scaling": "stiffness"},
    }
    for name, change in names.items():
        values = fields([usual, usual | change])
        found = {other for other in names if values[other]}
        agree(found == {name}, found)
    values = fields([])
    agree(not any(values[name] for name in SECTIONS), values)


def test_refusals_have_a_table_of_their_own():
    refused = {"estimated_mib": 27940.0, "available_mib": 15360.0}
    case = Case(level=4).key() | refused | {"processes": 1, "machine": {}, "date": "2026"}
    failed = Case(level=1).key() | {"failure": "stagnation"}
    failed |= {"processes": 1, "machine": {}, "date": "2026"}
    rows = text(case, failed).split("## Cases without results")[1]
    agree("| did not converge | – | – |" in rows, rows)
    agree("| does not fit | 27 940 | 15 360 |" in rows, rows)


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
    small(worst - 1.0, 1e-13)
    records[-1]["condition_number"] *= 2.0
    agree(fit_growth(records)[2] > 1.1)
