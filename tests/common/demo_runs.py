# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What tests of demos share: where they are, what they leave behind, and what they refuse."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from collective import COMM, agree
from wall_files import ROOT, on_first

DEMOS = ROOT / "demos"
EXAMPLE = ROOT / "meshes/example.msh"


def read_summary(folder: Path) -> dict[str, Any]:
    return on_first(lambda: json.loads((folder / "summary.json").read_text()))


def refused(run, capsys, match: str, *arguments: object) -> None:
    """The demo ends on all processes with status 2, and one line on the first."""
    capsys.readouterr()
    status = None
    try:
        run("demo_artery.py", *arguments)
    except SystemExit as end:
        status = end.code
    agree(status == 2, status)
    said = capsys.readouterr().err.splitlines()
    if COMM.rank == 0:
        ok = len(said) == 1 and re.search(f"^demo_artery.py: error: .*{match}", said[0])
    else:
        ok = not said
    agree(ok, said)
