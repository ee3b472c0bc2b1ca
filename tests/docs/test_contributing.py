# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The example in CONTRIBUTING.md, on as many processes as there are."""

from __future__ import annotations

import re
from pathlib import Path

from collective import agree

PAGE = Path(__file__).parents[2] / "CONTRIBUTING.md"


def test_the_example_passes():
    (source,) = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    names: dict[str, object] = {}
    exec(compile(source, str(PAGE), "exec"), names)
    tests = [value for name, value in names.items() if name.startswith("test_")]
    agree(len(tests) == 1)
    tests[0]()
