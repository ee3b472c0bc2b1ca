# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A beam of heart muscle that bends, problem 1 of Land et al. (2015), on a coarse mesh.

Published are 4.0 to 4.2 mm. P2–P0 is of first order there: docs/compressibility.md has finer ones.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from collective import COMM, agree, small

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, loads, materials
from dolfinx_feti.loading import Steps, follow_load

PAGE = Path(__file__).parents[2] / "docs/compressibility.md"
ACROSS, KAPPA, LOAD = 2, 1000.0, 0.004


def documented() -> dict[str, float]:
    """Return z [mm] by the number of dofs, of P2–P0."""
    rows = re.findall(r"^\| \d \| ([\d ]+) \| (4\.\d+) \|", PAGE.read_text(encoding="utf-8"), re.M)
    return {dofs.replace(" ", ""): float(z) for dofs, z in rows}


def test_end_of_the_beam():
    size = [np.zeros(3), np.array([10.0, 1.0, 1.0])]
    mesh = dolfinx.mesh.create_box(COMM, size, (10 * ACROSS, ACROSS, ACROSS))
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    Q = dolfinx.fem.functionspace(mesh, ("DG", 0))
    u, p = dolfinx.fem.Function(V), dolfinx.fem.Function(Q)
    v, q, du = ufl.TestFunction(V), ufl.TestFunction(Q), ufl.TrialFunction(V)
    end, below = (
        np.sort(dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x, k=k: np.isclose(x[k], 0)))
        for k in (0, 2)
    )
    bc = dolfinx.fem.dirichletbc(np.zeros(3), dolfinx.fem.locate_dofs_topological(V, 2, end), V)
    tags = dolfinx.mesh.meshtags(mesh, 2, below, np.ones_like(below))
    ds = ufl.Measure("ds", mesh, subdomain_data=tags)(1)
    F = kinematics.deformation_gradient(u)
    C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
    fibre = ufl.as_vector([1.0, 0.0, 0.0])
    psi = materials.guccione(C, fibre, c=2.0, b_f=8.0, b_t=2.0, b_fs=4.0, J=J)
    energy = (psi + materials.perturbed_lagrangian(J, p, kappa=KAPPA)) * ufl.dx
    load = dolfinx.fem.Constant(mesh, 0.0)
    inside = ufl.derivative(energy, u, v)
    problem = NonlinearProblem(
        [inside + loads.follower_pressure(load, u, v, ds), ufl.derivative(energy, p, q)],
        u,
        bcs=[bc],
        J=ufl.derivative(inside, u, du)
        + loads.follower_pressure_tangent(load, u, v, du, ds, "full"),
        condense=p,
        quadrature_degree=4,
    )
    follow_load(
        problem,
        lambda pressure: setattr(load, "value", pressure),
        [LOAD],
        Steps(first=LOAD / 4, least=LOAD / 64),
        state=[u, p],
    )
    x = V.tabulate_dof_coordinates()
    here = np.linalg.norm(x - np.array([10.0, 0.5, 1.0]), axis=1) < 1e-9
    z = 1.0 + COMM.allreduce(u.x.array.reshape(-1, 3)[here, 2].max(initial=0.0), op=max)
    dofs = 3 * V.dofmap.index_map.size_global
    agree(str(dofs) in documented(), documented())
    small(z - documented()[str(dofs)], 1e-3)
