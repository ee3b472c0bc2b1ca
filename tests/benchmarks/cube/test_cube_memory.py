# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The estimate of the memory of a case, and cases that are refused."""

from __future__ import annotations

import pytest
from collective import COMM, agree, raises
from linear_study import SMALL

from benchmarks.cube import memory
from benchmarks.cube.case import Case


@pytest.mark.serial
def test_kinds_of_subdomains_are_all_of_them():
    for edge in (1, 2, 3, 8):
        for floating in (False, True):
            kinds = memory._kinds(edge, floating)
            agree(sum(kinds.values()) == edge**3)
    agree(memory._kinds(8, False) == {(0, 0, 0): 216, (0, 0, 1): 216, (0, 1, 1): 72,
                                           (1, 1, 1): 8})  # fmt: skip
    agree(memory._kinds(1, False) == {(2, 2, 2): 1})


def estimated(**changes: object) -> memory.Estimate:
    case = {"degree": 1, "cells": 2, "subdomains": 3, "all_floating": True, "processes": 1}
    case |= {"pc_type": "lumped", "coarse_q": "identity", "interior": "keep"}
    return memory.estimate(**(case | changes))


@pytest.mark.serial
def test_estimate_follows_what_a_case_needs():
    usual = estimated()
    for more in ({"degree": 2}, {"cells": 4}, {"subdomains": 4}, {"pc_type": "dirichlet"}):
        agree(estimated(**more).mib > usual.mib, more)
        agree(estimated(**more).streamed > usual.streamed, more)
    agree(estimated(all_floating=False).mib < usual.mib < estimated(coarse_q="preconditioner").mib)
    agree(estimated(processes=2).mib - usual.mib > 100.0)
    n = 3 * 71  # dofs of a subdomain, and six columns of the border
    least, most = (27 * 2 * 8.0 * entries for entries in (n + 6 * n, (n + 6) ** 2))
    agree(least < usual.streamed < most, (least, usual.streamed, most))


def test_estimate_decides_on_the_interior_as_the_solver_does(study_of):
    for level in ("1", "2", "3"):
        _, records = study_of(*SMALL, "--level", level)
        names = {"cells": 2 ** (int(level) - 1), "subdomains": 2, "pc_type": "dirichlet"}
        chosen = "eliminate" if records[-1]["interior_is"] == "eliminated" else "keep"
        auto = estimated(**names, interior="auto")
        agree(auto == estimated(**names, interior=chosen), level)


def test_case_that_does_not_fit_is_refused(study_of, capsys):
    status, records = study_of(*SMALL, "--level", "2", "--memory", "50")
    said = COMM.bcast(capsys.readouterr().err)
    agree(status == 1 and len(records) == 1)
    agree(records[0]["available_mib"] == 50.0 < records[0]["estimated_mib"], records)
    agree("refused: P1, level 2, 2³ subdomains" in said and "needs about 0." in said, said)
    agree("GiB, and 0.0 GiB are available: choose a lower --level" in said, said)
    status, records = study_of(*SMALL, "--level", "2")
    agree(status == 0 and len(records) == 1 and "available_mib" not in records[0])
    enough = 150.0 + COMM.size * memory.PROCESS / 2**20
    status, records = study_of(*SMALL, "--level", "2,4", "--memory", enough)
    agree(status == 1)  # and the other case is run
    agree([(r["level"], "iterations" in r) for r in records] == [(2, True), (4, False)])


def test_estimate_that_fails_ends_all_processes(study_of, monkeypatch):
    """The first process alone makes it."""

    def fail(*_args: object) -> None:
        raise MemoryError("no room for the estimate")

    monkeypatch.setattr(Case, "estimate", fail)
    with raises(MemoryError, "no room for the estimate"):
        study_of(*SMALL)
