# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The benchmark of strong scaling: its records, what it refuses, its page."""

from __future__ import annotations

import json
import shutil

from mpi4py import MPI

import pytest

from benchmarks.common import machine
from benchmarks.scaling import page as scaling_page
from benchmarks.scaling import paper
from benchmarks.scaling import run as scaling
from benchmarks.scaling.run import TYPES
from benchmarks.scaling.traffic import COUNTERS
from benchmarks.scaling.weak import coarse_problem

pytest.importorskip("gmsh")
pytest.importorskip("matplotlib")
pytestmark = pytest.mark.serial

SMALL = "--geometry tube --size 1 --subdomains 4 --layers 2 --choices paper".split()


@pytest.mark.skipif(not shutil.which("mpicc"), reason="there is no mpicc")
def test_small_case_is_measured_and_counted(tmp_path, capsys):
    file, folder = tmp_path / "scaling.json", str(tmp_path / "walls")
    words = [*SMALL, "--processes", "1", "--count", "2", "--converge", "0"]
    words += ["--coarse", "0", "--json", str(file), "--folder", folder]
    status, said = scaling.main(words), capsys.readouterr().out
    assert status == 0, said
    counted, measured = json.loads(file.read_text())
    assert (counted["task"], counted["processes"]) == ("count", 2)
    assert counted["neighbours"] == 1
    assert counted["iteration"]["messages"]["max"] >= 1
    assert counted["iteration"]["reductions"]["max"] >= 1
    assert counted["coarse_solves"] >= 1
    assert counted["messages_to_each"] == counted["iteration"]["messages"]["mean"]  # a neighbour
    assert counted["reading"]["messages"]["max"] >= 1
    assert counted["reading_bytes"] < (tmp_path / "walls/tube_1.h5").stat().st_size
    parts = [measured[f"seconds_{part}"] for part in ("local", "krylov", "coarse", "reading")]
    assert min(parts) > 0.0
    assert sum(parts) <= measured["seconds_total"]
    assert len(measured["linear_iterations_per_newton"]) == measured["newton_iterations"] >= 2
    assert scaling.main(words) == 0
    assert capsys.readouterr().out.count("in the records already") == 2
    assert scaling.main(["--predict", "3000000", "512", "--json", str(file)]) == 0
    said = capsys.readouterr().out.splitlines()
    assert len(said) == 3 and "classical, the paper's choices: " in said[-1], said


@pytest.mark.skipif(not shutil.which("mpicc"), reason="there is no mpicc")
def test_load_step_to_its_end_with_a_subdomain_each(tmp_path, capsys):
    file, folder = tmp_path / "scaling.json", str(tmp_path / "walls")
    words = "--geometry tube --size 1 --layers 1 --processes 0 --count 0 --converge 4".split()
    words += ["--coarse", "0"]
    status = scaling.main([*words, "--json", str(file), "--folder", folder])
    assert status == 0, capsys.readouterr().out
    (found,) = json.loads(file.read_text())
    assert found["subdomains_in_all"] == found["subdomains"] == found["processes"] == 4
    assert found["residuals"][-1] < 1e-4 * found["residuals"][0]
    assert found["step"]["messages"]["max"] > 10 and found["neighbours"] <= 3


def test_memory_of_a_coarse_problem():
    """Of four subcubes along an edge."""
    found = coarse_problem({"subdomains": 64}, MPI.COMM_WORLD)
    assert found["subdomains_in_all"] == 64 and found["coarse_size"] == 6 * 64
    peak = found["coarse_peak_mib"]
    assert 0.0 < peak["mean"] == peak["max"] < 100.0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--geometry", "cube"], "invalid choice"),
        (["--processes", "two"], "not a number 0, 1"),
        (["--processes", "100000"], "shared ones measure nothing"),
        (["--processes", "1", "--count", "64", "--subdomains", "8"], "as many --subdomains"),
        (["--layers", "3"], "none of"),
        (["--coarse", "3"], "make a cube"),
        (["--json", "/dev/null/x.json"], "cannot be used"),
    ],
)
def test_bad_words(words, said, capsys):
    with pytest.raises(SystemExit) as caught:
        scaling.main(words)
    assert caught.value.code == 2
    assert said in capsys.readouterr().err


def test_file_of_another_study_is_refused(tmp_path, capsys):
    file = tmp_path / "other.json"
    file.write_text('[{"contact": "whole"}]')
    with pytest.raises(SystemExit):
        scaling.main(["--processes", "1", "--count", "0", "--json", str(file)])
    assert "records of another study" in capsys.readouterr().err


