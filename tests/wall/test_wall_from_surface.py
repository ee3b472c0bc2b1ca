# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A wall of one layer, grown on an STL surface, supported or pulled, is in equilibrium."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, small
from mesh_files import pipe, write_stl
from wall_files import balanced, on_first

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, materials
from dolfinx_feti.wall import (
    Clamp,
    Dashpot,
    Pressure,
    Slide,
    Spring,
    apply_conditions,
    area,
    read_wall,
)
from meshes.vessel import create_vessel

KAPPA, PRESSURE = 30.0, 0.4  # kPa
SPRINGS = {
    "lumen": Pressure(),
    "outer": [Spring(0.2, "all"), Dashpot(0.5)],
    "opening_1": Spring(2.0),
    "opening_2": Spring(2.0),
}


@pytest.fixture(scope="module")
def wall(tmp_path_factory):
    """A bent pipe of one layer, ends in the planes z = 0 and z = 10."""
    path = tmp_path_factory.mktemp("surface") / "wall.msh"

    def make():
        x, t = pipe(n=12, m=6)
        x[:, 0] += 0.03 * x[:, 2] ** 2
        stl = write_stl(path.with_suffix(".stl"), x, t, binary=True)
        return create_vessel(path, surface=stl, size=2.0, thickness=1.5, layers={"wall": 1.0})

    quality = on_first(make)
    agree(quality.minimum >= 0.1 and quality.cells < 1500, quality)
    return read_wall(on_first(lambda: path), COMM)


def forms(wall, conditions, axis=None, degree=1):
    """The displacement, its forms with the conditions, and of P2 the pressure with its equation."""
    u = dolfinx.fem.Function(dolfinx.fem.functionspace(wall.mesh, ("Lagrange", degree, (3,))))
    p = dolfinx.fem.Function(dolfinx.fem.functionspace(wall.mesh, ("DG", 0)))
    boundary = apply_conditions(wall, u, conditions, axis=axis)
    F = kinematics.deformation_gradient(u)
    C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
    psi = materials.neo_hookean(C, c=3.0, J=J)
    mixed = materials.perturbed_lagrangian(J, p, kappa=KAPPA)
    psi += mixed if degree == 2 else materials.volumetric(J, KAPPA)
    v, du = ufl.TestFunction(u.function_space), ufl.TrialFunction(u.function_space)
    dx = ufl.dx(metadata={"quadrature_degree": 2 * degree})
    residual = ufl.derivative(psi * dx, u, v)
    tangent = ufl.derivative(residual, u, du)
    condensed = {p: ufl.derivative(psi * dx, p)} if degree == 2 else {}
    return u, boundary, residual + boundary.residual, tangent + boundary.tangent, condensed


def feti(u, boundary, residual, tangent, condensed, kind):
    problem = NonlinearProblem(
        [residual, *condensed.values()] if condensed else residual,
        u,
        condense=list(condensed) or None,
        bcs=boundary.bcs,
        J=tangent,
        subdomains=6,
        petsc_options_prefix="from_surface_",
        petsc_options={"feti_type": kind, "snes_rtol": 1e-10, "snes_atol": 1e-12},
        quadrature_degree=4,
    )
    problem.solve()
    return problem.history


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", ["all_floating", "classical"])
def test_inflated_on_springs(wall, kind, degree):
    """Nothing but springs holds it; dashpots hold it back in the first of two time steps."""
    agree(wall.layers == {"wall": 101} and area(wall, "opening_2") > 0.0)
    u, boundary, residual, *rest = forms(wall, SPRINGS, degree=degree)
    agree(not boundary.bcs and boundary.energy is None)
    boundary.pressure.value = PRESSURE
    moved = []
    for dt in (0.1, np.inf):
        boundary.time_step.value = dt
        steps = feti(u, boundary, residual, *rest, kind)
        boundary.advance(u)
        moved.append(COMM.allreduce(np.abs(u.x.array).max(), op=max))
    agree(0.0 < moved[0] < moved[1] and 0.05 < moved[1] < 5.0, moved)
    agree(len(steps) <= 12 and steps[-1].linear_method == "gmres", steps)
    balanced(u, boundary, residual, PRESSURE)


def test_pulled_and_inflated(wall):
    """One end clamped, the other sliding, pulled to 1.1 times the length, then under pressure."""
    conditions = {"lumen": Pressure(), "opening_1": Clamp(), "opening_2": Slide()}
    u, boundary, residual, *rest = forms(wall, conditions, axis="z")
    for stretch, pressure in ((1.05, 0.0), (1.1, 0.0), (1.1, PRESSURE)):
        boundary.set_stretch(stretch)
        boundary.pressure.value = pressure
        feti(u, boundary, residual, *rest, "all_floating")
        balanced(u, boundary, residual, PRESSURE)
    x = u.function_space.tabulate_dof_coordinates()
    top = u.x.array.reshape(-1, 3)[np.isclose(x[:, 2], 10.0)]
    small(float(np.abs(top[:, 2] - 1.0).max(initial=0.0)), 1e-9)
