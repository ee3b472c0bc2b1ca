# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A beam of heart muscle that bends, problem 1 of Land et al. (2015), on a coarse mesh.

Published are 4.0 to 4.2 mm. P2–P0 is of first order there: docs/beam.md has finer ones.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from collective import COMM, agree, small
from walls import beam

from dolfinx_feti.loading import Steps, follow_load

PAGE = Path(__file__).parents[2] / "docs/beam.md"
ACROSS, LOAD = 2, 0.004


@pytest.mark.serial
def test_end_of_the_beam():
    """The z [mm] of P2–P0 on the page, by the number of dofs."""
    body = beam(kappa=1000.0, cells=(10 * ACROSS, ACROSS, ACROSS))
    u, V = body.u, body.u.function_space

    def set_load(value: float) -> None:
        body.load.value = value

    steps = Steps(first=LOAD / 4, least=LOAD / 64)
    follow_load(body.problem(8), set_load, [LOAD], steps, state=[u, body.p])
    here = np.linalg.norm(V.tabulate_dof_coordinates() - [10.0, 0.5, 1.0], axis=1) < 1e-9
    z = 1.0 + COMM.allreduce(u.x.array.reshape(-1, 3)[here, 2].max(initial=0.0), op=max)
    dofs = 3 * V.dofmap.index_map.size_global
    rows = re.findall(r"^\| \d \| ([\d ]+) \| (4\.\d+) \|", PAGE.read_text(encoding="utf-8"), re.M)
    documented = {int(number.replace(" ", "")): float(z) for number, z in rows}
    agree(dofs in documented, documented)
    small(z - documented[dofs], 1e-3)
