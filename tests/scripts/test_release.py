# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The release: built from the files of the repository, installed, and used without the checkout."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
from demos_from_wheel import build_sdist, build_wheel, install, run, run_demo
from wall_files import ROOT

import dolfinx_feti

pytest.importorskip("pip")
pytest.importorskip("setuptools", "77")

pytestmark = pytest.mark.serial

README = (ROOT / "README.md").read_text(encoding="utf-8")
(PROGRAM,) = re.findall(r"^```python\n(.*?)^```", README, re.M | re.S)
#: README's program, from an installation.
USE = f"""
{PROGRAM}
from pathlib import Path
import dolfinx_feti

home = Path(dolfinx_feti.__file__)
assert (home.parent / "py.typed").is_file()
assert problem.solver.getConvergedReason() > 0
print(dolfinx_feti.__version__)
"""


@pytest.fixture(scope="module")
def sdist(tmp_path_factory) -> Path:
    return build_sdist(tmp_path_factory.mktemp("release"))


@pytest.fixture(scope="module")
def wheel(sdist) -> Path:
    """It is built from the sdist, which therefore lacks no file."""
    return build_wheel(sdist)


@pytest.fixture(scope="module")
def site(wheel, tmp_path_factory) -> Path:
    """Folder with the installed package."""
    folder = tmp_path_factory.mktemp("installed") / "site"
    install(wheel, folder)
    return folder


def test_sdist_holds_tests_and_documents(sdist):
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    for path in ("README.md", "LICENSE", "docs/theory.md", "demos/demo_artery.py", "Makefile"):
        assert path in names
    assert str(Path(__file__).relative_to(ROOT)) in names
    assert not [name for name in names if name.endswith(".pyc") or name.startswith("docs/demos")]


def test_wheel_holds_the_package_alone(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names}
    assert tops == {"dolfinx_feti", f"dolfinx_feti-{dolfinx_feti.__version__}.dist-info"}
    files = [path for path in (ROOT / "dolfinx_feti").rglob("*") if path.is_file()]
    source = {str(path.relative_to(ROOT)) for path in files if path.suffix != ".pyc"}
    assert source <= set(names), source - set(names)


def test_wheel_serves_where_there_is_no_checkout(site, tmp_path):
    printed = run(sys.executable, "-c", USE, cwd=tmp_path, site=site)
    assert printed.split()[-1] == dolfinx_feti.__version__


@pytest.mark.parametrize("demo", ["demo_torn_matrix", "demo_solver_options"])
def test_demo_runs_with_the_wheel(site, tmp_path, demo):
    """Two short ones; ``scripts/demos_from_wheel.py`` runs all."""
    pytest.importorskip("pyvista")
    log = tmp_path / "log"
    outcome = run_demo(demo, 1, site, log)
    assert not outcome.failure, log.read_text()


@pytest.mark.parametrize("lacking", ["mpi4py", "petsc4py", "dolfinx"])
def test_without_dolfinx_one_message_opens_each_door(lacking):
    code = f"import sys; sys.modules[{lacking!r}] = None; import dolfinx_feti"
    command = [sys.executable, "-c", code]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    message = result.stderr[result.stderr.rindex("ImportError: ") :]
    for door in '".[wheel]"', "conda install", "docker run", "apt install":
        assert message.count(door) == 1
    assert lacking in message


def names_of(needs: list[str]) -> set[str]:
    """Names of requirements, without versions."""
    return {re.match(r"[\w-]+", need)[0] for need in needs}


def test_dependencies_are_what_the_package_imports():
    """Those that PyPI lacks, or that pip would have to build, come with dolfinx."""
    trees = (ast.parse(path.read_text()) for path in (ROOT / "dolfinx_feti").rglob("*.py"))
    nodes = [node for tree in trees for node in ast.walk(tree)]
    found = [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
    found += [a.name for node in nodes if isinstance(node, ast.Import) for a in node.names]
    names = {name.split(".")[0] for name in found}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    with_dolfinx = {"basix", "dolfinx", "ffcx", "petsc4py", "ufl"}
    at_choice = {"matplotlib", "pypardiso", "pyvista"}
    own = {"dolfinx_feti", *sys.stdlib_module_names}
    assert names - own - at_choice == names_of(project["dependencies"]) | with_dolfinx
    assert [need for need in project["dependencies"] if ">=" not in need] == []


def test_changelog_begins_with_the_version():
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    first = re.search(r"^## (\S+)", text, re.M)
    assert first and first[1] in (dolfinx_feti.__version__, "Unreleased")


def test_recipes_name_the_version_and_the_needs():
    """And the jobs of the workflow what the tests need, but for what comes with dolfinx."""
    data = tomllib.loads((ROOT / "pyproject.toml").read_text())
    project = data["project"]
    recipe = (ROOT / "packaging/conda/recipe.yaml").read_text()
    assert f'version: "{dolfinx_feti.__version__}"' in recipe
    needs = names_of(project["dependencies"])
    assert needs <= set(re.findall(r"^ +- ([\w-]+)", recipe, re.M))
    needs -= {"cffi", "mpi4py", "numpy"}
    assert needs <= set(re.findall(r"[\w-]+", (ROOT / "packaging/docker/Dockerfile").read_text()))
    needs |= names_of(data["dependency-groups"]["test"])
    workflow = (ROOT / ".github/workflows/ci.yml").read_text()
    jobs = re.findall(r"^.*(?:pip|conda) install (?!--).*(?:\n {10}[\w\"].*)*", workflow, re.M)
    assert len(jobs) == 2
    for job in jobs:
        assert needs <= set(re.findall(r"[\w-]+", job))
