# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The table of solvers in the documentation is that of the code."""

from __future__ import annotations

import pytest
from wall_files import ROOT

from dolfinx_feti.comparison import SETTINGS, Settings

pytestmark = pytest.mark.serial

MATRICES = {
    "torn": "torn",
    "direct": "assembled",
    "krylov": "assembled",
    "split": "before p is condensed",
}


def row(name: str, settings: Settings) -> str:
    """A row of the table, with the options that are not PETSc's defaults."""
    options = ", ".join(
        f"`{option} {str(value).lower() if isinstance(value, bool) else value}`"
        for option, value in settings.options.items()
    )
    return f"| `{name}` | {MATRICES[settings.family]} | {settings.method} | {options} |"


def test_table_of_the_documentation():
    page = (ROOT / "docs/comparing.md").read_text(encoding="utf-8")
    rows = [row(name, settings) for name, settings in SETTINGS.items()]
    assert "\n".join(rows) in page, "docs/comparing.md needs\n" + "\n".join(rows)
