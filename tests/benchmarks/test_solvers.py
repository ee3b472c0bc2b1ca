# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The comparison of FETI with MUMPS, GAMG and others, small."""

from __future__ import annotations

import importlib.machinery
import json
import math
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from collective import COMM, agree, equal, small
from problems import cube, poisson
from scipy.sparse import triu
from scipy.sparse.linalg import splu
from wall_files import on_first
from walls import tube, wall

import dolfinx_feti
from benchmarks import compare
from benchmarks.common import bodies
from benchmarks.common.compare import tables
from benchmarks.common.compare.geometries import Request, create_block
from benchmarks.common.compare.opponents import OPPONENTS
from dolfinx_feti import ConvergenceError, LinearProblem, loads
from dolfinx_feti.comparison import assembled_system

pytest.importorskip("matplotlib")

SMALL = ["--dofs", "900", "--subdomains", "4"]
main = compare.STUDY.main


KEYS = set(
    "solver geometry kappa dofs subdomains processes threads newton_iterations path_mmhg "
    "iterations seconds_setup seconds_solve peak_mib relative_residual difference_to_mumps".split()
)


def test_all_solvers_solve_the_same_system(tmp_path, capfd):
    path = tmp_path / "new/compare.json"
    records = main([*SMALL, "--kappa", "1000", "--json", str(path)])
    agree([record["solver"] for record in records] == ["feti", "mumps", "gamg"])
    feti, mumps, gamg = records
    for record in records:
        agree(record.keys() >= KEYS and record["converged_reason"] > 0, record)
        agree(record["kappa"] == 1000.0 and record["dofs"] == feti["dofs"] > 500)
        agree(record["processes"] == COMM.size and record["threads"] >= 1)
        agree(record["path_mmhg"] is None and record["newton_iterations"] == 1)
        agree(record["seconds_setup"] > 0.0 and record["seconds_solve"] > 0.0)
        agree(record["peak_mib"] >= 0.0 or math.isnan(record["peak_mib"]), record)
        small(record["relative_residual"], 1e-8)
        small(record["difference_to_mumps"], 1e-6)
    agree(mumps["iterations"] == 1 and mumps["difference_to_mumps"] == 0.0)
    agree(10 < feti["iterations"] < gamg["iterations"], "κ is hard on GAMG")
    agree(on_first(lambda: json.loads(path.read_text())) == records)
    said = capfd.readouterr().out
    if COMM.rank > 0:
        ok = said == ""
    else:
        lines = [json.loads(line) for line in said.splitlines() if line.startswith("{")]
        ok = lines == records and "all_floating" in said
    agree(ok, said)


def test_block_is_clamped_on_five_faces():
    """The nodes of the sixth face that are on no other one are free."""
    request = Request(dofs=400, degree=2, kappa=10.0, folder=Path())
    block = create_block(COMM, request, {})
    V = block.u.function_space
    x = V.tabulate_dof_coordinates()
    free = np.ones(len(block.u.x.array))
    inside = (x[:, 1:] > 1e-6).all(axis=1) & (x[:, 1:] < 1 - 1e-6).all(axis=1) & (x[:, 0] > 1e-6)
    for bc in block.problem.bcs:
        bc.set(free)
    agree((free.reshape(-1, 3) == inside[:, None]).all())


def test_record_is_that_of_the_median_round():
    """The record of the median round, with the seconds of all."""
    words = [*SMALL, "--degree", "1", "--rounds", "3", "--solvers", "mumps,gamg"]
    for record in main(words):
        each = [sum(pair) for pair in record["seconds_rounds"]]
        agree(len(each) == 3 and record["degree"] == 1, record)
        equal(record["seconds_setup"] + record["seconds_solve"], np.median(each), 1e-12)


def test_loaded_body(tmp_path):
    """All solve a step in the loaded equilibrium, which the second run reads from the folder."""
    folder = COMM.bcast(str(tmp_path))
    words = [*SMALL, "--kappa", "10", "--loaded", "2", "--solvers", "feti,mumps"]
    first, again = (main([*words, "--folder", folder]) for _ in range(2))
    for record in first + again:
        agree(record["converged"] and record["loaded_mmhg"] == 2.0, record)
        small(record["relative_residual"], 1e-8)
    agree(first[0]["iterations"] == again[0]["iterations"], (first, again))


