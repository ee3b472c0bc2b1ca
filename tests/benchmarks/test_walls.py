# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Studies of walls: Newton steps beside the paper's, load steps, random walls."""

from __future__ import annotations

import dataclasses
import functools
import json
import re
import shutil
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small, whole
from wall_files import ROOT, on_first
from walls import tube

import dolfinx

from benchmarks import distorted_cells, load_stepping, nonlinear, random_walls
from benchmarks.common import study
from benchmarks.common.walls.first_step import POINTS, partition
from benchmarks.common.walls.problem import summarise, volume_ratios
from dolfinx_feti import NonlinearProblem
from dolfinx_feti.loading import Steps
from dolfinx_feti.meshes.walls import create_tube_wall
from dolfinx_feti.runtime.petsc_options import inserted
from dolfinx_feti.wall import facets, openings

pytest.importorskip("gmsh")
pytest.importorskip("matplotlib")

RECORD = ROOT / "docs/results/nonlinear.json"

SMALL = {
    nonlinear: "--degree 1 --kappa 10 --layers 1 --pc lumped",
    load_stepping: "--degree 2 --pressure 8 --first 5",
}


def run(study: ModuleType, tmp_path: Path, *words: str) -> list[dict]:
    """Run a study in small; return all records in its file."""
    file = COMM.bcast(str(tmp_path / "records.json"))
    place = ["--json", file, "--folder", COMM.bcast(str(tmp_path / "walls"))]
    small = f"--geometry tube --size 1 --subdomains 4 {SMALL[study]}".split()
    study.STUDY.main([*small, *place, *words])
    return on_first(lambda: json.loads(Path(file).read_text()))


def test_both_variants_with_both_choices(tmp_path):
    """Both variants come to the same state; CG solves with the paper's tangent."""
    records = run(nonlinear, tmp_path)
    agree(len(records) == 4)
    for record in records:
        its = record["linear_iterations_per_newton"]
        agree(len(its) == record["newton_iterations"] >= 2 and min(its) > 0, its)
        agree(record["min_J"] <= record["mean_J"] <= record["max_J"])
        agree(record["seconds_setup_per_newton"] > 0 and record["seconds_krylov_per_newton"] > 0)
        agree(record["multipliers"] > 0 and record["dofs"] > 0)
    for choices in ("paper", "default"):
        one, other = (r["min_J"] for r in records if r["choices"] == choices)
        equal(one, other, 1e-6)
    papers = [record for record in records if record["choices"] == "paper"]
    agree(all(set(record["linear_methods"]) == {"cg"} for record in papers), papers)
    (record,) = (record for record in papers if record["type"] == "classical")
    agree(record["clock"] == ("processor" if COMM.size == 1 else "wall"), record)
    paths = [tmp_path / "records.json"], tmp_path / "page"
    page = on_first(lambda: nonlinear.STUDY.write_page(*paths))
    mean = round(record["linear_iterations_mean"])
    steps = ", ".join(map(str, record["linear_iterations_per_newton"]))
    agree(f"| classical | 10 | lumped | 305 | 35.5 | {mean} | {steps} |" in page, page)


@pytest.mark.serial
def test_linear_solve_that_fails_is_recorded(tmp_path):
    """The record and the page have the reason."""
    with inserted("wall_", {"ksp_max_it": 2}):
        (record,) = run(nonlinear, tmp_path, "--type", "classical", "--choices", "default")
    agree("-wall_ksp_max_it" in record["failure"] and "min_J" not in record, record)
    page = nonlinear.STUDY.write_page([tmp_path / "records.json"], tmp_path)
    agree(f"| the package's defaults | 0 | {record['failure']} |" in page, page)


@pytest.mark.serial
def test_record_has_the_cases_of_the_command(tmp_path, monkeypatch):
    """The records on the site are those of the command line without options."""
    monkeypatch.setattr(study, "say", lambda *_: None)
    nothing_runs = dataclasses.replace(nonlinear.STUDY, run=None)
    records = nothing_runs.main(["--json", str(shutil.copy(RECORD, tmp_path))])
    agree(len(records) == len(json.loads(RECORD.read_text())) > 100, len(records))


def points_on_rim(wall, part, number):
    """Count the vertices of a subdomain of this process that are clamped."""
    V = dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 1))
    rims = np.concatenate([facets(wall, name) for name in openings(wall)])
    held = dolfinx.fem.locate_dofs_topological(V, 2, rims)
    return len(np.intersect1d(V.dofmap.list[: len(part)][part == number], held))


