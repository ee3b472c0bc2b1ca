# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The rooms of the package and the arrows between them, read off its folders and imports."""

from __future__ import annotations

import ast
import importlib
import sys
from pathlib import Path

import pytest
import rooms

import dolfinx_feti

ROOT = Path(dolfinx_feti.__file__).parents[1]

pytestmark = pytest.mark.serial

MODULES = {module.name: module for module in rooms.modules()}
FINITE_ELEMENTS = {"basix", "dolfinx", "ffcx", "ufl"}
LONGEST, FULLEST = 400, 15
#: The gallery is flat: a folder for each demo would hide them.
GALLERY = 18


def files(*folders: str) -> list[Path]:
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def imports(path: Path) -> set[str]:
    """Full names that a file imports anywhere."""
    names = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} has a relative import"
            assert node.module is not None
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def own(path: Path) -> set[str]:
    """Modules of the package that a file imports."""
    found = set()
    for name in imports(path):
        if name.startswith("dolfinx_feti."):
            inside = name.removeprefix("dolfinx_feti.")
            known = {n for n in MODULES if inside == n or inside.startswith(f"{n}.")}
            assert known, f"{path} imports {name} past the module that defines it"
            found |= known
    return found


def attributes(path: Path) -> set[str]:
    """Names of all attributes that a file uses."""
    return {node.attr for node in ast.walk(tree(path)) if isinstance(node, ast.Attribute)}


def foreign(path: Path) -> set[str]:
    """Packages that a file imports."""
    return {name.split(".")[0] for name in imports(path)} - {"dolfinx_feti"}


def everything_below(names: set[str]) -> set[str]:
    """Modules that these import, directly or not, and themselves."""
    known: set[str] = set()
    while names - known:
        known |= names
        names = set().union(*(own(MODULES[name].path) for name in known))
    return known


def in_room(room: str) -> set[str]:
    names = {name for name in MODULES if name.startswith(f"{room}.")}
    assert names
    return names


def test_every_file_has_its_place_in_the_order():
    there = {path for path in files("dolfinx_feti") if path.name != "__init__.py"}
    assert {module.path for module in MODULES.values()} == there


def test_imports_follow_the_order_of_the_data():
    """A module imports only what comes before it, so there is no circle either."""
    place = {name: i for i, name in enumerate(MODULES)}
    for name, module in MODULES.items():
        later = {other for other in own(module.path) if place[other] >= place[name]}
        assert not later, f"{name} imports {later}"


def test_dual_strand_knows_no_finite_elements():
    """Nor does anything that it imports."""
    for name in everything_below(in_room("feti")):
        packages = foreign(MODULES[name].path)
        assert not packages & FINITE_ELEMENTS, name
        assert packages - set(sys.stdlib_module_names) <= {
            "mpi4py", "petsc4py", "numpy", "scipy", "cffi",
        }, name  # fmt: skip


def test_mechanics_knows_no_feti():
    """It is UFL, and would serve without any solver; dolfinx assembles what is tried at a rim."""
    for name in everything_below(in_room("mechanics")):
        assert name in in_room("mechanics"), name
        assert not foreign(MODULES[name].path) & {"petsc4py", "mpi4py"}, name
    use_dolfinx = {
        name for name in in_room("mechanics") if "dolfinx" in foreign(MODULES[name].path)
    }
    assert use_dolfinx == {"mechanics.loads"}


def test_workshop_knows_no_solver():
    """It compiles energies, on one cell."""
    for name in everything_below(in_room("workshop")):
        assert name.split(".")[0] in {"workshop", "mechanics", "runtime", "errors"}, name
        assert "petsc4py" not in foreign(MODULES[name].path), name


def test_finite_elements_know_no_solver():
    """They hand over at the torn matrix."""
    assert not everything_below(in_room("fem")) & in_room("feti")


def test_generated_pages_are_up_to_date():
    stale = [path.name for path, text in rooms.pages().items() if path.read_text() != text]
    assert not stale, f"run python3 scripts/rooms.py: {stale}"


def test_overview_names_every_file():
    """Once, with the first line of its docstring."""
    for module in MODULES.values():
        assert rooms.overview().count(f"`{module.path.name}` | {module.summary} |") == 1


def test_stale_page_is_noticed(monkeypatch, capsys):
    monkeypatch.setattr(rooms, "equations_page", lambda: "another table")
    assert rooms.main(["--check"]) == 1
    assert "equations.md is out of date" in capsys.readouterr().out


def test_no_two_test_files_have_one_name():
    """Pytest imports them by their names."""
    names = [path.name for path in files("tests") if path.name.startswith("test_")]
    assert len(names) == len(set(names)), sorted(n for n in names if names.count(n) > 1)


