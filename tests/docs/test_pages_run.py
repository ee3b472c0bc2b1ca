# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tutorials and how-to pages run as printed: the blocks of a page in order, in one namespace."""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Iterator

from petsc4py import PETSc

import pytest
from pages import programs
from wall_files import ROOT

#: Pages whose blocks all run in another test, which checks their results, too.
RUN_ELSEWHERE = {
    "blocks": "tests/problems/test_blocks.py",
    "closed_loop": "tests/docs/test_closed_loop.py",
    "external_laws": "tests/problems/test_before_assembly.py",
    "mechanics_recipes": "tests/docs/test_usage.py",
    "own_matrix": "tests/docs/test_own_solvers.py",
    "own_operators": "tests/docs/test_own_solvers.py",
    "own_solvers": "tests/docs/test_own_solvers.py",
    "reactions_and_points": "tests/docs/test_usage.py",
}

#: Pages whose programs import clients of the package, which the environments of tests lack.
NEED_OTHER_PACKAGES = {"ambit", "pulse"}

#: Paths of the pages below ``docs``, without ending.
PAGES = sorted(
    name
    for pattern in ("*.md", "api/*.md")
    for page in (ROOT / "docs").glob(pattern)
    if (name := page.relative_to(ROOT / "docs").with_suffix("").as_posix())
    not in RUN_ELSEWHERE.keys() | NEED_OTHER_PACKAGES
    and programs(page=f"docs/{name}.md")
)

#: Packages that some blocks import and that an environment may lack.
OPTIONAL = ("gmsh", "matplotlib", "scifem")

#: Packages without which no block of a page runs.
REQUIRED = {"pictures": "pyvista", "api/output": "pyvista"}


def missing_package(block: str) -> str | None:
    """Return the first optional package that a block imports and that is not installed."""
    for package in OPTIONAL:
        if f"import {package}" in block and importlib.util.find_spec(package) is None:
            return package
    return None


@pytest.fixture
def clean(tmp_path, monkeypatch) -> Iterator[None]:
    """Run in an empty folder; afterwards restore PETSc's options and the log, and close Gmsh."""
    monkeypatch.chdir(tmp_path)
    log = logging.getLogger("dolfinx_feti")
    level = log.level
    options = PETSc.Options()
    before = options.getAll()
    yield
    log.setLevel(level)
    for name in options.getAll().keys() - before.keys():
        options.delValue(name)
    if importlib.util.find_spec("gmsh") is not None:
        import gmsh

        if gmsh.isInitialized():
            gmsh.finalize()


@pytest.mark.serial
@pytest.mark.parametrize("page", PAGES)
def test_page_runs_as_printed(page, clean):
    """Blocks that import a package which is not installed are left out."""
    if page in REQUIRED:
        pytest.importorskip(REQUIRED[page])
    names = {"__name__": "__main__"}
    for number, block in enumerate(programs(page=f"docs/{page}.md")):
        if missing_package(block) is None:
            exec(compile(block, f"docs/{page}.md, block {number}", "exec"), names)


def test_other_tests_run_the_remaining_pages():
    for page, test in RUN_ELSEWHERE.items():
        assert f"{page}.md" in (ROOT / test).read_text(encoding="utf-8"), page
