# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Every demo runs: from the command line on one process, and here on as many as there are."""

from __future__ import annotations

import ast
import csv
import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, raises, small
from wall_files import DEMOS, EXAMPLE, ROOT, on_first

from dolfinx_feti.meshes.files import write_msh, write_wall_arrays
from dolfinx_feti.runtime.petsc_options import inserted
from dolfinx_feti.wall.wallfile import read_wall_arrays

pytest.importorskip("gmsh")
pytest.importorskip("pyvista")

#: A wall as small as can be, with both layers.
TUBE = "--mesh tube --size 1 --pressure 2 --steps 3 --subdomains 4".split()
#: Its numbers, on any number of processes.
TUBE_DOFS = 1680
TUBE_DISPLACEMENT = 0.03652351  # mm
#: Demos without a command line, with a picture that each draws.
DEMO_PICTURES = {
    "demo_artery.py": "output/artery/wall.png",
    "demo_balloon.py": "balloon.png",
    "demo_classical_vs_all_floating.py": "cube.png",
    "demo_contact.py": "contact.png",
    "demo_growth.py": "growth.png",
    "demo_hyperelasticity.py": "hyperelasticity.png",
    "demo_jumps.py": "jumps.png",
    "demo_linear_elasticity.py": "linear_elasticity.png",
    "demo_load_steps.py": "membrane.png",
    "demo_memory.py": "memory.png",
    "demo_nearly_incompressible.py": "nearly_incompressible.png",
    "demo_own_artery.py": "artery.png",
    "demo_own_material.py": "own_material.png",
    "demo_patient.py": "patient.png",
    "demo_poisson.py": "poisson.png",
    "demo_pulse.py": "pulse.png",
    "demo_solver_options.py": "solver_options.png",
    "demo_thick_tube.py": "thick_tube.png",
    "demo_torn_matrix.py": "temperature.png",
    "demo_windkessel.py": "windkessel.png",
}
#: Demos whose meshes are smaller here: a part of a line of the demo, and what is in its place.
COARSER = {"demo_own_artery.py": ("size = 0.45 ", "size = 0.6 ")}
#: Demos that take more than ten seconds on two processes. What they call has tests of its own
#: there: contact, unloading, Windkessels, inertia, paths of κ. On one process the site runs them.
LONG = {
    "demo_artery.py",
    "demo_contact.py",
    "demo_nearly_incompressible.py",
    "demo_patient.py",
    "demo_pulse.py",
    "demo_windkessel.py",
}
LEAST = ["--mesh", str(EXAMPLE), *"--degree 1 --pressure 0.5 --steps 1 --subdomains 4".split()]


@pytest.fixture
def run(monkeypatch) -> Callable[..., dict[str, Any]]:
    """Run a demo as a script on the processes of this test; return its variables."""

    def script(name: str, *arguments: object) -> dict[str, Any]:
        path = DEMOS / name
        monkeypatch.setattr(sys, "argv", [str(path), *map(str, arguments)])
        source = path.read_text(encoding="utf-8")
        if name in COARSER:
            line, coarser = COARSER[name]
            agree(source.count(line) == 1, line)
            source = source.replace(line, coarser)
        variables: dict[str, Any] = {"__name__": "__main__"}
        exec(compile(source, str(path), "exec"), variables)
        return variables

    return script


def read_summary(folder: Path) -> dict[str, Any]:
    return on_first(lambda: json.loads((folder / "summary.json").read_text()))


def check_pictures(folder: Path, *names: str, height: int = 300, width: int = 500) -> None:
    """Assert that each picture exists, is large enough, and has more than one colour."""
    from matplotlib.image import imread

    def look() -> list[tuple[float, ...]]:
        images = [imread(folder / name) for name in names]
        return [(float(np.ptp(image)), *image.shape[:2]) for image in images]

    found = on_first(look)
    agree(all(range_ > 0.5 and h > height and w > width for range_, h, w in found), found)


@pytest.mark.serial
def test_every_demo_has_its_test():
    """A new demo needs an entry here."""
    there = {path.name for path in DEMOS.glob("demo_*.py")}
    agree(there == {*DEMO_PICTURES, "demo_case.py"})