def test_missing_compiler_is_told(tmp_path, monkeypatch, capsys):
    which = {"mpirun": "/usr/bin/mpirun"}.get
    monkeypatch.setattr(shutil, "which", which)
    with pytest.raises(SystemExit):
        scaling.main(["--processes", "1", "--count", "2", "--folder", str(tmp_path)])
    assert "mpicc is missing" in capsys.readouterr().err


def test_page_of_the_papers_own_times(tmp_path):
    """The paper's seconds as records, and counts that grow or do not."""
    records = [
        _measured(layers, processes, times)
        for layers, by_processes in paper.TIMES.items()
        for processes, times in by_processes.items()
    ]
    records += [_counted(layers, P) for layers in TYPES for P in (8, 64)]
    records += [_coarse(P, mean, most) for P, mean, most in ((16, 55.0, 60.0), (2, 40.0, 50.0))]
    file = tmp_path / "scaling.json"
    file.write_text(json.dumps(records))
    page = scaling_page.main([str(file), "--output", str(tmp_path)])
    assert "| 512 | 12.70 | 1.003 | 67.60 | 0.606 | 161.00 | 0.394 |" in page
    assert "| 512 | 23.90 | 0.949 | 297.20 | 0.497 | 667.40 | 0.305 |" in page
    assert "| 8 | 6 | 5 | 2 | 1 | 10 | 8 | 10 | 10 | 10 | 2 | 10 | 10 | 0.01 | 10 |" in page
    assert "| 64 | 6 | 5 | 2.2 | 1.1 | 10 | 64 | 10 | 10 | 10 | 2 | 10 | 10 | 0.01 | 10 |" in page
    assert "| 2 | 4 096 | 24 576 | clusters | 40 | 50 | 1 |" in page
    assert "| 16 | 32 768 | 196 608 | clusters | 55 | 60 | 1.2 |" in page
    assert (tmp_path / "scaling.png").stat().st_size > 20_000


def _case(layers: int, processes: int, task: str) -> dict:
    case = {"study": "scaling", "task": task, "geometry": "vessel", "size": None, "layers": layers}
    case |= {"degree": 1, "kappa": 100.0, "type": TYPES[layers], "pc": "lumped"}
    case |= {"choices": "paper", "subdomains": 512, "processes": processes}
    case |= {"dofs": paper.DOFS[layers], "multipliers": 10**6, "coarse_size": 3072}
    case |= {"subdomains_in_all": 512, "formulation": "dual", "machine": machine.describe()}
    return case | {"date": "2026-01-02T03:04:05+00:00"}


def _measured(layers: int, processes: int, times: paper.Times) -> dict:
    seconds = {f"seconds_{part}": value for part, value in times._asdict().items()}
    seconds |= {"seconds_coarse": 5.0, "seconds_reading": 1.0, "newton_iterations": 5}
    seconds |= {"seconds_fixed": 0.1}
    its = {"linear_iterations_per_newton": [324] * 5, "linear_iterations_mean": 324.0}
    wall = [f"Wall{phase}" for phase in ("Read", "Partition", "Tags", "Fibres")]
    once = dict.fromkeys([*wall, "FETITear", "FETIPattern", "FETIGluing"], 0.5)
    return _case(layers, processes, "measure") | seconds | its | {"seconds_once": once}


def _counted(layers: int, processes: int) -> dict:
    """Return counts of which the busiest process's messages grow with the processes."""
    even = {name: {"mean": 10.0, "max": 10.0} for name in COUNTERS}
    grown = even | {"messages": {"mean": 10.0, "max": float(processes)}}
    found = {"setup": even, "iteration": grown, "neighbours": 6.0, "coarse_solves": 2.0}
    found |= {"neighbours_mean": 5.0, "messages_to_each": 2.2 if processes == 64 else 2.0}
    found |= {"coarse_entries": 1e6, "coarse_flops": 1e9, "reading": even}
    found |= {"reading_bytes": 1e6, "reading_mib": 10.0}
    return _case(layers, processes, "count") | found


def _coarse(processes: int, mean: float, most: float) -> dict:
    case = {"study": "scaling", "task": "coarse", "geometry": "cube", "type": "all_floating"}
    case |= {"choices": "paper", "subdomains": 2048 * processes, "processes": processes}
    found = {"subdomains_in_all": 2048 * processes, "coarse_size": 12_288 * processes}
    found |= {"coarse_solver": "clusters", "coarse_peak_mib": {"mean": mean, "max": most}}
    found |= {"machine": machine.describe(), "date": "2026-01-02T03:04:05+00:00"}
    return case | found