def test_one_subdomain_loses_the_rim():
    wall = create_tube_wall(COMM, length=3.0, through=(1, 1), around=12, along=12)
    whole, few, none = (partition(wall, 6, contact) for contact in ("whole", "few", "none"))
    changed = np.unique(whole[whole != none])
    agree(COMM.allreduce(len(changed)) == 1, changed)
    number = changed[0] if len(changed) else -1
    found = [points_on_rim(wall, part, number) for part in (whole, few, none)]
    agree(number == -1 or (found[0] > found[1] == POINTS and found[2] == 0), found)
    agree(np.all(few[few != none] < none[few != none]))  # those cells stay where they were
    agree(0 < COMM.allreduce(np.count_nonzero(few != none)) <= 3 * 24)
    with raises(ValueError, "touches a rim"):
        partition(wall, COMM.allreduce(len(whole)), "few")


@pytest.mark.parametrize("degree", [1, 2])
def test_volume_ratio_of_a_stretch(degree):
    """J = (1 + a)(1 + b x) has the mean 1 + b x at the centroid, up to the quadrature."""
    mesh = dolfinx.mesh.create_unit_cube(COMM, 2, 2, 2)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    u = dolfinx.fem.Function(V)
    b = 0.1 * (degree - 1)
    u.interpolate(lambda x: np.array([b * x[0] ** 2 / 2, 0.02 * x[1], 0.0 * x[2]]))
    n = mesh.topology.index_map(3).size_local
    x = dolfinx.mesh.compute_midpoints(mesh, 3, np.arange(n, dtype=np.int32))[:, 0]
    J = volume_ratios(u)
    equal(J, 1.02 * (1 + b * x), 1e-12)
    found = summarise(J, COMM)
    low, high = (f(whole(J)) for f in (np.min, np.max))
    equal([found["min_J"], found["max_J"], found["share_J"]], [low, high, 1.0], 1e-14)
    equal(found["mean_J"] - 1.0, found["mean_deviation_J"], 1e-10)


def test_both_variants_and_their_figures(tmp_path):
    records = run(load_stepping, tmp_path)
    ends = {}
    for kind in ("all_floating", "classical"):
        steps = [record for record in records if record["type"] == kind]
        agree(steps[-1]["pressure_mmhg"] == 8.0 and len(steps) == steps[-1]["steps"] >= 2)
        agree(all(0 < step["max_linear_residual"] <= 1e-8 for step in steps))
        agree(all(step["newton_iterations"] >= 1 for step in steps))
        norm = np.array([list(step["u_norm"].values()) for step in steps])
        agree(np.all(np.diff(norm, axis=0).max(axis=1) > 0) and norm.shape[1] == 5)
        ends[kind] = [*norm[-1], *steps[-1]["stress_magnitude"].values()]
    equal(ends["classical"], ends["all_floating"], 1e-6)

    on_first(lambda: load_stepping.STUDY.write_page([tmp_path / "records.json"], tmp_path))
    page = on_first(lambda: (tmp_path / "loading.md").read_text())
    row = f"| tube | 1 | P2–P0 | 4 | all-floating | {COMM.size} | 8 |"
    agree(row in page and "loading_tube_1_p2.png" in page, page)
    agree(on_first(lambda: (tmp_path / "loading_tube_1_p2.png").stat().st_size) > 20_000)


def test_run_goes_on_from_its_checkpoint(tmp_path, capsys):
    """Steps are counted from rest; ``--again`` needs another folder."""
    words = ["--type", "classical", "--checkpoint", COMM.bcast(str(tmp_path / "kept"))]
    first = run(load_stepping, tmp_path, *words, "--pressure", "5")
    whole_way = run(load_stepping, tmp_path, *words, "--pressure", "8", "--subdomains", "3")
    loads = [record["pressure_mmhg"] for record in whole_way]
    agree(whole_way[: len(first)] == first and loads == sorted(set(loads)) and loads[-1] == 8.0)
    agree([record["steps"] for record in whole_way] == list(range(1, len(loads) + 1)))
    capsys.readouterr()
    with pytest.raises(SystemExit):
        run(load_stepping, tmp_path, *words, "--again")
    said = COMM.bcast(capsys.readouterr().err)
    agree("--again begins anew" in said, said)


