# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""``import dolfinx_feti`` without what it needs: the commands that install it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.serial


@pytest.mark.parametrize(
    ("module", "raised"),
    [
        pytest.param("mpi4py", 'RuntimeError("cannot load MPI library")', id="no-MPI-library"),
        pytest.param("mpi4py", 'OSError("libmpi.so.12: cannot open")', id="broken-MPI-library"),
        pytest.param("petsc4py", 'ImportError("No module named petsc4py")', id="no-petsc4py"),
        pytest.param("dolfinx", 'ImportError("No module named dolfinx")', id="no-dolfinx"),
    ],
)
def test_import_names_what_to_install(tmp_path: Path, module: str, raised: str) -> None:
    """A stub in the place of a module raises what that module raises on such a machine.

    mpi4py's wheels raise RuntimeError where no MPI library can be loaded.
    """
    (tmp_path / f"{module}.py").write_text(f"raise {raised}\n")
    paths = [str(tmp_path), *sys.path]
    result = subprocess.run(
        [sys.executable, "-c", "import dolfinx_feti"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 1, f"exit status {result.returncode} for 1: {result.stderr}"
    last = result.stderr[result.stderr.rfind("\nImportError: ") :]
    cause = raised.split('"')[1]
    for text in ("needs dolfinx 0.9 to 0.11", cause, 'pip install ".[wheel]"'):
        assert text in last, f"{text!r} is not in the message: {result.stderr}"
