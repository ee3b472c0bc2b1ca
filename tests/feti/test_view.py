# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What ``-ksp_view`` prints: one table for a solver, of the shape that docs/reading.md shows."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from collective import COMM, agree
from problems import cube, elasticity, poisson

from dolfinx_feti.runtime.petsc_options import inserted

DOCS = Path(__file__).parents[2] / "docs"

#: Lines of a terminal.
SCREEN = 24


@pytest.fixture
def printed(capfd):
    """Return what PETSc has printed since the last call, on all processes."""

    def read():
        return COMM.bcast(capfd.readouterr().out)

    read()
    return read


@pytest.mark.parametrize("value", [None, "ascii", True])
@pytest.mark.parametrize("formulation", ["dual", "primal"])
def test_one_table_for_a_solver(value, formulation, solve, printed):
    problem = elasticity(cube(2, 6))
    linear = solve(problem, 4, {"ksp_view": value, "feti_formulation": formulation})
    first = printed()
    agree(first.count("KSP Object") == 1 and first.count("\n") <= SCREEN, first)
    agree(f"{formulation} form" in first and f" {COMM.size} MPI process" in first, first)
    linear.solve()
    agree(printed() == "", "a second table")
    linear.diagnose()
    agree(printed().count("KSP Object") == 1, "another solver")


def test_details_at_each_solve(solve, printed):
    linear = solve(poisson(cube(2, 6)), 4, {"ksp_view": "::ascii_info_detail"})
    linear.solve()
    said = printed()
    agree(said.count("type: python") == 2 and said.count("multipliers") == 2, said)
    agree(said.count("Mat Object") >= 2, said)


def test_view_that_is_asked_for(solve, printed):
    """``ksp.view()`` always answers, and nothing is printed that nobody has asked for."""
    linear = solve(poisson(cube(2, 6)), 4)
    agree(printed() == "")
    for _ in range(2):
        linear.solver.view()
        agree("multipliers" in printed())


def blocks(page, heading, language):
    """Return the blocks of code below a heading of a page."""
    section = (DOCS / page).read_text(encoding="utf-8").partition(f"\n## {heading}\n")[2]
    return re.findall(rf"^```{language}\n(.*?)^```", section.partition("\n## ")[0], re.M | re.S)


@pytest.mark.serial
@pytest.mark.parametrize(
    ("page", "heading", "prefix", "sample"),
    [
        ("usage.md", "A linear problem", "beam_", 0),
        ("nonlinear.md", "A nonlinear problem", "wall_", 1),
    ],
)
def test_sample_of_the_documentation(page, heading, prefix, sample, printed):
    """The programs of the pages print their tables once, line by line as reading.md has them."""
    program = max(blocks(page, heading, "python"), key=len)
    with inserted(prefix, {"ksp_view": None}):
        exec(compile(program, page, "exec"), {})
    shown, said = blocks("reading.md", "Reading `-ksp_view`", "")[sample], printed()
    agree(said.count("KSP Object") == 1, said)
    agree(shape(shown) == shape(said) and len(shape(said)) >= 10, (shown, said))


def shape(text):
    """Return the lines of a table, with every number taken for a zero."""
    lines = [line for line in text.splitlines() if re.match("KSP Object|  [a-z]", line)]
    return [re.sub(r"-?\d+(\.\d+)?(e-?\d+)?", "0", line) for line in lines]
