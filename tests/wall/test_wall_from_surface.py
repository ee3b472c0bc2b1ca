# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A wall of one layer, grown on an STL surface, on springs or pulled: FETI beside MUMPS.

MUMPS solves the problem that is not torn, assembled by dolfinx alone.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, small
from mesh_files import pipe, write_stl
from wall_files import on_first

import dolfinx
import dolfinx.fem.petsc
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, materials
from dolfinx_feti.wall import Clamp, Pressure, Slide, Spring, apply_conditions, area, read_wall
from meshes.vessel import create_vessel

KAPPA, PRESSURE = 30.0, 0.4  # kPa
SPRINGS = {
    "lumen": Pressure(),
    "outer": Spring(0.2, "all"),
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


def forms(wall, conditions, axis=None):
    """The displacement, and the energy of a compressible wall with its conditions."""
    u = dolfinx.fem.Function(dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 1, (3,))))
    boundary = apply_conditions(wall, u, conditions, axis=axis)
    F = kinematics.deformation_gradient(u)
    C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
    psi = materials.neo_hookean(C, c=3.0, J=J) + materials.volumetric(J, KAPPA)
    v, du = ufl.TestFunction(u.function_space), ufl.TrialFunction(u.function_space)
    dx = ufl.dx(metadata={"quadrature_degree": 2})
    residual = ufl.derivative(psi * dx, u, v)
    tangent = ufl.derivative(residual, u, du)
    return u, boundary, residual + boundary.residual, tangent + boundary.tangent


def mumps(u, bcs, residual, tangent):
    """Take whole Newton steps with MUMPS until they are small."""
    F, K = dolfinx.fem.form(residual), dolfinx.fem.form(tangent)
    du = dolfinx.fem.Function(u.function_space)
    for _ in range(30):
        A = dolfinx.fem.petsc.assemble_matrix(K, bcs=bcs)
        A.assemble()
        b = dolfinx.fem.petsc.assemble_vector(F)
        gap = dolfinx.fem.Function(u.function_space)
        for bc in bcs:
            bc.set(gap.x.array, u.x.array, -1.0)  # u − g
        shift = gap.x.petsc_vec
        K0 = dolfinx.fem.petsc.assemble_matrix(K)
        K0.assemble()
        lifted = K0 @ shift  # r(u) − K (u − g): what the free dofs are left with
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        b.axpy(-1.0, lifted)
        for bc in bcs:
            dofs = bc.dof_indices()[0]
            mine = dofs[dofs < b.getLocalSize()]
            b.array[mine] = gap.x.array[mine]
        ksp = PETSc.KSP().create(COMM)
        ksp.setOperators(A)
        ksp.setType("preonly")
        ksp.getPC().setType("lu")
        ksp.getPC().setFactorSolverType("mumps")
        x = b.duplicate()
        ksp.solve(b, x)
        n = x.getLocalSize()
        du.x.array[:n] = x.array_r
        du.x.scatter_forward()
        u.x.array[:] -= du.x.array
        length = x.norm()
        for owned in (ksp, A, K0, b, x, lifted):
            owned.destroy()
        if length <= 1e-11:
            return
    raise AssertionError(f"MUMPS did not converge: |du| = {length}")


def feti(u, boundary, residual, tangent, kind):
    problem = NonlinearProblem(
        residual,
        u,
        bcs=boundary.bcs,
        J=tangent,
        subdomains=6,
        petsc_options_prefix="from_surface_",
        petsc_options={"feti_type": kind, "snes_rtol": 1e-10, "snes_atol": 1e-12},
        quadrature_degree=2,
    )
    problem.solve()


def difference(u, reference):
    """Relative difference to other values of the owned dofs."""
    n = u.function_space.dofmap.index_map.size_local * 3
    square = [float(np.sum(v[:n] ** 2)) for v in (u.x.array - reference, reference)]
    error, scale = (COMM.allreduce(s) for s in square)
    agree(scale > 0.0)
    return np.sqrt(error / scale)


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
def test_inflated_on_springs(wall, kind):
    """Nothing but springs holds it."""
    agree(wall.layers == {"wall": 101} and area(wall, "opening_2") > 0.0)
    u, boundary, residual, tangent = forms(wall, SPRINGS)
    agree(not boundary.bcs and boundary.energy is None)
    boundary.pressure.value = PRESSURE
    mumps(u, boundary.bcs, residual, tangent)
    reference = u.x.array.copy()
    moved = COMM.allreduce(np.abs(reference).max(), op=max)
    agree(0.05 < moved < 5.0, moved)
    u.x.array[:] = 0.0
    feti(u, boundary, residual, tangent, kind)
    small(difference(u, reference), 1e-7)


def test_pulled_and_inflated(wall):
    """One end clamped, the other sliding, pulled to 1.1 times the length, then under pressure."""
    conditions = {"lumen": Pressure(), "opening_1": Clamp(), "opening_2": Slide()}
    u, boundary, residual, tangent = forms(wall, conditions, axis="z")
    found = []
    for solve in (
        lambda: mumps(u, boundary.bcs, residual, tangent),
        lambda: feti(u, boundary, residual, tangent, "all_floating"),
    ):
        u.x.array[:] = 0.0
        for stretch, pressure in ((1.05, 0.0), (1.1, 0.0), (1.1, PRESSURE)):
            boundary.set_stretch(stretch)
            boundary.pressure.value = pressure
            solve()
        found.append(u.x.array.copy())
    small(difference(u, found[0]), 1e-7)
    x = u.function_space.tabulate_dof_coordinates()
    top = u.x.array.reshape(-1, 3)[np.isclose(x[:, 2], 10.0)]
    small(float(np.abs(top[:, 2] - 1.0).max(initial=0.0)), 1e-9)
