# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What the Makefile's targets run, on a played machine with some number of cores."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.serial

#: Like the real one, it takes what OpenMP's variables say for the number of cores.
NPROC = """#!/bin/sh
n={cores}
[ -z "$OMP_NUM_THREADS" ] || n=$OMP_NUM_THREADS
[ -z "$OMP_THREAD_LIMIT" ] || [ "$n" -le "$OMP_THREAD_LIMIT" ] || n=$OMP_THREAD_LIMIT
echo "$n"
"""


def commands(folder: Path, target: str, cores: int, **variables: str) -> str:
    """Return what ``make -n`` says about a target."""
    nproc = folder / "nproc"
    nproc.write_text(NPROC.format(cores=cores))
    nproc.chmod(0o755)
    environment = {"PATH": f"{folder}:{os.environ['PATH']}", **variables}
    command = ["make", "-n", "-C", str(ROOT), target]
    return subprocess.run(
        command, env=environment, check=True, capture_output=True, text=True
    ).stdout


@pytest.mark.parametrize(
    "variables", [{}, {"OMP_NUM_THREADS": "1"}, {"OMP_THREAD_LIMIT": "1"}], ids=str
)
def test_demo_takes_both_cores(tmp_path, variables):
    """However many threads OpenMP may start: each process is to have one of them."""
    assert "OMP_NUM_THREADS=1 mpirun -n 2 python3 demos/" in commands(
        tmp_path, "demo", 2, **variables
    )


def test_demo_on_a_single_core(tmp_path):
    assert "mpirun" not in commands(tmp_path, "demo", 1)


def test_hooks_before_a_commit_are_the_tools_of_make_lint(tmp_path):
    """The same commands in the same order, and the same shell scripts."""
    linted = re.findall(r"^scripts/with-fenicsx .*$", commands(tmp_path, "lint", 2), re.M)
    config = (ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8")
    hooks = re.findall(r"^ +entry: (.*)$", config, re.M)
    assert [" ".join(line.split()[: len(hook.split())]) for line, hook in
            zip(linted, hooks, strict=True)] == hooks  # fmt: skip
    *_, scripts = re.findall(r"^ +files: (.*)$", config, re.M)
    named = linted[-1].split()[2:]
    assert len(named) >= 3
    assert all(re.search(scripts, name) for name in named)
    every = [path.relative_to(ROOT) for path in [*ROOT.glob("scripts/*"), ROOT / ".ci/run"]]
    assert {str(path) for path in every if re.search(scripts, str(path))} == set(named)


def test_identities_exist(tmp_path):
    """What ``make check`` names is there, on both numbers of processes."""
    runs = re.findall(
        r"PROCESSES=. python3 scripts/run_tests.py (.*)$", commands(tmp_path, "check", 2), re.M
    )
    assert len(runs) == 2
    assert all((ROOT / name).exists() for run in runs for name in run.split())
