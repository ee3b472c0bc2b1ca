# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The comparison of FETI with MUMPS, GAMG and others, small."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from wall_files import on_first

from benchmarks.common.bodies import create_clamped_block
from benchmarks.compare import path
from benchmarks.compare import run as compare
from benchmarks.compare.path import PHASES
from dolfinx_feti import ConvergenceError
from dolfinx_feti.feti.primal import form

SMALL = ["--dofs", "900", "--subdomains", "4"]
KEYS = {
    "solver",
    "geometry",
    "kappa",
    "dofs",
    "subdomains",
    "processes",
    "threads",
    "newton_iterations",
    "path_mmhg",
    "iterations",
    "seconds_setup",
    "seconds_solve",
    "peak_mib",
    "relative_residual",
    "difference_to_mumps",
}


def read(path: Path) -> list[dict[str, object]]:
    return on_first(lambda: json.loads(path.read_text()))


def broadcast_path(path: Path) -> str:
    return COMM.bcast(str(path))


def refuse(*_args, **_options):
    raise AssertionError("a body is made")


@pytest.fixture
def no_work(monkeypatch):
    """Whatever is wrong is found before there is a body."""
    monkeypatch.setattr(compare, "_create_body", refuse)


def test_all_solvers_solve_the_same_system(tmp_path, capfd):
    path = tmp_path / "new/compare.json"
    records = compare.main([*SMALL, "--kappa", "1000", "--json", str(path)])
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
    spent = feti["seconds_phases"]
    agree(set(spent) == set(PHASES) and min(spent.values()) > 0.0, spent)
    agree(sum(spent.values()) < feti["seconds_setup"] + feti["seconds_solve"], spent)
    agree("seconds_phases" not in mumps.keys() | gamg.keys())
    agree(10 < feti["iterations"] < gamg["iterations"], "κ is hard on GAMG")
    agree(read(path) == records)
    said = capfd.readouterr().out
    if COMM.rank > 0:
        ok = said == ""
    else:
        lines = [json.loads(line) for line in said.splitlines() if line.startswith("{")]
        ok = lines == records and "all_floating" in said
    agree(ok, said)


@pytest.mark.serial
def test_several_sizes():
    """Two sizes, and not all solvers."""
    words = ["--dofs", "900,3000", "--subdomains", "4", "--solvers", "mumps,gamg"]
    records = compare.main(words)
    agree([record["solver"] for record in records] == ["mumps", "gamg"] * 2, records)
    agree(records[0]["dofs"] < records[2]["dofs"] and records[0]["subdomains"] == 4)
    small(max(record["difference_to_mumps"] for record in records), 1e-6)


@pytest.mark.serial
def test_block(tmp_path):
    """Both κ; hardly more iterations at the larger one, with a load that has something to do."""
    words = ["--geometry", "block", "--dofs", "3000", "--subdomains", "8", "--kappa", "10,1000"]
    records = compare.main([*words, "--solvers", "feti,mumps"])
    agree([r["kappa"] for r in records if r["solver"] == "feti"] == [10.0, 1000.0])
    agree(all(r["geometry"] == "block" and r["dofs"] == 2187 for r in records), records)
    agree(5 < records[2]["iterations"] <= 1.25 * records[0]["iterations"])
    small(max(record["difference_to_mumps"] for record in records), 1e-6)


def test_block_is_clamped_on_five_faces():
    """The nodes of the sixth face that are on no other one are free."""
    block = create_clamped_block(COMM, dofs=400, kappa=10.0, subdomains=None, options={})
    V = block.u.function_space
    n = V.dofmap.index_map.size_local
    x = V.tabulate_dof_coordinates()[:n]
    inside = (x[:, 1:] > 1e-6).all(axis=1) & (x[:, 1:] < 1 - 1e-6).all(axis=1) & (x[:, 0] > 1e-6)
    held = np.zeros(3 * n, dtype=bool)
    dofs, _ = block.problem.bcs[0].dof_indices()
    held[dofs[dofs < 3 * n]] = True
    agree((held.reshape(n, 3) == ~inside[:, None]).all())


def test_rounds():
    """The record of the median round, with the seconds of all."""
    words = [*SMALL, "--degree", "1", "--rounds", "3", "--solvers", "mumps,gamg"]
    for record in compare.main(words):
        each = [sum(pair) for pair in record["seconds_rounds"]]
        agree(len(each) == 3 and record["degree"] == 1, record)
        equal(record["seconds_setup"] + record["seconds_solve"], np.median(each), 1e-12)


def test_cost_of_an_average():
    """A greater one leaves fewer columns, and more iterations; FETI has its own again after."""
    words = [*SMALL, "--cost", "1.5,1e9", "--solvers", "feti"]
    few, many = compare.main(words)
    agree((few["cost"], many["cost"]) == (1.5, 1e9) and form.COST == compare.COST)
    agree(few["iterations"] < many["iterations"], (few, many))


