# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""`scripts/run_tests.py` on small suites, and the commands of the Makefile's targets."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from wall_files import ROOT

pytestmark = pytest.mark.serial

HEAD = """
import os, time
from mpi4py import MPI
import pytest
comm = MPI.COMM_WORLD
"""


def run(folder: Path, suite: str, np: int = 2, **variables: str) -> subprocess.CompletedProcess:
    """Run a suite in a separate checkout, without the MPI environment of this test."""
    (folder / "scripts").mkdir()
    (folder / "tests").mkdir()
    script = shutil.copy(ROOT / "scripts/run_tests.py", folder / "scripts")
    (folder / "tests/test_suite.py").write_text(HEAD + suite)
    around = ("OMPI_M", "OMPI_C", "PMI", "PRTE_", "PYTEST", "MPI")
    own = {key: value for key, value in os.environ.items() if not key.startswith(around)}
    own |= {"DOLFINX_FETI_TEST_PROCESSES": str(np), **variables}
    own |= {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    command = [sys.executable, script, "tests/test_suite.py"]
    return subprocess.run(command, env=own, capture_output=True, text=True, timeout=120)


#: Suites on two processes: patience, lines of the output, and whether they pass.
SUITES = {
    "passing": (
        "def test_one(): comm.Barrier()\ndef test_two(): pytest.skip('no')",
        {},
        ["np 2: 1 passed, 0 failed, 1 skipped in"],
        True,
    ),
    "a failure on all does not keep the others from running": (
        "def test_one(): assert comm.size == 3\ndef test_two(): comm.Barrier()",
        {},
        ["assert 2 == 3", "np 2: 1 passed, 1 failed, 0 skipped in"],
        False,
    ),
    "a failure on one for which the other waits": (
        "def test_one():\n    assert comm.rank == 0\n    comm.Barrier()",
        {"DOLFINX_FETI_TEST_GRACE": "1"},
        ["assert 1 == 0", "stopped: other processes are still in tests/test_suite.py::test_one"],
        False,
    ),
    "a failure on one alone": (
        "def test_one(): assert comm.rank == 0\ndef test_two(): pass",
        {},
        ["assert 1 == 0", "np 2: 2 passed, 1 failed, 0 skipped in"],
        False,
    ),
    "a hang": (
        "def test_one():\n    if comm.rank: comm.recv(source=0)",
        {"DOLFINX_FETI_TEST_PATIENCE": "4"},
        ["stopped: no test has finished for 4 s"],
        False,
    ),
    "slow, with progress": (
        "@pytest.mark.parametrize('i', range(5))\ndef test_one(i): time.sleep(1.5)",
        {"DOLFINX_FETI_TEST_PATIENCE": "5"},
        ["np 2: 5 passed, 0 failed, 0 skipped in"],
        True,
    ),
    "a crash": (
        "def test_one():\n    if comm.rank: os.abort()\n    comm.Barrier()",
        {},
        ["error: pytest or mpirun ended with status"],
        False,
    ),
    "no import": (
        "import nothing_of_this_name",
        {},
        ["No module named 'nothing_of_this_name'"],
        False,
    ),
}


@pytest.mark.parametrize("name", SUITES)
def test_suite(tmp_path, name):
    """What is shown as it happens, the table at the end, and the exit status."""
    suite, variables, lines, passes = SUITES[name]
    result = run(tmp_path, suite, **variables)
    assert result.stderr == ""
    for line in lines:
        assert line in result.stdout, result.stdout
    assert result.returncode == (0 if passes else 1)
    assert result.stdout.splitlines()[-1].split()[:2] == ["2", "ok" if passes else "FAILED"]


def test_all_numbers_of_processes_are_tried_after_a_failure(tmp_path):
    suite = "def test_one(): assert comm.size == 2"
    result = run(tmp_path, suite, DOLFINX_FETI_TEST_PROCESSES="1 2")
    assert result.returncode == 1
    table = [line.split()[:4] for line in result.stdout.splitlines()[-2:]]
    assert table == [["1", "FAILED", "0", "1"], ["2", "ok", "1", "0"]]


def test_kernels_of_a_killed_run_are_compiled_again(tmp_path):
    """A source without its mark of completion, unless another run may be at it."""
    cache = tmp_path / "fenics"
    cache.mkdir()
    for name, age in (("ready", 3600), ("killed", 3600), ("begun", 0)):
        source = cache / f"libffcx_{name}.c"
        source.touch()
        os.utime(source, (time.time() - age,) * 2)
    (cache / "libffcx_ready.c.cached").touch()
    suite = "def test_one(): pass"
    assert run(tmp_path, suite, np=1, XDG_CACHE_HOME=str(tmp_path)).returncode == 0
    left = sorted(path.name for path in cache.glob("*.c"))
    assert left == ["libffcx_begun.c", "libffcx_ready.c"]


# -- the Makefile, on a machine with some number of cores

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
    return subprocess.check_output(command, env=environment, text=True)


@pytest.mark.parametrize("variables", [{}, {"OMP_NUM_THREADS": "1"}, {"OMP_THREAD_LIMIT": "1"}])
def test_demo_takes_all_cores(tmp_path, variables):
    """However many threads OpenMP may start: each process is to have one of them."""
    two = "OMP_NUM_THREADS=1 mpirun -n 2 python3 demos/"
    assert two in commands(tmp_path, "demo", 2, **variables)
    assert "mpirun" not in commands(tmp_path, "demo", 1, **variables)


def test_hooks_before_a_commit_are_the_tools_of_make_lint(tmp_path):
    """The same commands in the same order, and the same shell scripts."""
    linted = re.findall(r"^scripts/with-fenicsx .*$", commands(tmp_path, "lint", 2), re.M)
    config = (ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8")
    hooks = re.findall(r"^ +entry: (.*)$", config, re.M)
    assert [
        " ".join(line.split()[: len(hook.split())])
        for line, hook in zip(linted, hooks, strict=True)
    ] == hooks
    *_, scripts = re.findall(r"^ +files: (.*)$", config, re.M)
    named = linted[-1].split()[2:]
    assert len(named) >= 3
    assert [name for name in named if not re.search(scripts, name)] == []
    every = [path.relative_to(ROOT) for path in [*ROOT.glob("scripts/*"), ROOT / ".ci/run"]]
    assert {str(path) for path in every if re.search(scripts, str(path))} == set(named)


def test_identities_exist(tmp_path):
    """What ``make check`` names is there, on both numbers of processes."""
    said = commands(tmp_path, "check", 2)
    runs = re.findall(r"PROCESSES=. python3 scripts/run_tests.py (.*)$", said, re.M)
    assert len(runs) == 2
    named = [name for run in runs for name in run.split()]
    assert [name for name in named if not (ROOT / name).exists()] == []