@pytest.mark.serial
@pytest.mark.parametrize("name", sorted([*DEMO_PICTURES, "demo_case.py"]))
def test_demos_need_the_installed_package_alone(name):
    """They neither import from a checkout nor use its files; notebooks have no ``__file__``."""
    source = (DEMOS / name).read_text(encoding="utf-8")
    beside = {"benchmarks", "demos", "meshes", "scripts", "tests"}
    beside |= {path.stem for path in DEMOS.iterdir()}
    for node in ast.walk(ast.parse(source)):
        imported = []
        if isinstance(node, ast.Import):
            imported = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            imported = [node.module]
        agree(not beside & {module.split(".")[0] for module in imported}, imported)
        is_riddle = isinstance(node, ast.Lambda | ast.NamedExpr)
        agree(not is_riddle, f"{name}: {ast.unparse(node)}" if is_riddle else "")
    agree("__file__" not in source and "fmt: skip" not in source)


# -- they run


@pytest.mark.processes(2)
@pytest.mark.parametrize("name", sorted(DEMO_PICTURES.keys() - LONG))
def test_demos_without_a_command_line(run, monkeypatch, tmp_path, name):
    """The assertions in each demo hold, and the first process draws its picture.

    On one process ``make docs`` runs them.
    """
    monkeypatch.chdir(tmp_path)
    run(name)
    options = PETSc.Options()
    for key in options.getAll():
        if key.startswith(("dolfinx_solve_", "direct_")):  # dolfinx leaves them behind
            options.delValue(key)
    check_pictures(tmp_path, DEMO_PICTURES[name])


def test_linear_elasticity(run, monkeypatch, tmp_path):
    """It compares itself with MUMPS; here its tip is compared with the theory of beams."""
    monkeypatch.chdir(tmp_path)
    beam = run("demo_linear_elasticity.py")
    length = 8.0
    inertia = 1.0 / 12.0
    weight = 1e-2
    tip = weight * length**4 / (8 * beam["E"] * inertia)
    tip += weight * length**2 / (2 * 5 / 6 * beam["mu"])  # by shear
    u = beam["uh"].x.array.reshape(-1, 3)
    sunk = -COMM.allreduce(u[:, 2].min(initial=0.0), op=min)
    small(sunk / tip - 1.0, 0.03)
    small(beam["difference"], 1e-7)


def check_tube(folder: Path) -> None:
    """Assert that its summary has the numbers of any number of processes, and its files exist."""
    summary = read_summary(folder)
    agree(summary["load_steps"][-1] == 2.0 and summary["subdomains"] >= 4, summary)
    agree(summary["newton_iterations"] >= len(summary["load_steps"]) >= 2, summary)
    for cost in summary["last_step"]:
        agree(cost["seconds_setup"] > 0.0 and cost["seconds_solve"] > 0.0, cost)
        agree(cost["converged_reason"] > 0 and cost["relative_residual"] <= 1e-8, cost)
    agree(summary["dofs"] == TUBE_DOFS, summary["dofs"])
    small(summary["max_displacement_mm"] / TUBE_DISPLACEMENT - 1.0, 1e-6)
    check_pictures(folder, "wall.png", "fibres.png")
    agree(any(folder.glob("wall.[bx]*")))
    rows = on_first(lambda: list(csv.DictReader((folder / "history.csv").read_text().splitlines())))
    agree(len(rows) == summary["newton_iterations"], len(rows))
    agree(float(rows[-1]["load"]) == 2.0, rows[-1])


@pytest.mark.processes(2)
def test_case(run, tmp_path):
    run("demo_case.py", *TUBE, "--output", tmp_path)
    check_tube(tmp_path)


