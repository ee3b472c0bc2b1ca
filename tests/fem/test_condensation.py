# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Fields condensed cell by cell give the solution of the mixed problem."""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from mixed import ELEMENTS, Block, Mixed, block, by_cell, by_place, solve_assembled
from problems import owned

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.condensation.condensation import Condensation
from dolfinx_feti.fem.decomposition import decompose, tear
from dolfinx_feti.problems.equations.system import System
from dolfinx_feti.problems.forms import FieldEquation, Forms


@pytest.fixture
def torn_system(lifetime) -> Callable[..., System]:
    """Return a function that tears a block, without a solver."""

    def create(body: Block, subdomains: int = 5) -> System:
        decomposition = decompose(body.u.function_space.mesh, subdomains)
        forms = Forms(
            body.u,
            body.F_u,
            body.J,
            field_equations=tuple(map(FieldEquation, body.F_fields, body.fields)),
            energy=body.energy,
        )
        return lifetime.own(System(forms, bcs=body.bcs, decomposition=decomposition))

    return create


def step(system: System) -> tuple[np.ndarray, np.ndarray]:
    """Solve the condensed problem with MUMPS; return Δu (owned) and Δp (with ghosts)."""
    system.linearise()
    here = system.residual()
    A = system.tangent.A
    b = A.createVecLeft()
    b.array[:] = -here.of_u
    du = solve_assembled(A, b)
    b.destroy()
    return system.increment(here, du)[:2]


@pytest.mark.parametrize("kappa", [10.0, 1e5])
@pytest.mark.parametrize("element", ELEMENTS)
def test_condensed_step_of_any_element_is_the_mixed_one(element, kappa, torn_system):
    """The condensed Newton step is the mixed one, for each element and a nonlinear dilation."""
    body, alone = (block(comm, element, kappa) for comm in (COMM, MPI.COMM_SELF))
    body.deform()
    alone.deform()
    alone.u.x.array[:], values = Mixed(alone).increments()
    place(alone, values)
    du, values = step(torn_system(body))
    body.u.x.array[: len(du)] = du
    place(body, values)
    rounding = np.finfo(float).eps * kappa  # of κ (J − 1), beside pressures of some 0.2
    tolerance = max(1e-10, 20 * rounding)
    equal(by_place(body.u), by_place(alone.u), tolerance)
    for p, reference in zip(body.fields, alone.fields, strict=True):
        equal(by_cell(p), by_cell(reference), tolerance)


def place(body: Block, values: np.ndarray) -> None:
    """Set the condensed fields, one after the other."""
    ends = np.cumsum([len(p.x.array) for p in body.fields])
    for p, part in zip(body.fields, np.split(values, ends[:-1]), strict=True):
        p.x.array[:] = part


@pytest.mark.serial
@pytest.mark.parametrize("element", ELEMENTS)
def test_condensed_matrix(element, torn_system):
    """The condensed matrix is K_uu − K_up K_pp⁻¹ K_pu of dolfinx's blocks, to rounding."""
    body = block(COMM, element, 1e3, n=2)
    body.deform()
    system = torn_system(body, 3)
    system.linearise()
    n = system.owned
    blocks = Mixed(body).blocks()
    K = np.block([[part.toarray() for part in row] for row in blocks])
    expected = K[:n, :n] - K[:n, n:] @ np.linalg.solve(K[n:, n:], K[n:, :n])
    equal([system.tangent.multiply(e) for e in np.eye(n)], expected.T, 1e-13)


@pytest.mark.parametrize("element", ["p2-p0", "q2-p1d", "q2-p1d-p1d"])
def test_pressures_solve_as_the_mixed_problem(element):
    """Newton's method with FETI has the solution of the mixed problem."""
    body, alone = (block(comm, element, 100.0, n=2) for comm in (COMM, MPI.COMM_SELF))
    for other in (body, alone):
        if len(other.fields) == 2:
            other.fields[0].x.array[:] = 1.0  # θ at rest
    options = {"snes_rtol": 1e-12, "snes_atol": 1e-14, "ksp_rtol": 1e-10}
    given = {"bcs": body.bcs, "condense": body.fields, "subdomains": 4, "petsc_options": options}
    NonlinearProblem(body.energy, body.u, **given).solve()
    Mixed(alone).solve()
    equal(by_place(body.u), by_place(alone.u), 1e-9)
    for p, reference in zip(body.fields, alone.fields, strict=True):
        equal(by_cell(p), by_cell(reference), 1e-8)