def test_loaded_body(tmp_path):
    """All solve the step in its equilibrium; the second run finds that in the folder."""
    folder = broadcast_path(tmp_path)
    words = [*SMALL, "--kappa", "10", "--loaded", "2", "--solvers", "feti,mumps"]
    first, again = (compare.main([*words, "--folder", folder]) for _ in range(2))
    for record in first + again:
        agree(record["converged"] and record["loaded_mmhg"] == 2.0, record)
        small(record["relative_residual"], 1e-8)
    agree(first[0]["iterations"] == again[0]["iterations"], (first, again))


@pytest.mark.serial
def test_vessel(tmp_path):
    """The coarsest that can be meshed."""
    pytest.importorskip("gmsh")
    words = ["--geometry", "vessel", "--dofs", "50000", "--folder", str(tmp_path)]
    (record,) = compare.main([*words, "--solvers", "mumps"])
    agree(record["converged"] and 45_000 < record["dofs"] < 55_000, record)
    small(record["relative_residual"], 1e-8)


def test_path():
    """One Newton's method; FETI and MUMPS solve the same systems."""
    feti, mumps = compare.main([*SMALL, "--path", "2", "--kappa", "10"])
    agree([feti["solver"], mumps["solver"]] == ["feti", "mumps"])
    for record in (feti, mumps):
        agree(record.keys() >= KEYS and record["converged"] and record["note"] == "", record)
        agree(record["path_mmhg"] == 2.0 and record["load_steps"] >= 2, record)
        linear = record["seconds_setup"] + record["seconds_solve"]
        agree(record["seconds_end_to_end"] > linear + record["seconds_assembly"], record)
        agree(record["linear_solves"] >= record["newton_iterations"] >= record["load_steps"])
        each = record["seconds_per_solve"]
        agree(len(each) == len(record["iterations_per_solve"]) == record["linear_solves"])
        equal(sum(each), record["seconds_setup"] + record["seconds_solve"], 1e-12)
        later = sum(each[1:]) / (record["newton_iterations"] - 1)
        equal(record["seconds_per_newton"], later, 1e-12)
        agree(record["seconds_assembly"] > 0.0 and record["seconds_setup"] > 0.0)
    agree(mumps["iterations"] == mumps["linear_solves"] < feti["iterations"])
    agree(min(feti["seconds_phases"].values()) > 0.0)
    small(feti["relative_residual"], 0.1)  # what the roughest step deserves
    small(mumps["relative_residual"], 1e-8)
    small(feti["difference_to_mumps"], 0.1)


def test_path_that_fails_is_recorded(monkeypatch):
    """With the reason, and with what was solved before."""

    def fold(problem, set_load, targets, *_args, **_options):
        set_load(targets[0])
        problem.solve()
        raise ConvergenceError("No equilibrium\nwas found.")

    monkeypatch.setattr(path, "follow_load", fold)
    records = compare.main([*SMALL, "--path", "0.1", "--kappa", "10"])
    for record in records:
        agree(not record["converged"], record)
        agree(record["note"] == "failed: No equilibrium was found.", record)
        agree(record["linear_solves"] >= 1 and record["newton_iterations"] == 0, record)


def test_solver_without_memory_is_recorded():
    """With the reason; the next solver has its turn, and the limit ends with the run."""
    words = ["--dofs", "30000", "--subdomains", "4", "--kappa", "10"]
    limit = 40.0 + 70.0 * COMM.size  # MiB; MUMPS takes from 100 on each of three to 150 alone
    mumps, gamg = compare.main([*words, "--solvers", "mumps,gamg", "--memory", f"{limit}"])
    agree(not mumps["converged"] and mumps["note"].startswith("failed: "), mumps)
    agree(mumps["free_mib"] == limit, mumps)
    agree(mumps["relative_residual"] is None and gamg["difference_to_mumps"] is None)
    agree(gamg["converged"] and gamg["note"] == "", gamg)
    (free,) = compare.main([*words, "--solvers", "mumps"])
    agree(free["converged"] and free["note"] == "", free)


@pytest.mark.serial
def test_records_of_other_runs_are_kept(tmp_path):
    path = tmp_path / "compare.json"
    arguments = [*SMALL, "--solvers", "gamg", "--json", str(path)]
    records = [compare.main([*arguments, "--kappa", kappa])[0] for kappa in ("20", "10")]
    agree(read(path) == records and [record["kappa"] for record in records] == [20.0, 10.0])
    agree(all(record["difference_to_mumps"] is None for record in records))


