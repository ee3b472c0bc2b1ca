# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""README.md and CONTRIBUTING.md: their programs, on as many processes as there are."""

from __future__ import annotations

import re
from pathlib import Path

from collective import agree, equal
from problems import Problem, owned

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_program_bends_a_cantilever():
    """Beside a direct solution; its report names the subdomains."""
    (source,) = re.findall(r"^```python\n(.*?)^```", README, re.M | re.S)
    agree(len(source.strip().splitlines()) <= 20)
    names: dict[str, object] = {}
    exec(compile(source, "README.md", "exec"), names)
    problem, uh = names["problem"], names["uh"]
    agree(problem.solver.getConvergedReason() > 0)
    agree("\nsubdomains            16\n" in str(problem.diagnose()))
    known = Problem(names["V"], names["a"], names["L"], [names["bc"]])
    equal(owned(uh), known.solve_directly(), 1e-6)


def test_a_visitor_reads_it():
    agree(len(README.split()) <= 900)
    agree(README.index("docs/images/speed.png") < README.index("## Install"))


def test_the_example_of_contributing_passes():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    (source,) = re.findall(r"^```python\n(.*?)^```", text, re.M | re.S)
    names: dict[str, object] = {}
    exec(compile(source, "CONTRIBUTING.md", "exec"), names)
    (test,) = [value for name, value in names.items() if name.startswith("test_")]
    test()
