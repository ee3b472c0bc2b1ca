# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The pressure condensed cell by cell, against the mixed problem without condensation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest
from collective import COMM, agree, equal, raises
from mixed import Mixed, by_place, solve_assembled
from problems import owned
from walls import LUMEN, Wall, lumen_measure, tube, wall

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, loads
from dolfinx_feti.fem.assembly import LocalMatrix
from dolfinx_feti.fem.decomposition import decompose
from dolfinx_feti.problems.system import System

degrees = pytest.mark.parametrize("degree", [1, 2])


@pytest.fixture
def torn_system() -> Iterator[Callable[..., System]]:
    """Tear a wall, without a solver."""
    made = []

    def create(body: Wall, subdomains: int = 5) -> System:
        decomposition = decompose(body.u.function_space.mesh, subdomains)
        made.append(
            System(
                body.F_u,
                body.u,
                bcs=body.bcs,
                J=body.J,
                pressure=(body.F_p, body.p),
                energy=body.energy,
                volume_ratio=None,
                quadrature_degree=2,
                decomposition=decomposition,
            )
        )
        return made[-1]

    yield create
    for system in made:
        system.destroy()


def deform(body: Wall) -> None:
    """Take a state that obeys nothing: neither the boundary conditions nor p = κ (J − 1)."""
    body.load.value = loads.mmhg(10.0)
    body.u.interpolate(
        lambda x: 0.02 * np.stack([x[0] + x[1] * x[2], np.sin(2 * x[0]) - x[2], x[0] * x[1] * x[2]])
    )
    body.p.interpolate(lambda x: np.cos(3 * x[0]) + 0.5 * x[2])


def step(system: System) -> tuple[np.ndarray, np.ndarray]:
    """Solve the condensed problem with MUMPS; return Δu (owned) and Δp (with ghosts)."""
    system.linearise()
    here = system.residual()
    b = system.A.createVecLeft()
    b.array[:] = -here.condensed
    du = solve_assembled(system.A, b)
    b.destroy()
    return system.increment(here, du)


@degrees
@pytest.mark.parametrize("kappa", [10.0, 1e3, 1e5])
def test_condensed_step_is_the_mixed_one(degree, kappa, torn_system):
    body, alone = (wall(tube(comm), degree=degree, kappa=kappa) for comm in (COMM, MPI.COMM_SELF))
    deform(body)
    deform(alone)
    expected = Mixed(alone).step()
    du, dp = step(torn_system(body))
    for field, reference, actual, value in zip(
        (body.u, body.p), (alone.u, alone.p), (du, dp), expected, strict=False
    ):
        field.x.array[: len(actual)] = actual
        reference.x.array[:] = value
        equal(by_place(field), by_place(reference), 1e-10)


@degrees
def test_blocks_are_those_of_ufl(degree, torn_system):
    """Rows of K_pu, K_pp and r_p against the derivatives that a user would write."""
    body = wall(tube(), degree=degree)
    deform(body)
    system = torn_system(body)
    here = system.residual()
    V, Q = body.u.function_space, body.p.function_space
    w, one = dolfinx.fem.Function(V), dolfinx.fem.Function(Q)
    w.interpolate(lambda x: np.stack([np.cos(x[1]), x[2] * x[0], 1.0 + x[0]]))
    one.x.array[:] = 1.0
    forms = (body.F_p, ufl.derivative(body.F_p, body.u, w), ufl.derivative(body.F_p, body.p, one))
    r_p, slope, K_pp = (dolfinx.fem.assemble_vector(dolfinx.fem.form(form)).array for form in forms)
    n = Q.dofmap.index_map.size_local
    agree(min(np.abs(a[:n]).min(initial=1.0) for a in (r_p, slope)) > 0.0)
    for factor in (0.0, 1.0):
        _, dp = system.increment(here, factor * owned(w))
        equal(dp[:n], -(r_p + factor * slope)[:n] / K_pp[:n], 1e-12)


@pytest.mark.parametrize("wrong", ["columns", "rows of a node", "nodes"])
def test_matrix_without_a_place_is_refused(wrong, torn_system):
    """A pattern that does not couple the nodes of all cells is noticed, not written past."""
    body = wall(tube())
    deform(body)
    system = torn_system(body)
    csr = system._K.csr
    indptr, indices, values = csr.indptr.copy(), csr.indices.copy(), csr.data.copy()
    if wrong == "columns":
        indices[indptr[-4] :] = 0
    elif wrong == "rows of a node":
        indptr[1:-1:3] -= 3
    else:
        indptr = indptr[:-3]
    other = LocalMatrix(SimpleNamespace(indptr=indptr, indices=indices, data=values), system._K.mat)
    blocks = system.condensation.assemble()
    with raises(ValueError, r"K, of \d+ nodes, does not couple all nodes"):
        system.condensation.add_to(other, blocks)


@degrees
def test_condensed_residual_is_that_of_the_updated_pressure(degree, torn_system):
    """F_u is linear in p: r_u − K_up K_pp⁻¹ r_p = r_u(u, p − K_pp⁻¹ r_p)."""
    body = wall(tube(), degree=degree)
    deform(body)
    system = torn_system(body)
    here = system.residual()
    _, dp = system.increment(here, np.zeros(system.owned))
    body.p.x.array[:] += dp
    body.p.x.scatter_forward()
    r = dolfinx.fem.assemble_vector(dolfinx.fem.form(body.F_u))
    r.scatter_reverse(dolfinx.la.InsertMode.add)
    for bc in body.bcs:
        bc.set(r.array, body.u.x.array, -1.0)
    equal(here.condensed, r.array[: system.owned], 1e-11)


@degrees
def test_pressure_obeys_its_equation(degree):
    """Once Newton has converged, p = κ · mean(J − 1) on each cell."""
    body = wall(tube(), degree=degree)
    problem = body.problem(4, {"snes_rtol": 1e-12})
    body.inflate(problem, [2.0])
    q = ufl.TestFunction(body.p.function_space)
    J = ufl.det(ufl.Identity(3) + ufl.grad(body.u))
    forms = ((J - 1) * q * ufl.dx, q * ufl.dx)
    swelling, volume = (dolfinx.fem.assemble_vector(dolfinx.fem.form(f)).array for f in forms)
    n = len(owned(body.p))
    equal(owned(body.p), 1000.0 * swelling[:n] / volume[:n], 1e-7)


def test_energy_is_as_good_as_residuals():
    """Π(u, p) with the load's potential gives the solution of the pair of residuals."""
    pair, one = wall(tube()), wall(tube())
    pair.inflate(pair.problem(4), [5.0])
    one.load.value = loads.mmhg(5.0)
    potential = loads.pressure_potential(
        one.load, one.u, lumen_measure(one.u.function_space.mesh)(LUMEN)
    )
    problem = NonlinearProblem(
        one.energy + potential,
        one.u,
        bcs=one.bcs,
        condense=one.p,
        subdomains=3,
        petsc_options_prefix="energy_",
    )
    problem.solve()
    equal(by_place(one.u), by_place(pair.u), 1e-7)
    equal(by_place(one.p), by_place(pair.p), 1e-6)
