# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The sweep over numbers of subdomains, small."""

from __future__ import annotations

import json

import pytest
from collective import COMM, agree, small
from wall_files import on_first

from benchmarks.subdomains import run as subdomains

SMALL = ["--dofs", "300", "--per", "100,150", "--repeat", "1"]


@pytest.mark.parametrize("case", ["block", "cube1", "cube2", "square1", "heat1"])
def test_bodies(case):
    """Each has about so many dofs, and as many subdomains as were asked for."""
    records = subdomains.main(["--case", case, *SMALL])
    agree([record["per"] for record in records] == [100, 150])
    for record in records:
        agree(record["case"] == case and record["converged_reason"] > 0, record)
        agree(100 < record["dofs"] < 600 and record["processes"] == COMM.size, record)
        agree(record["subdomains"] == max(COMM.size, round(300 / record["per"])), record)
        agree(record["seconds_cpu"] > 0.0)
    ratios = [subdomains.ratio(record, records) for record in records]
    small(min(ratios) - 1.0, 0.0)


def test_walls():
    record = subdomains.main(["--case", "tube", "--dofs", "900", "--per", "450", "--repeat", "1"])[
        0
    ]
    agree(record["converged_reason"] > 0 and 500 < record["dofs"] < 1300, record)


def test_cases_in_the_file_are_not_run_again(tmp_path, monkeypatch):
    path = tmp_path / "subdomains.json"
    words = ["--case", "heat1", *SMALL, "--json", str(path)]
    records = subdomains.main(words)
    agree(on_first(lambda: json.loads(path.read_text())) == records)
    monkeypatch.setattr(subdomains, "run", None)
    agree(subdomains.main(words) == records)


@pytest.mark.serial
def test_wrong_case(capsys):
    with pytest.raises(SystemExit):
        subdomains.main(["--case", "sphere"])
    assert "'sphere' is none of: tube, vessel" in capsys.readouterr().err
