# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Programs that are printed on pages of the documentation."""

from __future__ import annotations

import re

from wall_files import ROOT


def programs(heading: str = "", page: str = "docs/usage.md") -> list[str]:
    """Return the blocks of Python of a page, or below a heading."""
    text = (ROOT / page).read_text(encoding="utf-8")
    if heading:
        text = re.split(r"\n###? ", text.partition(f"# {heading}\n")[2])[0]
    return re.findall(r"^```python\n(.*?)^```", text, re.M | re.S)
