# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Programs of this folder that a test starts on processes of their own."""

from __future__ import annotations

import os
import subprocess
import sys

from wall_files import ROOT

__all__ = ["finish", "start"]

#: What names the processes of a run to those that it starts.
LAUNCHERS = ("OMPI_", "PMIX_", "PRTE_", "PMI_")


def start(script: str, *words: object, processes: int = 1) -> subprocess.Popen[str]:
    """Start a script of this folder on some processes of its own."""
    own = {k: v for k, v in os.environ.items() if not k.startswith((*LAUNCHERS, "SCOTCH_"))}
    own |= {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    own |= {
        "OMPI_MCA_rmaps_base_oversubscribe": "1",
        "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    }
    own |= {"OMPI_MCA_mpi_yield_when_idle": "1"}
    launch = ["mpirun", "-n", str(processes)] if processes > 1 else []
    return subprocess.Popen(
        [*launch, sys.executable, str(ROOT / "tests/common" / script), *map(str, words)],
        cwd=ROOT,
        env=own,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def finish(process: subprocess.Popen[str], status: int = 0) -> str:
    """Wait for a program; return what it said."""
    try:
        said, _ = process.communicate(timeout=300)
    finally:
        process.kill()
    assert (process.returncode == 0) == (status == 0), said
    return said
