# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Materials with memory on a uniformly stretched block agree with their closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.integrate
from collective import COMM, equal, raises, small, uniform
from problems import cube

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, materials
from dolfinx_feti.loading import Steps, follow_load
from dolfinx_feti.mechanics import memory

DEGREE = 2
KAPPA = 1e6
C1 = 3.0  # kPa


class StretchedBlock:
    """A nearly incompressible block, stretched along x between planes of symmetry."""

    def __init__(self) -> None:
        self.mesh = cube(3, 2)
        self.V = dolfinx.fem.functionspace(self.mesh, ("Lagrange", 1, (3,)))
        P0 = dolfinx.fem.functionspace(self.mesh, ("DG", 0))
        self.u = dolfinx.fem.Function(self.V, name="u")
        self.p = dolfinx.fem.Function(P0)
        self.F = kinematics.deformation_gradient(self.u)
        self.J = kinematics.jacobian(self.F)
        self.psi = materials.neo_hookean(self.F.T * self.F, c=C1, J=self.J)
        self.pull, self.dt = (dolfinx.fem.Constant(self.mesh, 0.0) for _ in range(2))
        self.dx = ufl.dx(metadata={"quadrature_degree": DEGREE})

    def remembered(self, shape: tuple[int, ...] = ()) -> dolfinx.fem.Function:
        """A Function of the quadrature points."""
        cell = self.mesh.topology.cell_name()
        element = basix.ufl.quadrature_element(cell, value_shape=shape, degree=DEGREE)
        return dolfinx.fem.Function(dolfinx.fem.functionspace(self.mesh, element), name="ξ")

    def problem(self, psi, updates) -> NonlinearProblem:
        bcs = []
        for k, at, value in ((0, 0.0, 0.0), (1, 0.0, 0.0), (2, 0.0, 0.0), (0, 1.0, self.pull)):
            on = dolfinx.mesh.locate_entities_boundary(
                self.mesh, 2, lambda x, k=k, at=at: np.isclose(x[k], at)
            )
            dofs = dolfinx.fem.locate_dofs_topological(self.V.sub(k), 2, on)
            bcs.append(dolfinx.fem.dirichletbc(value, dofs, self.V.sub(k)))
        total = psi + materials.perturbed_lagrangian(self.J, self.p, kappa=KAPPA)
        self.stress = dolfinx.fem.form(ufl.diff(total, self.F)[0, 0] * self.dx)
        return NonlinearProblem(
            total * self.dx,
            self.u,
            bcs=bcs,
            condense=self.p,
            subdomains=4,
            internal_variables=updates,
            petsc_options={"snes_rtol": 1e-10},
        )

    def force(self) -> float:
        return COMM.allreduce(dolfinx.fem.assemble_scalar(self.stress))


def elastic_force(stretch: float) -> float:
    """Return the force of an incompressible neo-Hookean block, P = c (λ − 1/λ²)."""
    return C1 * (stretch - stretch**-2)


@pytest.fixture(scope="module")
def block() -> StretchedBlock:
    return StretchedBlock()


def test_relaxation(block):
    """After a sudden stretch, the overstress decays as β e^{−t/τ}, exactly."""
    block.u.x.array[:] = 0.0
    block.p.x.array[:] = 0.0
    β = (0.5, 0.25)
    τ = (2.0, 20.0)
    jump = 1e-7
    held = 0.7
    S = block.remembered((3, 3))
    Q = [block.remembered((3, 3)) for _ in β]
    branches = [memory.MaxwellBranch(*each) for each in zip(Q, β, τ, strict=True)]
    psi, updates = memory.viscoelastic(block.psi, block.F, S, branches, dt=block.dt)
    problem = block.problem(psi, updates)
    block.pull.value = 0.2
    block.dt.value = jump
    t = 0.0
    for _ in range(4):
        problem.solve()
        expected = elastic_force(1.2) * (1.0 + sum(np.array(β) * np.exp(-t / np.array(τ))))
        small(block.force() / expected - 1.0, 1e-5)
        problem.update_internal_variables()
        block.dt.value = held
        t = t + held


def test_update_in_a_load(block):
    """Load steps update the internal variables in each accepted state."""
    block.u.x.array[:] = 0.0
    block.p.x.array[:] = 0.0
    m = block.remembered()
    psi, updates = memory.damaged(block.psi, m, d_max=0.6, W=0.1)
    problem = block.problem(psi, updates)

    def energy(stretch: np.ndarray) -> np.ndarray:
        return C1 / 2.0 * (stretch**2 + 2.0 / stretch - 3.0)

    found = []
    targets = np.array([0.1, 0.3, 0.1, 0.4])
    follow_load(
        problem,
        lambda load: setattr(block.pull, "value", load),
        targets,
        Steps(first=1.0, least=0.01),
        unloading=True,
        on_step=lambda step: found.append((step.load, block.force())),
    )
    loads, forces = np.transpose(found)
    equal(loads, targets, 1e-14)
    damage = 0.6 * (1.0 - np.exp(-energy(1.0 + np.maximum.accumulate(targets)) / 0.1))
    uniform(forces / ((1.0 - damage) * elastic_force(1.0 + targets)), 1.0, 1e-5)
    uniform(m.x.array / energy(1.4), 1.0, 1e-5)


@pytest.mark.serial
def test_damaged_energy_is_the_integral_of_its_stress():
    """The damaged energy is φ(Ψ) = ∫ (1 − d(max(m, ψ))) dψ, on both sides of Ψ = m."""
    mesh = cube(3, 1)
    R = dolfinx.fem.functionspace(mesh, ("DG", 0))
    psi = dolfinx.fem.Function(R)
    m = dolfinx.fem.Function(R)
    φ, _ = memory.damaged(psi, m, d_max=0.6, W=0.1)
    form = dolfinx.fem.form(φ * ufl.dx)
    for energy, largest in ((0.05, 0.2), (0.2, 0.2), (0.5, 0.2), (0.3, 0.0)):
        psi.x.array[:] = energy
        m.x.array[:] = largest
        expected, _ = scipy.integrate.quad(
            lambda e, most=largest: 1.0 - 0.6 * (1.0 - np.exp(-max(most, e) / 0.1)),
            0.0,
            energy,
            points=[largest] if 0.0 < largest < energy else None,
            epsabs=1e-13,
        )
        small(dolfinx.fem.assemble_scalar(form) - expected, 1e-12)


def test_bad_internal_variables(block):
    """Internal variables are refused if shape, element or type do not fit."""
    with raises(ValueError, r"internal variable 'ξ' has the shape \(3, 3\), but 'ξ' has \(\)"):
        block.problem(block.psi, {block.remembered(): block.F})
    with raises(ValueError, "internal variable 'u' has the element .*, whose dofs cells share"):
        block.problem(block.psi, {block.u: block.u})
    with raises(TypeError, "internal_variables has the key 'd'"):
        block.problem(block.psi, {"d": block.psi})


def test_update_of_an_unknown_kind(block):
    """An unknown choice of internal variables to update is refused."""
    problem = block.problem(block.psi, {})
    with raises(ValueError, "which='recorderd': choose 'all', 'in_forces' or 'recorded'"):
        problem.update_internal_variables("recorderd")
