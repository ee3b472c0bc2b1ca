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
from land_beam import beam

import ufl

from dolfinx_feti import NonlinearProblem, kinematics, materials
from dolfinx_feti.loading import Steps, follow_load

PAGE = Path(__file__).parents[2] / "docs/beam.md"
ACROSS, KAPPA, LOAD = 2, 1000.0, 0.004
LAND = {"c": 2.0, "b_f": 8.0, "b_t": 2.0, "b_fs": 4.0}


def documented() -> dict[str, float]:
    """Return z [mm] by the number of dofs, of P2–P0."""
    rows = re.findall(r"^\| \d \| ([\d ]+) \| (4\.\d+) \|", PAGE.read_text(encoding="utf-8"), re.M)
    return {dofs.replace(" ", ""): float(z) for dofs, z in rows}


@pytest.mark.serial
def test_end_of_the_beam():
    """With the package's material; the helper's own is written entry by entry."""
    by_hand = beam(kappa=KAPPA, cells=(10 * ACROSS, ACROSS, ACROSS))
    u, p, load = by_hand.u, by_hand.p, by_hand.load
    F = kinematics.deformation_gradient(u)
    C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
    psi = materials.guccione(C, ufl.as_vector([1.0, 0.0, 0.0]), **LAND, J=J)
    energy = (psi + materials.perturbed_lagrangian(J, p, KAPPA)) * ufl.dx
    v, q = ufl.TestFunction(u.function_space), ufl.TestFunction(p.function_space)
    pressure = by_hand.F_u - ufl.derivative(by_hand.energy, u, v)
    problem = NonlinearProblem(
        [ufl.derivative(energy, u, v) + pressure, ufl.derivative(energy, p, q)],
        u,
        bcs=by_hand.bcs,
        condense=p,
        quadrature_degree=4,
    )
    follow_load(
        problem,
        lambda value: setattr(load, "value", value),
        [LOAD],
        Steps(first=LOAD / 4, least=LOAD / 64),
        state=[u, p],
    )
    V = u.function_space
    here = np.linalg.norm(V.tabulate_dof_coordinates() - [10.0, 0.5, 1.0], axis=1) < 1e-9
    z = 1.0 + COMM.allreduce(u.x.array.reshape(-1, 3)[here, 2].max(initial=0.0), op=max)
    dofs = str(3 * V.dofmap.index_map.size_global)
    agree(dofs in documented(), documented())
    small(z - documented()[dofs], 1e-3)
