# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""`scripts/run-tests` with a played `mpirun` and `pytest`."""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path

import pytest
from fake_machine import Machine

pytestmark = pytest.mark.serial

# Two processes; like the real one, it ends the first as soon as the second leaves with a failure.
MPIRUN = """
    [ "$1" != --version ] || exit 0
    shift 2
    "$@" & first=$!
    OMPI_COMM_WORLD_RANK=1 "$@" || { status=$?; kill $first; exit $status; }
    wait $first
    """
# The second waits for the first to speak; {patience} lets the first be the last to leave.
PYTEST = """
    if [ "$OMPI_COMM_WORLD_RANK" = 1 ]; then
        while ! grep -q said build/tests/np2.rank0.log; do sleep 0.02; done
        echo "said by 1"
        exit {second}
    fi
    echo "said by 0"
    sleep {patience}
    exit {first}
    """


@pytest.mark.parametrize(
    ("first", "second", "patience"),
    [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0.2), (0, 139, 1)],
    ids=["passed", "first", "both", "second", "crash"],
)
def test_a_failure_on_any_process_is_one(first: int, second: int, patience: float) -> None:
    with tempfile.TemporaryDirectory(prefix="dolfinx_feti-") as folder:
        machine = Machine.create(Path(folder).resolve())
        machine.play("mpirun", MPIRUN)
        machine.play("python3", PYTEST.format(first=first, second=second, patience=patience))
        result = machine.run("scripts/run-tests", DOLFINX_FETI_TEST_PROCESSES="2")
    failed = first != 0 or second != 0
    assert (result.returncode != 0) == failed
    assert f"np 2: {'FAILED' if failed else 'ok'}, said by 0" in result.stdout
    # The second speaks when the first has nothing to complain of.
    assert ("said by 1" in result.stdout) == (first == 0 and second != 0)


def test_kernels_of_a_killed_run_are_compiled_again() -> None:
    """A source without its mark of completion, unless another run may be at it."""
    with tempfile.TemporaryDirectory(prefix="dolfinx_feti-") as folder:
        machine = Machine.create(Path(folder).resolve())
        machine.play("python3", "echo passed")
        cache = Path(folder).resolve() / "fenics"
        cache.mkdir()
        for name, age in (("ready", 3600), ("killed", 3600), ("begun", 0)):
            source = cache / f"libffcx_{name}.c"
            source.touch()
            os.utime(source, (time.time() - age,) * 2)
        (cache / "libffcx_ready.c.cached").touch()
        result = machine.run(
            "scripts/run-tests", DOLFINX_FETI_TEST_PROCESSES="1", XDG_CACHE_HOME=folder
        )
        left = sorted(path.name for path in cache.glob("*.c"))
    assert result.returncode == 0
    assert left == ["libffcx_begun.c", "libffcx_ready.c"]
