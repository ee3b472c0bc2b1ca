# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Programs of docs/usage.md and docs/elements.md, on fewer cells."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from collective import COMM, agree, small

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti.fem.elements import quadratic_with_bubbles

DOCS = Path(__file__).parents[2] / "docs"


def programs(heading: str, page: str = "usage") -> list[str]:
    """Return the blocks of Python below a heading."""
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    section = re.split(r"\n###? ", text.partition(f" {heading}\n")[2])[0]
    return re.findall(r"^```python\n(.*?)^```", section, re.M | re.S)


def depth(x: np.ndarray) -> float:
    """Return how far the beam sinks."""
    return COMM.allreduce(float(-x[2::3].min(initial=0.0)), op=max)


def test_point_load():
    """A corner load sinks the beam further."""
    names: dict[str, Any] = {}
    (first,) = programs("A linear problem")
    exec(first.replace("10, 10, 10", "4, 4, 4"), names)
    sunk = depth(names["uh"].x.array)
    (load,) = programs("Point loads, springs, null spaces")
    exec(load, names)
    agree(depth(names["problem"].x.array_r) > 1.2 * sunk > 0.0, sunk)
    load = names["b"].array_r.reshape(-1, 3)[:, 2]
    agree(COMM.allreduce(float(load.min(initial=0.0)), op=min) < -0.5, "added once")
    small(COMM.allreduce(float(load.sum())) + 1.5, 0.3)


def test_condensed_linear_problem():
    """The pressure is κ div u, projected."""
    (code,) = programs("Linear elasticity", "elements")
    mesh = dolfinx.mesh.create_unit_cube(COMM, 2, 2, 2)
    element = basix.ufl.blocked_element(quadratic_with_bubbles("tetrahedron"), shape=(3,))
    names = {
        "tetrahedra": mesh,
        "V": dolfinx.fem.functionspace(mesh, element),
        "Q": dolfinx.fem.functionspace(mesh, ("DG", 1)),
        **{"dolfinx": dolfinx, "ufl": ufl, "np": np},
    }
    exec(code, names)
    p, uh = names["p"], names["uh"]
    given, found = (
        COMM.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(f * p * ufl.dx)))
        for f in (1e4 * ufl.div(uh), p)
    )
    agree(found > 1e-3, found)
    small(given / found - 1.0, 1e-5)
