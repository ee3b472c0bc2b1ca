# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The benchmark of the load stepping: its records, its points, its figures, what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from collective import COMM, agree, equal
from wall_files import on_first

from benchmarks.load_stepping import page as load_figures
from benchmarks.load_stepping import run as load_stepping

pytest.importorskip("gmsh")
pytest.importorskip("matplotlib")

SMALL = "--geometry tube --size 1 --degree 2 --pressure 8 --first 5 --subdomains 4".split()


def run(tmp_path: Path, *words: str) -> list[dict[str, object]]:
    """Run the benchmark; return all records in its file."""
    place = ["--json", str(tmp_path / "loading.json"), "--folder", str(tmp_path / "walls")]
    agree(load_stepping.main([*SMALL, *place, *words]) == 0)
    return on_first(lambda: json.loads((tmp_path / "loading.json").read_text()))


def test_both_variants_and_their_figures(tmp_path):
    records = run(tmp_path)
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

    on_first(lambda: load_figures.main([str(tmp_path / "loading.json"), "--output", str(tmp_path)]))
    page = on_first(lambda: (tmp_path / "loading.md").read_text())
    row = f"| tube | 1 | P2–P0 | 4 | all-floating | {COMM.size} | 8 |"
    agree(row in page and "loading_tube_1_p2.png" in page, page)
    agree(on_first(lambda: (tmp_path / "loading_tube_1_p2.png").stat().st_size) > 20_000)


@pytest.mark.serial
def test_direct_run_alone_has_no_picture(tmp_path):
    """There are no iterations to draw; its load steps are in the table."""
    run(tmp_path, "--type", "classical")
    run(tmp_path, "--type", "classical", "--degree", "1", "--subdomains", "1")
    on_first(lambda: load_figures.main([str(tmp_path / "loading.json"), "--output", str(tmp_path)]))
    names = on_first(lambda: sorted(path.name for path in tmp_path.glob("*.png")))
    agree(names == ["loading_tube_1_p2.png"], names)
    page = on_first(lambda: (tmp_path / "loading.md").read_text())
    agree("| P1–P0 | 1 | one subdomain, direct |" in page, page)


@pytest.mark.serial
def test_seconds_of_a_suspended_run_are_left_out(tmp_path):
    """A load step without them is drawn as a gap."""
    run(tmp_path, "--type", "classical")
    path = tmp_path / "loading.json"
    records = json.loads(path.read_text())
    path.write_text(json.dumps([records[0] | {"seconds": None}, *records[1:]]))
    load_figures.main([str(path), "--output", str(tmp_path)])
    (row,) = (line for line in (tmp_path / "loading.md").read_text().splitlines() if "e-0" in line)
    assert row.endswith("| – |")


@pytest.mark.serial
def test_what_is_there_is_not_run_again(tmp_path, capsys):
    first = run(tmp_path, "--type", "classical")
    capsys.readouterr()
    agree(run(tmp_path, "--type", "classical") == first)
    said = COMM.bcast(capsys.readouterr().out)
    agree("is in the records already" in said and "Newton" not in said, said)


def test_run_goes_on_from_its_checkpoint(tmp_path, capsys):
    """Steps are counted from rest; to begin anew needs another folder."""
    words = ["--type", "classical", "--checkpoint", str(tmp_path / "kept")]
    first = run(tmp_path, *words, "--pressure", "5")
    whole_way = run(tmp_path, *words, "--pressure", "8", "--subdomains", "3")
    loads = [record["pressure_mmhg"] for record in whole_way]
    agree(whole_way[: len(first)] == first and loads == sorted(set(loads)) and loads[-1] == 8.0)
    agree([record["steps"] for record in whole_way] == list(range(1, len(loads) + 1)))
    capsys.readouterr()
    with pytest.raises(SystemExit):
        load_stepping.main([*SMALL, *words, "--again", "--folder", str(tmp_path / "walls")])
    said = COMM.bcast(capsys.readouterr().err)
    agree("--again begins anew" in said, said)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--pressure", "nan"], "not a positive number"),
        (["--type", "floating"], "none of"),
        (["--subdomains", "0"], "not a number 1"),
        (["--degree", "3"], "none of"),
        (["--json", "/dev/null/x.json"], "cannot be used"),
        (["--colour", "red"], "unrecognized arguments"),
    ],
)
def test_bad_words(words, said, capsys):
    with pytest.raises(SystemExit) as caught:
        load_stepping.main(words)
    agree(caught.value.code == 2)
    text = COMM.bcast(capsys.readouterr().err)
    agree(said in text, text)