@pytest.mark.parametrize("folder", ["dolfinx_feti", "benchmarks", "demos", "meshes", "tests"])
def test_no_file_is_long(folder):
    long = {p.name: n for p in files(folder) if (n := len(p.read_text().splitlines())) > LONGEST}
    assert not long


@pytest.mark.parametrize("folder", ["dolfinx_feti", "benchmarks", "demos", "meshes"])
def test_no_folder_is_crowded(folder):
    folders = {path.parent for path in files(folder)}
    most = GALLERY if folder == "demos" else FULLEST
    assert not [f.name for f in folders if len(list(f.glob("*.py"))) > most]


def lined_up(folder: Path) -> list[Path]:
    """Files of a folder and of those in it, in the order that it gives; then what it does not."""
    named = [folder / name for name in rooms.order(folder)]
    found = [p for n in named for p in (lined_up(n) if n.is_dir() else [n.with_suffix(".py")])]
    assert all(path.is_file() for path in found), found
    return found


def beside(path: Path, folder: str) -> set[Path]:
    """Files of a folder beside the package that a file imports."""
    dotted = (name.split(".") for name in imports(path) if name.startswith(f"{folder}."))
    places = (ROOT.joinpath(*names[:n]) for names in dotted for n in range(2, len(names) + 1))
    return {p.with_suffix(".py") for p in places if p.with_suffix(".py").is_file()}


@pytest.mark.parametrize("folder", ["meshes", "benchmarks"])
def test_folders_beside_the_package_follow_their_order(folder):
    """A command line, ``__main__``, comes last."""
    order = lined_up(ROOT / folder)
    commands = sorted((ROOT / folder).rglob("__main__.py"))
    named = {path for path in files(folder) if path.name != "__init__.py"}
    assert set(order) == named - set(commands)
    for place, path in enumerate(order):
        assert beside(path, folder) <= set(order[:place]), path


def test_a_study_has_its_page_and_knows_only_common():
    """A study that writes records has a template beside it; nobody imports a study."""
    folder = ROOT / "benchmarks"
    studies = set(folder.glob("[a-z]*.py"))
    assert {path.with_suffix(".py") for path in folder.glob("*.md")} <= studies
    for path in files("benchmarks"):
        assert not beside(path, "benchmarks") & studies, path


def test_meshes_and_package_know_nothing_of_those_who_use_them():
    for path in files("dolfinx_feti"):
        assert not foreign(path) & {"benchmarks", "demos", "meshes", "tests"}, path
    for path in files("meshes"):
        assert not foreign(path) & {"benchmarks", "demos", "tests"}, path


def test_demos_stand_alone():
    """A demo needs the package, files of its own folder, and the meshes beside it."""
    for path in files("demos"):
        assert not foreign(path) & {"benchmarks", "tests"}, path


def test_nobody_changes_the_path_of_modules():
    """It is the checkout's root, by ``scripts/with-fenicsx`` or an editable installation."""
    for path in files("dolfinx_feti", "demos", "benchmarks", "meshes"):
        assert "sys.path" not in path.read_text(), path


@pytest.mark.parametrize("path", files("dolfinx_feti"), ids=str)
def test_file_has_licence_and_docstring(path):
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("# Copyright (C)") and "LGPL-3.0-or-later" in lines[2]
    assert rooms.docstring(path)


#: Rooms that users do not import from: in these a name without underscore is what other files use.
INNER = ("feti.", "fem.", "problems.", "runtime.", "torn.")


@pytest.mark.parametrize("name", [name for name in MODULES if not name.startswith(INNER)])
def test_public_names_are_declared_and_exist(name):
    namespace = importlib.import_module(f"dolfinx_feti.{name}")
    assert "__all__" in vars(namespace), "no __all__"
    assert all(hasattr(namespace, public) for public in namespace.__all__)


def test_versions_are_told_apart_in_one_place():
    for name in set(MODULES) - {"runtime.compat"}:
        assert not attributes(MODULES[name].path) & {"__version__", "version_info"}, name


def test_no_communicator_but_that_of_mesh_or_matrix():
    """A command begins with all processes."""
    for name in set(MODULES) - {"runtime.compat"}:
        assert "COMM_WORLD" not in attributes(MODULES[name].path), name


#: Names that README, the demos and the paper's readers use.
USED = {
    "dolfinx_feti": "FETI LinearProblem NonlinearProblem compare kinematics loads materials",
    "dolfinx_feti.comparison": "assembled_system measure",
    "dolfinx_feti.loading": "Checkpoint LoadStep Steps follow_load",
    "dolfinx_feti.output": "FieldWriter writable_folder",
    "dolfinx_feti.wall": "by_layer facets read_wall",
}


@pytest.mark.parametrize("module", USED)
def test_names_that_users_import(module):
    public = importlib.import_module(module).__all__
    assert set(USED[module].split()) <= set(public)