def test_points_do_not_depend_on_the_processes():
    """Five places far from each other, the same cells on any number of processes."""
    mesh = tube()
    points = load_stepping.five_points(mesh)
    n = mesh.topology.index_map(3).size_local
    X = dolfinx.mesh.compute_midpoints(mesh, 3, np.arange(n, dtype=np.int32))
    places = [whole(X[cell]) for cell in points]
    agree(all(place.shape == (1, 3) for place in places))
    x = np.concatenate(places)
    apart = np.linalg.norm(x[:, None] - x, axis=-1)[~np.eye(5, dtype=bool)]
    agree(apart.min() > 0.5, apart)
    everything = whole(X)
    nearest = np.linalg.norm(everything - everything.mean(axis=0), axis=1)
    small(np.linalg.norm(x[0] - everything.mean(axis=0)) / nearest.max() - 1.0, 1e-12)


@pytest.mark.serial
def test_random_walls_reach_the_target_pressure(tmp_path):
    path = tmp_path / "random_walls.json"
    words = ["--seeds", "3", "--json", str(path)]
    first = random_walls.STUDY.main(words)
    agree(random_walls.STUDY.main(words) == first == json.loads(path.read_text()))
    agree(all(record["reached"] == random_walls.MMHG and not record["error"] for record in first))
    agree(all(record["newton"] <= random_walls.MAX_NEWTON_STEPS for record in first))
    text = random_walls.STUDY.write_page([path], tmp_path)
    agree("**3 of 3 walls arrive, 3 with at most 80 Newton steps**" in text, text)


@pytest.mark.serial
def test_wall_that_does_not_arrive(tmp_path, monkeypatch):
    """A wall is too soft for the allowed Newton steps; record and page have pressure and reason."""
    soft = {"layers": ("media",), "c": (1.0,), "k1": (0.0,), "angles": (30.0,), "plaque": 1.0}
    chance = dataclasses.replace(random_walls.draw(2), **soft)
    monkeypatch.setattr(random_walls, "draw", lambda _seed: chance)
    monkeypatch.setattr(random_walls, "STEPS", Steps(first=2.0, least=2.0, growth=1.0))
    few = functools.partial(NonlinearProblem, petsc_options={"snes_max_it": 6})
    monkeypatch.setattr(random_walls, "NonlinearProblem", few)
    path = tmp_path / "random_walls.json"
    (record,) = random_walls.STUDY.main(["--seeds", "1", "--json", str(path)])
    said = r"No equilibrium was found beyond a load of 2: .* no convergence within 6 steps"
    agree(record["reached"] == 2.0 and re.match(said, record["error"]), record)
    text = random_walls.STUDY.write_page([path], tmp_path)
    agree("**0 of 1 walls arrive" in text and f"- 0: {record['error']}" in text, text)


@pytest.mark.serial
def test_seeds_draw_all_kinds():
    drawn = [random_walls.draw(seed) for seed in range(20)]
    kinds = {(chance.branches, chance.has_sac) for chance in drawn}
    agree(kinds >= {(2, True), (3, True), (3, False)})
    agree({len(chance.layers) for chance in drawn} == {1, 2, 3})
    agree(max(chance.plaque for chance in drawn) > 300)
    agree(any(all(c.springs) for c in drawn) and any(not any(c.springs) for c in drawn))


@pytest.mark.parametrize("way", ["clamped", "bubbles", "hexahedra", "springs", "sliding"])
def test_distorted_cells(way, tmp_path, monkeypatch):
    """A coarse tube: a record for each pressure, and a row of the page."""
    monkeypatch.setattr(distorted_cells, "PRESSURES", (2.0, 5.0))
    path = tmp_path / "distorted_cells.json"
    words = ["--along", "4", "--way", way, "--json", str(path)]
    first = distorted_cells.STUDY.main(words)
    agree([record["pressure_mmhg"] for record in first] == [2.0, 5.0], first)
    agree(distorted_cells.STUDY.main(words) == first, first)
    for record in first:
        agree(0.5 < record["least"] < 1.0 < record["greatest"] < 1.5, record)
        agree(record["inverted"] == record["found_inverted"] == 0, record)
    text = distorted_cells.STUDY.write_page([path], tmp_path)
    agree(distorted_cells.WAYS[way].name in text and "5 mmHg" in text, text)