@pytest.mark.serial
def test_vessel_is_solved_on_its_coarsest_mesh(tmp_path):
    """It has the coarsest mesh that can be generated."""
    pytest.importorskip("gmsh")
    words = ["--geometry", "vessel", "--dofs", "50000", "--folder", str(tmp_path)]
    (record,) = main([*words, "--solvers", "mumps"])
    agree(record["converged"] and 45_000 < record["dofs"] < 55_000, record)
    small(record["relative_residual"], 1e-8)


def test_path_solves_the_same_systems_with_feti_and_mumps():
    """One Newton's method; FETI and MUMPS solve the same systems."""
    feti, mumps = main([*SMALL, "--path", "2", "--kappa", "10"])
    agree([feti["solver"], mumps["solver"]] == ["feti", "mumps"])
    for record in (feti, mumps):
        agree(record.keys() >= KEYS and record["converged"] and record["note"] == "", record)
        agree(record["path_mmhg"] == 2.0 and record["load_steps"] >= 2, record)
        linear = record["seconds_setup"] + record["seconds_solve"]
        agree(record["seconds_end_to_end"] > linear + record["seconds_assembly"], record)
        agree(record["linear_solves"] >= record["newton_iterations"] >= record["load_steps"])
        agree(len(record["iterations_per_solve"]) == record["linear_solves"])
        agree(0.0 < record["seconds_per_newton"] * (record["newton_iterations"] - 1) < linear)
        agree(record["seconds_assembly"] > 0.0 and record["seconds_setup"] > 0.0)
    agree(mumps["iterations"] == mumps["linear_solves"] < feti["iterations"])
    small(feti["relative_residual"], 0.1)  # what the roughest step deserves
    small(mumps["relative_residual"], 1e-8)
    small(feti["difference_to_mumps"], 0.1)


def test_path_that_fails_is_recorded(monkeypatch):
    """The record has the reason, and the solves before the failure."""

    def fold(problem, set_load, targets, *_args, **_options):
        set_load(targets[0])
        problem.solve()
        raise ConvergenceError("No equilibrium\nwas found.")

    monkeypatch.setattr(bodies, "follow_load", fold)
    records = main([*SMALL, "--path", "0.1", "--kappa", "10"])
    for record in records:
        agree(not record["converged"], record)
        agree(record["note"] == "failed: No equilibrium was found.", record)
        agree(record["linear_solves"] >= 1 and record["newton_iterations"] == 0, record)


@pytest.mark.parametrize("geometry", ["pillar", "cube", "square", "heat"])
def test_sweep_over_subdomains(geometry, tmp_path):
    """There are as many as asked for; the page has each time over the least one."""
    path = tmp_path / "compare.json"
    words = ["--geometry", geometry, "--dofs", "300", "--per", "100,2000", "--json", str(path)]
    few, one = main([*words, "--degree", "1" if geometry == "heat" else "2"])
    for record in (few, one):
        agree(record["converged"] and record["seconds_cpu"] > 0.0, record)
        agree(100 < record["dofs"] < 600 and record["solver"] == "feti", record)
        agree(record["subdomains"] == max(COMM.size, round(300 / record["per"])), record)
    if COMM.size == 1:
        text = compare.STUDY.write_page([path], tmp_path)
        agree(f"| {geometry} | {few['degree']} | 1 | {few['dofs']} | – | – |" in text, text)


@pytest.mark.parametrize("geometry", tables.COMPRESSIBLE)
def test_formulations_on_compressible_bodies(geometry, tmp_path):
    """Both agree with MUMPS; the page has a row with both, and a figure."""
    path = tmp_path / "compare.json"
    names = ["feti", "feti-dual", "mumps"]
    words = ["--geometry", geometry, "--degree", "1", "--dofs", "600", "--json", str(path)]
    words += ["--subdomains", "4", "--solvers", ",".join(names)]
    records = main(words)
    agree(sorted(r["solver"] for r in records) == sorted(names), records)
    for record in records:
        agree(record["converged"] and record["note"] == "", record)
        agree(300 < record["dofs"] < 1200 and record["kappa"] is None, record)
        small(record["difference_to_mumps"], 1e-3)
    if COMM.size == 1:
        text = compare.STUDY.write_page([path], tmp_path)
        body = tables.COMPRESSIBLE[geometry]
        assert text.count(f"| {body} |") == 1 + len(names), text
        assert "FETI, dual" in text


