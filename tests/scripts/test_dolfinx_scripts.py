# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Scripts for dolfinx that both packages solve: what counts as compared, and what as a fault."""

from __future__ import annotations

import inspect
import re

import dolfinx_scripts
import pytest
from wall_files import ROOT

from dolfinx.fem.petsc import LinearProblem

pytestmark = pytest.mark.serial

#: The LinearProblem of dolfinx takes a prefix of its options from version 0.10.
TAKES_PREFIX = "petsc_options_prefix" in inspect.signature(LinearProblem.__init__).parameters

RIGHT = {
    "script": "name",
    "solves": 1,
    "compared": 1,
    "difference": 1e-9,
    "iterations": 12,
    "refusals": [],
    "end": "",
}


def test_script_is_compared(capsys, monkeypatch, tmp_path):
    """The rotating box of ``drop_in/``, at the same accuracy as in the test of the two changes."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    text = (ROOT / "tests/problems/drop_in/elasticity.py").read_text(encoding="utf-8")
    if not TAKES_PREFIX:
        text = re.sub(r" *petsc_options_prefix=.*\n", "", text)
    script = tmp_path / "elasticity.py"
    script.write_text(text, encoding="utf-8")
    status = dolfinx_scripts.main([str(script)])
    printed = capsys.readouterr()
    assert status == 0, printed.err
    (row,) = [line for line in printed.out.splitlines() if line.startswith("| `elasticity`")]
    _, _, compared, difference, iterations, *_ = row.split("|")
    assert compared.strip() == "1 of 1"
    assert 0.0 < float(difference) < 1e-6
    assert int(iterations) > 5


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({}, ""),
        ({"iterations": 0}, "took no iteration"),
        ({"difference": 1e-4}, "differ by 1.0e-04"),
        ({"difference": float("nan")}, "differ by nan"),
        ({"solves": 0, "compared": 0, "end": "ImportError: gmsh"}, "solved nothing. ImportError"),
        ({"compared": 0, "iterations": 0, "difference": 0.0, "refusals": ["no H(div)"]}, ""),
    ],
    ids=["right", "no-iteration", "difference", "nan", "nothing", "refused"],
)
def test_faults(changes, message):
    found = dolfinx_scripts.fault(RIGHT | changes)
    assert message in found
    assert bool(found) == bool(message)