@pytest.mark.serial
def test_case_from_the_command_line(tmp_path):
    """It gives the same numbers as on several processes."""
    words = [DEMOS / "demo_case.py", *TUBE, "--output", tmp_path, "-log_view"]
    how = {"cwd": ROOT, "stderr": subprocess.STDOUT, "timeout": 300.0, "text": True}
    said = subprocess.check_output([sys.executable, *words], **how)
    agree("FETISolve" in said and "A Newton step at 2 mmHg" in said, said)
    step = r"load step 2: \d.* of 2 mmHg, .* linear iterations, residual .* left"
    agree(re.search(step, said), said)
    check_tube(tmp_path)


@pytest.mark.processes(1)
def test_vessel(run, tmp_path):
    """The default of the demo, on as coarse a mesh as there is."""
    few = "--size 2 --degree 1 --pressure 0.5 --steps 1 --subdomains 8".split()
    demo = run("demo_case.py", *few, "--output", tmp_path)
    agree(len(demo["case"].conditions) == 4 and demo["quality"].minimum >= 0.1)
    agree(read_summary(tmp_path)["load_steps"][-1] == 0.5)
    check_pictures(tmp_path, "wall.png", "fibres.png")


def test_wall_of_ones_own_and_options_of_the_solver(run, tmp_path):
    with inserted("case_", {"feti_type": "classical", "feti_pc_type": "lumped"}):
        demo = run("demo_case.py", *LEAST, "--output", tmp_path)
    report = demo["problem"].solver.getKSP().getPythonContext().report()
    agree(report.options.type == "classical" and report.options.pc_type == "lumped")
    agree(demo["mesh"].topology.index_map(3).size_global == 336)
    agree(read_summary(tmp_path)["load_steps"] == [0.5])


def test_picture_that_cannot_be_written_ends_all_processes(run, tmp_path):
    """The first process alone draws; the others would wait for it in the comparison with MUMPS."""
    on_first(lambda: (tmp_path / "wall.png").mkdir())
    with raises(IsADirectoryError, "wall.png"):
        run("demo_case.py", *LEAST, "--output", tmp_path)


# -- walls in TOML files


def write_case(folder, image: float):
    """A case with an image, of the example's tube with two openings."""
    text = (DEMOS / "patient.toml").read_text(encoding="utf-8")
    text = text.replace('"vessel"', f'"{EXAMPLE}"').replace("= 80.0 ", f"= {image} ")
    text = text.replace('[surfaces.opening_3]\nhold = "clamp"\n', "")
    path = folder / "case.toml"
    on_first(lambda: path.write_text(text, encoding="utf-8"))
    return path


def test_case_in_a_file(run, tmp_path):
    """The example: springs and dashpots, which hold the wall back, and an end that slides."""
    few = "--size 1 --degree 1 --steps 2 --subdomains 4".split()
    demo = run("demo_case.py", "--wall", DEMOS / "wall.toml", *few, "--output", tmp_path)
    summary = read_summary(tmp_path)
    tissues = demo["case"].layers
    agree((tissues["media"].c, tissues["adventitia"].c) == (3.0, 0.3))
    boundary = demo["boundary"]
    before, last = summary["load_steps"][-2:]
    small(float(boundary.time_step.value) - (last - before) / 100, 1e-12)
    agree(boundary.last.x.array.any() and boundary.energy is not None)


def test_prestretch_of_one_layer(run, tmp_path):
    """A wall without fibres, which all read, is pulled, and inflated beyond the file's pressure."""

    def write() -> None:
        arrays = read_wall_arrays(EXAMPLE)
        one_layer = np.ones_like(arrays.cell_tags)
        one = replace(arrays, cell_tags=one_layer, layer_names={"wall": 1})
        write_wall_arrays(tmp_path / "own.xdmf", one)
        text = 'mesh = "own.xdmf"\n[layers.wall]\nc = 20\n[surfaces.lumen]\npressure = 1\n'
        text += '[surfaces.opening_1]\nhold = "clamp"\n[surfaces.opening_2]\nhold = "clamp"\n'
        text += '[prestretch]\naxis = "z"\nstretch = 1.1\n'
        (tmp_path / "own.toml").write_text(text)

    on_first(write)
    few = "--degree 1 --steps 2 --subdomains 4 --pressure 2".split()
    demo = run("demo_case.py", *few, "--output", tmp_path, "--wall", tmp_path / "own.toml")
    summary = read_summary(tmp_path)
    agree(summary["load_steps"] == [1.0, 2.0] and demo["case"].layers["wall"].c == 20.0, summary)
    x = demo["V"].tabulate_dof_coordinates()
    top = demo["u"].x.array.reshape(-1, 3)[np.isclose(x[:, 2], 1.0)]
    small(float(np.abs(top - [0.0, 0.0, 0.1]).max(initial=0.0)), 1e-9)
    agree(not on_first((tmp_path / "fibres.png").exists))


