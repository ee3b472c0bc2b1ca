# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The page of the tube, from known records."""

from __future__ import annotations

import json

import pytest

from benchmarks.tube import page

pytestmark = pytest.mark.serial

CASE = {"c": 3.0, "kappa": 1000.0, "size": 0.09, "element": "p2-p0", "subdomains": 8}
CASE |= {
    "quarter": True,
    "augmented": False,
    "dofs": 2673,
    "tangent": "symmetric",
    "processes": 2,
    "steps": 1,
    "failures": 0,
    "seconds": 1.5,
}
CASE |= {"newton_iterations": 4, "linear_iterations": 1234}
ERRORS = [f"{which}_{of}_error" for which in ("stress", "recovered") for of in ("rr", "tt")]


def test_ratios_to_the_truth_and_a_run_that_did_not_arrive(tmp_path):
    found = {"pressure_mmhg": 10.0, "u_r_inner": 0.101, "u_r_inner_exact": 0.1}
    found |= {"thickness": 0.3, "thickness_exact": 0.3, "mean_J": 1.0, "mean_J_exact": 1.0}
    found |= {"min_J": 0.9, "max_J": 1.1, "u_r_inner_error": 0.01} | dict.fromkeys(ERRORS, 0.05)
    lost = {"pressure_mmhg": 300.0, "reached_mmhg": 10.0, "error": "No equilibrium was found."}
    (tmp_path / "tube.json").write_text(json.dumps([CASE | found, CASE | lost]))
    text = page.main([str(tmp_path / "tube.json"), "--output", str(tmp_path)])
    assert text == (tmp_path / "tube.md").read_text()
    assert "| quarter | p2-p0 | 0.09 | 3 | 1000 | symmetric |" in text
    assert "| 10 | 1 | 4 | 1 234 | 0.10100 | +1.0 % | 0.30000 | +0.0 % |" in text
    assert "| P2–P0 | 0.09 | 2 673 | 1 % | 5 % | 5 % | 0.900–1.100 | 4 | 1 234 | 1.5 |" in text
    assert (tmp_path / "tube.png").is_file()
    assert "mm: no further than 10 mmHg: No equilibrium was found." in text
    assert "| 300 |" not in text
