# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The decomposition is that of the mesh, the number and the seed, in every run."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
from bodies import block, yeoh
from collective import agree, equal
from problems import cube, poisson
from programs import finish, start

from dolfinx_feti import LinearProblem, NonlinearProblem
from dolfinx_feti.fem.decomposition import decompose
from dolfinx_feti.runtime.compat import SCOTCH, repeat_partitions


@pytest.mark.serial
@pytest.mark.parametrize("processes", [1, 2])
def test_two_runs_and_two_problems_of_one_run(tmp_path, processes):
    """Nothing in the environment helps; dolfinx distributes the cube alike, too."""
    files = [tmp_path / f"{i}.json" for i in range(2)]
    for file in files:
        finish(start("decomposition_run.py", file, processes=processes))
    first, second = (json.loads(file.read_text()) for file in files)
    assert first == second
    for same, again, other in first:
        assert same == again == first[0][0]
        assert len({(process, part) for _, process, part in same}) == 12
        assert {process for _, process, _ in same} == set(range(processes))
        assert other != same


def test_seed_of_a_problem():
    """It takes other subdomains to the same solution; both classes hand it on."""
    body = block(yeoh, (0.3, 0.1))
    nonlinear = NonlinearProblem(body.energy, body.u, body.bcs, subdomains=5, seed=2)
    expected = decompose(body.u.function_space.mesh, 5, seed=2).subdomain
    equal(nonlinear.decomposition.subdomain, expected)
    problem = poisson(cube(3, 6))
    solved = {
        seed: LinearProblem(problem.a, problem.L, problem.bcs, subdomains=8, seed=seed)
        for seed in (0, 1)
    }
    for seed, linear in solved.items():
        linear.solve()
        expected = decompose(problem.V.mesh, 8, seed=seed).subdomain
        equal(linear.decomposition.subdomain, expected)
    zero, one = (linear.decomposition.subdomain for linear in solved.values())
    changed = problem.V.mesh.comm.allreduce(int(np.count_nonzero(zero != one)))
    agree(changed > 0)
    equal(solved[1].u.x.array, solved[0].u.x.array, 1e-6)


@pytest.mark.serial
def test_environment_has_the_last_word(monkeypatch):
    one, other = SCOTCH
    monkeypatch.setenv(one, "4")
    monkeypatch.delenv(other)
    repeat_partitions()
    assert (os.environ[one], os.environ[other]) == ("4", "1")