@pytest.mark.serial
@pytest.mark.parametrize("field", ["solver", "geometry"])
def test_a_record_without_a_title_is_refused(field, tmp_path):
    """It would be missing from the page."""
    record = {"solver": "feti", "geometry": "cube", "threads": 1, "path_mmhg": None, "degree": 1}
    assert compare.STUDY.known(record)
    path = tmp_path / "compare.json"
    path.write_text(json.dumps([record | {field: "unknown"}]))
    with pytest.raises(ValueError, match="holds no records of speed"):
        compare.STUDY.write_page([path], tmp_path)


def test_records_of_other_threads_and_solvers_are_run(tmp_path, monkeypatch):
    """κ and threads distinguish cases; a solver without a record is run."""
    path = COMM.bcast(str(tmp_path / "compare.json"))
    words = [*SMALL, "--solvers", "gamg", "--kappa", "10", "--json", path]
    first = main(words)
    agree(main(words) == first)
    monkeypatch.setattr(compare, "_create_body", lambda *_: pytest.fail("a body is made"))
    agree(main(words) == first)
    for more in (["--kappa", "20"], ["--solvers", "gamg,mumps"], ["--again"]):
        with pytest.raises(pytest.fail.Exception):
            main([*words, *more])
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    with pytest.raises(pytest.fail.Exception):
        main(words)


RTOL = 1e-9

#: Solvers that take one process only, or whose packages may be missing.
ALONE = ("cholmod", "pardiso")


@pytest.mark.parametrize("degree", [1, 2])
def test_everybody_solves_the_next_newton_step(degree):
    """The body is loaded and has a condensed pressure; the comparison does not change its state."""
    body = wall(tube(around=8, along=2), degree=degree)
    problem = body.problem(4, {"ksp_rtol": RTOL, "snes_rtol": 1e-10})
    body.inflate(problem, [1.0])
    state = body.u.x.array.copy(), body.p.x.array.copy()
    body.load.value = loads.mmhg(1.2)
    options = {name: opponent.options for name, opponent in OPPONENTS.items()}
    found = dolfinx_feti.compare(problem, options)
    solved = [s for s in found.results if s.solver not in ALONE]
    agree(len(solved) >= 6, found)
    agree(all(s.converged and not s.note for s in solved), found)
    for each in solved:
        small(each.relative_residual, 1.01 * RTOL)
        small(each.difference_to_direct, 1e4 * RTOL)
    for function, before in zip((body.u, body.p), state, strict=True):
        equal(function.x.array, before)
    A, b = problem.linear_system()
    K, f = assembled_system(A, b)
    small(f.norm() - problem.residual_norm(), 1e-12 * f.norm())
    for made in (K, f, b):
        made.destroy()


@pytest.mark.serial
def test_pardiso(monkeypatch):
    """By a fake module; if PARDISO is missing from it, the note has the error."""
    module = types.ModuleType("pypardiso")
    module.__spec__ = importlib.machinery.ModuleSpec("pypardiso", None)
    monkeypatch.setitem(sys.modules, "pypardiso", module)
    body = poisson(cube(2, 4))
    problem = LinearProblem(body.a, body.L, bcs=body.bcs, subdomains=3)
    chosen = {"mumps": {}, "pardiso": OPPONENTS["pardiso"].options}
    assert not dolfinx_feti.compare(problem, chosen).results[1].converged
    module.PyPardisoSolver = Direct
    assert dolfinx_feti.compare(problem, chosen).results[1].difference_to_direct < 1e-10


class Direct:
    """What PARDISO's module offers, by scipy."""

    def __init__(self, mtype):
        self.symmetric = mtype != 11

    def factorize(self, A):
        A = A + triu(A, 1).T if self.symmetric else A
        self.factors = splu(A.tocsc())

    def solve(self, _A, b):
        return self.factors.solve(b)

    def free_memory(self, everything):
        del self.factors
