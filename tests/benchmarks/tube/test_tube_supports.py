# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Supports of the tube: they hold it exactly once, and no stress comes of them."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, dense, norm, raises, small, whole

import dolfinx

from benchmarks.common.walls import supports
from benchmarks.common.walls.inflated_tube import create_inflated_tube, create_slice
from benchmarks.common.walls.problem import WallProblem
from dolfinx_feti import loads
from dolfinx_feti.comparison import assembled_system, create_solver
from meshes.walls import create_tube_wall

TYPES = ("all_floating", "classical")
#: Share of the largest eigenvalue, of a matrix scaled to a diagonal of one, that is no rounding.
FLOOR = 1e-9


def tube(
    size: float, element: str = "p1-p0", quarter: bool = False, **options: object
) -> WallProblem:
    wall = create_slice(COMM, size=size, quarter=quarter)
    return create_inflated_tube(
        wall, element=element, c=6.0, kappa=1e5, subdomains=5, options=options
    ).body


def eigenvalues(body: WallProblem) -> np.ndarray:
    """Eigenvalues of the assembled tangent at the present state, scaled by its diagonal."""
    body.problem.linearise()
    K, f = assembled_system(body.problem.A, body.problem.A.createVecLeft())
    values = dense(K)
    for owned in (K, f):
        owned.destroy()
    scale = np.sqrt(np.diag(values))
    return np.linalg.eigvalsh(values / scale / scale[:, None])


def reaction(body: WallProblem) -> np.ndarray:
    """Residual of the owned dofs, without regard to Dirichlet conditions [mN]."""
    r = dolfinx.fem.assemble_vector(dolfinx.fem.form(body.residual))
    r.scatter_reverse(dolfinx.la.InsertMode.add)
    V = body.u.function_space
    return r.array[: V.dofmap.index_map.size_local * V.dofmap.index_map_bs]


@pytest.mark.parametrize(
    ("size", "quarter"),
    [(0.39, False)]
    + [pytest.param(size, False, marks=pytest.mark.serial) for size in (0.3, 0.26, 0.2)]
    + [pytest.param(0.26, True, marks=pytest.mark.serial)],
)
def test_tangent_has_no_kernel(size, quarter):
    """At rest, where the tangent of a body that is not held has one exactly."""
    λ = eigenvalues(tube(size, quarter=quarter))
    agree(λ[0] > FLOOR * λ[-1], λ[:4])


@pytest.mark.serial
def test_quadratic_tube_under_pressure_has_no_kernel():
    """In equilibrium the load leaves the rigid motions in the kernel of a tube that is not held."""
    body = tube(0.39, element="p2-p0")
    body.pressure.value = loads.mmhg(5.0)
    body.problem.solve()
    λ = eigenvalues(body)
    agree(λ[0] > FLOOR * λ[-1], λ[:4])


@pytest.mark.serial
def test_without_its_nodes_the_whole_tube_has_three_motions(monkeypatch):
    """Two translations and a rotation: so many conditions hold it, and each is needed."""
    for held, motions in (((), 3), (supports.NODES[:1], 2), (supports.NODES[1:], 1)):
        monkeypatch.setattr(supports, "NODES", held)
        λ = eigenvalues(tube(0.39))
        free = np.abs(λ) <= 1e-12 * λ[-1]
        agree(free.sum() == motions and λ[motions] > FLOOR * λ[-1], (motions, λ[:5]))


@pytest.mark.parametrize("kind", TYPES)
def test_both_variants_find_the_solution_of_a_direct_solver(kind):
    body = tube(0.3, feti_type=kind, ksp_rtol=1e-10)
    body.pressure.value = loads.mmhg(1.0)
    body.problem.linearise()
    r = reaction(body).copy()
    held = np.concatenate([bc.dof_indices()[0] for bc in body.bcs])
    r[held[held < len(r)]] = 0.0
    ksp = body.problem.solver.getKSP()
    ksp.setOperators(body.problem.A)
    b, x = body.problem.A.createVecLeft(), body.problem.A.createVecRight()
    b.array[:] = -r
    ksp.solve(b, x)
    agree(ksp.getConvergedReason() > 0, ksp.getPythonContext().message)
    K, f = assembled_system(body.problem.A, b)
    mumps = create_solver(K)
    y = f.duplicate()
    mumps.solve(f, y)
    x.axpy(-1.0, y)
    small(x.norm() / y.norm(), 1e-6)
    for owned in (b, x, y, K, f, mumps):
        owned.destroy()


def test_supports_leave_no_stress():
    """The three reactions vanish beside the load; those of the ends do not."""
    body = tube(0.3)
    body.pressure.value = loads.mmhg(10.0)
    load = norm(reaction(body))  # at rest the pressure is all of it
    body.problem.solve()
    r = reaction(body)
    in_plane = np.zeros(len(r), dtype=bool)
    for bc in body.bcs[2:]:
        dofs = bc.dof_indices()[0]
        in_plane[dofs[dofs < len(r)]] = True
    agree(whole(in_plane).sum() == 3)
    small(norm(r[in_plane]) / load, 1e-6)
    held = np.concatenate([bc.dof_indices()[0] for bc in body.bcs[:2]])
    agree(norm(r[held[held < len(r)]]) > 0.01 * load)


@pytest.mark.parametrize("around", [6, 9, 11])
def test_tube_without_a_node_to_hold_is_refused(around):
    """Half a turn, or a quarter of one, away from the first node there is none."""
    wall = create_tube_wall(COMM, length=0.3, size=0.3, around=around)
    with raises(ValueError, "no node at .* mm, .*mesh it with a multiple of four elements around"):
        create_inflated_tube(wall, element="p1-p0", c=6.0, kappa=1e5, subdomains=4)