def test_potential_of_a_nonlinear_dilation(torn_system):
    """Π(u) is evaluated with θ = J and p = Ψ′(θ), and leaves the fields unchanged."""
    body = block(COMM, "p2-p0-p0", 100.0)
    body.deform()
    before = [p.x.array.copy() for p in body.fields]
    system = torn_system(body)
    value = system.potential()
    for p, values in zip(body.fields, before, strict=True):
        equal(p.x.array, values)
    system.condensation.relax()
    for form in body.F_fields:
        r = dolfinx.fem.assemble_vector(dolfinx.fem.form(form)).array
        small(np.abs(r[: len(owned(body.fields[0]))]).max(initial=0.0), 1e-12)
    expected = dolfinx.fem.assemble_scalar(dolfinx.fem.form(body.energy))
    small(value / COMM.allreduce(expected) - 1.0, 1e-12)


@pytest.mark.parametrize("kappa", [1e-9, 1e9])
def test_units_make_no_block_singular(kappa, torn_system):
    """Blocks of κ/2 (θ − 1)² + p (J − θ), with pivots in the ratio κ², are not called singular."""
    body = block(COMM, "p2-p0-p0", kappa)
    body.fields[0].x.array[:] = 1.0
    here = torn_system(body).residual()
    agree(np.all(np.isfinite(here.condensed)) and np.any(here.condensed), here)


def test_processes_without_cells():
    """Processes without cells have empty arrays of the right shapes."""
    mesh = dolfinx.mesh.create_unit_cube(COMM, 1, 1, 1, cell_type=dolfinx.mesh.CellType.hexahedron)
    spaces = [dolfinx.fem.functionspace(mesh, e) for e in (("Lagrange", 2, (3,)), ("DPC", 1))]
    u, p = map(dolfinx.fem.Function, spaces)
    energy = (ufl.inner(ufl.grad(u), ufl.grad(u)) + p * ufl.div(u) - p**2 / 20) * ufl.dx
    F_u, F_p = (ufl.derivative(energy, f) for f in (u, p))
    cells = mesh.topology.index_map(3).size_local
    each = decompose(mesh, np.arange(cells))
    space = tear(spaces[0], each)
    compiler = Compiler(COMM)
    condensation = Condensation(F_u, [F_p], u, [p], space=space, compiler=compiler)
    condensation.create_multipliers()
    condensation.relax()
    agree(condensation.assemble().slope.shape == (cells, 4, 81))
    agree(condensation.set_multipliers(condensation.values()) == 0.0)


def test_multipliers_of_two_pressures_do_not_cancel():
    """The changes of two multipliers are measured separately, λ/κ and λ/(2 κ)."""
    mesh = dolfinx.mesh.create_unit_square(COMM, 3, 3)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    Q = dolfinx.fem.functionspace(mesh, ("DG", 0))
    u = dolfinx.fem.Function(V)
    p1, p2 = (dolfinx.fem.Function(Q, name=name) for name in ("p1", "p2"))
    stress = p1 * u[0].dx(0) + p2 * u[1].dx(1)
    energy = (ufl.inner(ufl.grad(u), ufl.grad(u)) + stress - (p1**2 + p2**2) / 20) * ufl.dx
    F_u, *F_p = (ufl.derivative(energy, f) for f in (u, p1, p2))
    space = tear(V, decompose(mesh, COMM.size))
    condensation = Condensation(F_u, F_p, u, [p1, p2], space=space, compiler=Compiler(COMM))
    p1.x.array[:] = 1.0
    p2.x.array[:] = -1.0
    with raises(RuntimeError, "needs create_multipliers"):
        condensation.set_multipliers(condensation.values())
    condensation.create_multipliers([2.0, 1.0])
    equal(condensation.set_multipliers(condensation.values()), 0.1, 1e-12)
    p2.x.array[:] = 0.0
    equal(condensation.set_multipliers(condensation.values()), 0.1, 1e-12)
    p1.x.array[:] = 3.0
    equal(condensation.set_multipliers(condensation.values()), 0.1, 1e-12)


def test_singular_block_is_refused(torn_system):
    """With more pressures than dilations, the error names the cell and the free field."""
    body = block(COMM, "q2-p1d-p1d", 10.0)
    mesh = body.u.function_space.mesh
    θ = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="θ")
    θ.x.array[:] = 1.0
    energy = ufl.replace(body.energy, {body.fields[0]: θ})
    body = Block(body.u, (θ, body.fields[1]), energy, body.bcs)
    system = torn_system(body)
    where = r"is singular in cell 0 of process \d, around \(0\.\d+, 0\.\d+, 0\.\d+\)"
    with raises(ValueError, f"condense: the block of 'p' {where}"):
        system.residual()


def test_pressure_that_is_no_number(torn_system):
    """A pressure of NaN gives a residual of NaN, and no singular block."""
    body = block(COMM, "q2-p1d-p1d", 10.0)
    body.fields[0].x.array[:] = np.nan
    agree(np.isnan(torn_system(body).residual().condensed).any())
