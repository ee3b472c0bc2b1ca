# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The comparison of FETI with MUMPS and GAMG, small."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from collective import COMM, agree, small
from wall_files import on_first

from benchmarks import compare

SMALL = ["--dofs", "900", "--subdomains", "4"]
KEYS = {
    "solver",
    "kappa",
    "dofs",
    "iterations",
    "seconds_setup",
    "seconds_solve",
    "peak_mib",
    "relative_residual",
    "difference_to_mumps",
}


def read(path: Path) -> list[dict[str, object]]:
    return on_first(lambda: json.loads(path.read_text()))


@pytest.fixture
def no_work(monkeypatch):
    """Whatever is wrong is found before there is a tube."""

    def refuse(*_args, **_options):
        raise AssertionError("a tube is made")

    monkeypatch.setattr(compare, "create_clamped_tube", refuse)


def test_all_solvers_solve_the_same_system(tmp_path, capfd):
    path = tmp_path / "new/compare.json"
    records = compare.main([*SMALL, "--kappa", "1000", "--json", str(path)])
    agree([record["solver"] for record in records] == ["feti", "mumps", "gamg"])
    feti, mumps, gamg = records
    for record in records:
        agree(record.keys() >= KEYS and record["converged_reason"] > 0, record)
        agree(record["kappa"] == 1000.0 and record["dofs"] == feti["dofs"] > 500)
        agree(record["processes"] == COMM.size)
        agree(record["seconds_setup"] > 0.0 and record["seconds_solve"] > 0.0)
        agree(record["peak_mib"] >= 0.0 or math.isnan(record["peak_mib"]), record)
        small(record["relative_residual"], 1e-8)
        small(record["difference_to_mumps"], 1e-6)
    agree(mumps["iterations"] == 1 and mumps["difference_to_mumps"] == 0.0)
    agree(10 < feti["iterations"] < gamg["iterations"], "κ is hard on GAMG")
    agree(read(path) == records)
    said = capfd.readouterr().out
    if COMM.rank > 0:
        ok = said == ""
    else:
        lines = [json.loads(line) for line in said.splitlines() if line.startswith("{")]
        ok = lines == records and "all_floating" in said
    agree(ok, said)


def test_several_sizes():
    """Two sizes, and not all solvers."""
    words = ["--dofs", "900,3000", "--subdomains", "4", "--solvers", "mumps,gamg"]
    records = compare.main(words)
    agree([record["solver"] for record in records] == ["mumps", "gamg"] * 2, records)
    agree(records[0]["dofs"] < records[2]["dofs"] and records[0]["subdomains"] == 4)
    small(max(record["difference_to_mumps"] for record in records), 1e-6)


def test_records_of_other_runs_are_kept(tmp_path):
    path = tmp_path / "compare.json"
    arguments = [*SMALL, "--solvers", "gamg", "--json", str(path)]
    records = [compare.main([*arguments, "--kappa", kappa])[0] for kappa in ("20", "10")]
    agree(read(path) == records and [record["kappa"] for record in records] == [20.0, 10.0])
    agree(all(record["difference_to_mumps"] is None for record in records))


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
        (["--solvers", "feti,pardiso"], "--solvers: 'pardiso' is none of: feti, mumps, gamg"),
        (["--solvers", ""], "argument --solvers: '' is none of: feti, mumps, gamg"),
        (["--kapa", "10"], "unrecognized arguments: --kapa"),
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
    with pytest.raises(AssertionError, match="a tube is made"):
        compare.main(["-tube_feti_type", "classical", "--dofs", "900", "-log_view"])