def test_cases_in_the_file_are_not_run_again(tmp_path, monkeypatch, capfd):
    """Unless asked for, with a solver that is not there, or on other threads."""
    file = tmp_path / "compare.json"
    words = [*SMALL, "--solvers", "gamg", "--json", str(file)]
    records = compare.main(words)
    capfd.readouterr()
    monkeypatch.setattr(compare, "_create_body", refuse)
    agree(compare.main(words) == records == read(file))
    said = COMM.bcast(capfd.readouterr().out)
    agree("in the records already" in said, said)
    for more in (["--again"], ["--solvers", "gamg,mumps"]):
        with raises(AssertionError, "a body is made"):
            compare.main([*words, *more])
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    with raises(AssertionError, "a body is made"):
        compare.main(words)


def test_file_of_another_study_is_refused(no_work, tmp_path, capsys):
    """As that of an earlier version, whose records had no geometry."""
    file = tmp_path / "other.json"
    on_first(lambda: file.write_text('[{"solver": "mumps", "kappa": 10.0}]'))
    with pytest.raises(SystemExit) as caught:
        compare.main(["--json", str(file)])
    said = COMM.bcast(capsys.readouterr().err)
    agree(caught.value.code == 2 and "holds records of another study" in said, said)


def test_too_many_subdomains(capsys):
    with pytest.raises(SystemExit) as caught:
        compare.main(["--dofs", "900", "--subdomains", "100000"])
    said = COMM.bcast(capsys.readouterr().err)
    agree(caught.value.code == 2 and "100000" in said, said)


@pytest.mark.serial
def test_vessel_that_is_too_coarse(tmp_path, capsys):
    pytest.importorskip("gmsh")
    words = ["--geometry", "vessel", "--dofs", "900", "--folder", str(tmp_path)]
    with pytest.raises(SystemExit) as caught:
        compare.main(words)
    said = capsys.readouterr().err
    assert caught.value.code == 2
    assert "tetrahedra" in said


@pytest.mark.serial
@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (["--kappa", "0"], "argument --kappa: '0' is not a positive number"),
        (["--kappa", "-10"], "argument --kappa: '-10' is not a positive number"),
        (["--kappa", "nan"], "argument --kappa: 'nan' is not a positive number"),
        (["--kappa", "inf"], "argument --kappa: 'inf' is not a positive number"),
        (["--kappa", "stiff"], "argument --kappa: 'stiff' is not a positive number"),
        (["--dofs", "0"], "argument --dofs: '0' is not a number 1, 2, 3"),
        (["--dofs", "-5"], "argument --dofs: '-5' is not a number 1, 2, 3"),
        (["--dofs", "1e5"], "argument --dofs: '1e5' is not a number 1, 2, 3"),
        (["--subdomains", "0"], "argument --subdomains: '0' is not a number 1, 2, 3"),
        (["--solvers", "feti,umfpack"], "--solvers: 'umfpack' is none of: feti, mumps"),
        (["--solvers", ""], "argument --solvers: '' is none of: feti, mumps"),
        (["--loaded", "0"], "argument --loaded: '0' is not a positive number"),
        (["--loaded", "1", "--path", "1"], "--path and --loaded exclude each other"),
        (["--kapa", "10"], "unrecognized arguments: --kapa"),
        (["--geometry", "cube"], "argument --geometry: invalid choice: 'cube'"),
        (["--memory", "0"], "argument --memory: '0' is not a positive number"),
        (["--path", "0"], "argument --path: '0' is not a positive number"),
        (["--path", "-1"], "argument --path: '-1' is not a positive number"),
        (["--path", "1", "--solvers", "feti,gamg"], "--path takes no other solvers than feti, mum"),
        (["--path", "1", "--solvers", "mumps"], "--path needs feti among the --solvers"),
        (["--path", "1", "--cost", "6"], "--path and --cost exclude each other"),
    ],
)
def test_wrong_words(no_work, capsys, arguments, match):
    with pytest.raises(SystemExit) as caught:
        compare.main(arguments)
    said = capsys.readouterr().err
    agree(caught.value.code == 2 and match in said, said)


@pytest.mark.parametrize("place", ["file/compare.json", "folder", "notes"])
def test_file_that_cannot_be_written(no_work, capsys, tmp_path, place):
    """Below a file, a folder, or something else than records, which stays as it is."""

    def make():
        (tmp_path / "folder").mkdir()
        for name in ("file", "notes"):
            (tmp_path / name).write_text("mine")

    on_first(make)
    with pytest.raises(SystemExit) as caught:
        compare.main(["--json", str(tmp_path / place)])
    said = capsys.readouterr().err
    printed = f"error: --json '{tmp_path / place}' cannot be used" in said
    agree(caught.value.code == 2 and printed == (COMM.rank == 0), said)
    agree((tmp_path / "notes").read_text() == "mine")


@pytest.mark.serial
def test_options_of_petsc_are_left_to_it(no_work):
    """Words with one dash, and their values, are no mistake."""
    with pytest.raises(AssertionError, match="a body is made"):
        compare.main(["-tube_feti_type", "classical", "--dofs", "900", "-log_view"])