# -- what they refuse


def refused(run, capsys, match, *arguments, demo="demo_case.py"):
    """The demo ends on all processes with status 2, and one line on the first."""
    capsys.readouterr()
    status = None
    try:
        run(demo, *arguments)
    except SystemExit as end:
        status = end.code
    agree(status == 2)
    said = capsys.readouterr().err.splitlines()
    lines = [f"^{demo}: error: .*{match}"] if COMM.rank == 0 else []
    agree(len(said) == len(lines) and all(map(re.search, lines, said)), said)


@pytest.mark.parametrize(
    ("arguments", "options", "match"),
    [
        (["--degree", "3"], {}, "invalid choice: "),
        (["--pressure", "nan"], {}, "argument --pressure: 'nan' is not a positive number"),
        (["--size", "-1"], {}, "argument --size: '-1' is not a positive number"),
        (["--steps", "1.5"], {}, "argument --steps: '1.5' is not a number 1, 2, 3"),
        (["--subdomains", "0"], {}, "argument --subdomains: '0' is not a number 1, 2, 3"),
        (["--presure", "10"], {}, "unrecognized arguments: --presure 10"),
        (["ten"], {}, "unrecognized arguments: ten"),
        (["-ksp_monitor", "--pressure", "10", "50"], {}, "arguments: 50 after --pressure"),
        (["--mesh", "nowhere.msh"], {}, "no file nowhere.msh"),
        ([*LEAST, "--subdomains", "337"], {}, "subdomains is 337, but the mesh has 336 cells"),
        (LEAST, {"feti_typ": "classical"}, "-case_feti_typ does not exist; did .*feti_type"),
        (LEAST, {"feti_type": "classic"}, "feti_type.*classic"),
    ],
    ids=[
        "degree",
        "pressure",
        "size",
        "steps",
        "subdomains",
        "misspelt",
        "word",
        "second-number",
        "no-mesh",
        "too-many-subdomains",
        "misspelt-option",
        "wrong-option",
    ],
)
def test_what_the_case_refuses(run, tmp_path, capsys, arguments, options, match):
    """Words, a missing mesh, and options of the solver."""
    with inserted("case_", options):
        refused(run, capsys, match, "--output", tmp_path, *arguments)


def test_output_folder_is_tried_before_the_mesh(run, tmp_path, capsys):
    """A folder cannot be created below a file; the missing mesh would be found later."""
    on_first(lambda: (tmp_path / "file").write_text("mine"))
    match = "output folder .*file/run cannot be written"
    refused(run, capsys, match, "--mesh", "nowhere.msh", "--output", tmp_path / "file/run")


def test_mesh_with_a_missing_tag(run, tmp_path, capsys):
    """The message lists the names found."""
    path = tmp_path / "wall.msh"

    def write() -> None:
        arrays = read_wall_arrays(EXAMPLE)
        names = {name: tag for name, tag in arrays.surface_names.items() if name != "lumen"}
        write_msh(path, replace(arrays, surface_names=names))

    on_first(write)
    match = "surfaces.lumen.: the wall has no surface 'lumen'; it has outer, opening_1, opening_2"
    refused(run, capsys, match, "--mesh", path, "--output", tmp_path / "run")


def test_case_of_an_image(run, tmp_path, capsys):
    """The message names the demo for such a case."""
    words = "--wall", write_case(tmp_path, 80.0), "--output", tmp_path
    refused(run, capsys, r"leave out \[image\].*demo_patient.py", *words)
