# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The program of docs/usage.md, section by section, on fewer cells."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from collective import COMM, agree, small

import dolfinx

PAGE = (Path(__file__).parents[2] / "docs/usage.md").read_text(encoding="utf-8")


def programs(heading: str) -> list[str]:
    """Return the blocks of Python below a heading."""
    section = re.split(r"\n###? ", PAGE.partition(f" {heading}\n")[2])[0]
    return re.findall(r"^```python\n(.*?)^```", section, re.M | re.S)


def depth(u: dolfinx.fem.Function) -> float:
    """Return how far the beam sinks."""
    return COMM.allreduce(float(-u.x.array[2::3].min(initial=0.0)), op=max)


def test_usage():
    """A corner load sinks the beam further; a plane that holds it there changes nothing."""
    names: dict[str, Any] = {}
    (first,) = programs("A linear problem")
    exec(first.replace("10, 10, 10", "4, 4, 4"), names)
    sunk = depth(names["uh"])
    load, conditions, condensed = programs("Point loads, springs, null spaces")
    exec(load, names)
    agree(depth(names["uh"]) > 1.2 * sunk > 0.0, sunk)
    exec(conditions, names)
    small(depth(names["uh"]) / sunk - 1.0, 1e-6)
    exec(condensed, names)
    divergence = dolfinx.fem.form(names["ufl"].div(names["uh"]) * names["ufl"].dx)
    p = names["p"].x.array
    agree(np.all(np.isfinite(p)) and COMM.allreduce(np.abs(p).max(initial=0.0), op=max) > 0.1)
    small(COMM.allreduce(dolfinx.fem.assemble_scalar(divergence)), 1e-4)
