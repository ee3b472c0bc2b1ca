# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The studies, their commands, and what their records took."""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator
from pathlib import Path

__all__ = ["main", "studies"]

HERE = Path(__file__).parent
RESULTS = HERE.parent / "docs/results"

#: Files of records that are not called as the study.
RECORDS = {"compare": "speed", "cube": "linear", "load_stepping": "loading"}


def studies() -> Iterator[tuple[str, str, str]]:
    """Yield the name of each study, what it measures, and what its records took."""
    for run in sorted(HERE.glob("*/run.py")):
        name = run.parent.name
        about = ast.get_docstring(ast.parse(run.read_text(encoding="utf-8"))) or ""
        yield name, about.split("\n")[0], _took(RESULTS / f"{RECORDS.get(name, name)}.json")


def _took(path: Path) -> str:
    """Say how many cases a file holds, and the sum of their seconds as far as they are there."""
    records = json.loads(path.read_text(encoding="utf-8"))
    seconds = sum(
        value
        for record in records
        for name, value in record.items()
        if name in {"seconds", "seconds_setup", "seconds_solve", "seconds_end_to_end"}
        and isinstance(value, int | float)
    )
    return f"{len(records)} cases" + (f", at least {seconds / 60:.0f} min" if seconds else "")


def main() -> None:
    """Print the list."""
    for name, about, took in studies():
        print(f"python3 -m benchmarks.{name:14s} {about} ({took})")
