# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Prestress, by the lines of docs/prestress.md: an image that stays where it is under its load."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from ufl_values import scalar
from walls import INNER, LUMEN, OUTER, fibres, lumen_measure, symmetric, tube

import dolfinx
import ufl

from dolfinx_feti import ConvergenceError, NonlinearProblem, kinematics, loads, materials
from dolfinx_feti.loading import Checkpoint, Steps, follow_load, prestress, unload
from dolfinx_feti.output import cell_values

PAGE = Path(__file__).parents[2] / "docs/prestress.md"
INCREMENTS: dict[str, float] = {"first": 10.0, "least": 1.0, "rtol": 1e-2}
STEPS = Steps(**INCREMENTS, quick=8)


def program() -> list[str]:
    """Return the blocks of Python of the page's section: the energy, the solves."""
    section = PAGE.read_text(encoding="utf-8").partition("\n## Prestress")[2]
    return re.findall(r"^```python\n(.*?)^```", section.partition("\n## ")[0], re.M | re.S)


class Scan:
    """A quarter of a tube in plane strain, imaged under pressure; P2–P0."""

    def __init__(self, *, prestressed: bool = True, length: float = 1.0) -> None:
        self.mesh = mesh = tube(quarter=True, around=8, along=1, length=0.2)
        V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
        Q = dolfinx.fem.functionspace(mesh, ("DG", 0))
        u, p = dolfinx.fem.Function(V, name="u"), dolfinx.fem.Function(Q, name="p")
        self.u, self.state = u, [u, p]
        self.fibres = [fibres(mesh, sign) for sign in (1.0, -1.0)]
        self.load = dolfinx.fem.Constant(mesh, 0.0)

        def psi(C, J, *a):
            elastic = materials.holzapfel_gasser_ogden(C, *a, c=100.0, k1=2.3632, k2=0.8393, J=J)
            return elastic + materials.perturbed_lagrangian(J, p, kappa=1000.0)

        a1, a2 = self.fibres
        self.names: dict[str, Any] = globals() | {
            "mesh": mesh, "u": u, "p": p, "a1": a1, "a2": a2, "psi": psi,
            "set_load": self.set_load, "increments": INCREMENTS,
        }  # fmt: skip
        if prestressed:
            exec(program()[0], self.names)
            self.F, energy, self.G = (self.names[name] for name in ("F", "energy", "G"))
        else:
            self.F = kinematics.deformation_gradient(u)
            energy = psi(kinematics.right_cauchy_green(self.F), ufl.det(self.F), a1, a2)
        self.stress = kinematics.cauchy_stress(energy, self.F)
        dx = ufl.dx(metadata={"quadrature_degree": 2})
        ds = lumen_measure(mesh)(LUMEN, metadata={"quadrature_degree": 4})
        v, q, du = ufl.TestFunction(V), ufl.TestFunction(Q), ufl.TrialFunction(V)
        R = ufl.derivative(energy * dx, u, v)
        K = ufl.derivative(R, u, du)
        K += loads.follower_pressure_tangent(self.load, u, v, du, ds, "symmetric")
        R += loads.follower_pressure(self.load, u, v, ds)
        self.problem = NonlinearProblem(
            [R, ufl.derivative(energy * dx, p, q)],
            u,
            J=K,
            bcs=symmetric(V),
            condense=p,
            subdomains=4,
        )
        self.names["problem"] = self.problem
        mesh.geometry.x[:] *= length

    def set_load(self, pressure: float) -> None:
        self.load.value = loads.mmhg(pressure)

    def prestress(self, *targets: float, steps: Steps = STEPS, **options):
        options = {"G": self.G, "state": self.state} | options
        return prestress(self.problem, self.set_load, targets, steps, **options)

    def inflate(self, start: float, target: float) -> None:
        follow_load(self.problem, self.set_load, [target], STEPS, state=self.state, start=start)

    def moved(self) -> float:
        """The longest displacement of a dof [mm]."""
        lengths = np.linalg.norm(self.u.x.array.reshape(-1, 3), axis=1)
        return COMM.allreduce(float(lengths.max(initial=0.0)), op=max)

    def hoop_stress(self) -> ufl.core.expr.Expr:
        """σ_θθ [kPa]."""
        x = ufl.SpatialCoordinate(self.mesh) + self.u
        e = ufl.as_vector([-x[1], x[0], 0])
        return ufl.inner(e, self.stress * e) / ufl.inner(e, e)

    def mean_hoop_stress(self) -> float:
        """The mean of σ_θθ from the lumen to the outside [kPa]."""
        x = ufl.SpatialCoordinate(self.mesh) + self.u
        weight = ufl.det(self.F) / ufl.sqrt(x[0] ** 2 + x[1] ** 2)  # dv/r = dr dθ dz
        dx = ufl.dx(metadata={"quadrature_degree": 4})
        return scalar(self.hoop_stress() * weight * dx) / scalar(weight * dx)


def norm(values: np.ndarray) -> float:
    """Of what the processes hold together."""
    return float(np.sqrt(COMM.allreduce(float(np.sum(values**2)))))


@pytest.fixture(scope="module")
def unloaded():
    """The same image unloaded, and its stress at 80 and 120 mmHg."""
    scan = Scan(prestressed=False)
    options = {"state": scan.state, "fibres": scan.fibres}
    unload(scan.problem, scan.set_load, [80.0], STEPS, **options)
    stress = cell_values(scan.hoop_stress(), scan.mesh)
    scan.inflate(80.0, 120.0)
    return stress, scan.mean_hoop_stress()


@pytest.mark.processes(1, 2)
def test_image_in_balance(unloaded):
    """It stays, its hoop stress is p r/h in the mean, and like that of the unloaded wall."""
    scan = Scan()
    scan.prestress(80.0)
    agree(not scan.u.x.array.any())
    scan.problem.solve()
    small(scan.moved(), 1e-8)
    small(scan.mean_hoop_stress() / (loads.mmhg(80.0) * INNER / (OUTER - INNER)) - 1.0, 1e-3)
    stress, at_120 = unloaded
    small(norm(cell_values(scan.hoop_stress(), scan.mesh) - stress), 0.04 * norm(stress))
    scan.inflate(80.0, 120.0)
    agree(scan.moved() > 0.03, scan.moved())
    small(scan.mean_hoop_stress() / at_120 - 1.0, 0.01)


@pytest.mark.processes(1, 2)
def test_lines_of_the_page():
    """They lead to 120 mmHg."""
    scan = Scan()
    exec(program()[1], scan.names)
    agree(float(scan.load.value) == loads.mmhg(120.0) and scan.moved() > 0.03)


@pytest.mark.processes(1, 2)
def test_path_that_goes_on(tmp_path):
    """G is in the checkpoint: the second part goes on where the first one ended."""
    folder = Path(COMM.bcast(tmp_path)) / "run"
    pieces, whole = Scan(), Scan()
    for targets, restart in (([10.0], False), ([10.0, 20.0], True)):
        pieces = Scan()
        pieces.prestress(*targets, checkpoint=Checkpoint(folder, COMM, restart=restart))
    whole.prestress(10.0, 20.0)
    equal(pieces.G.x.array, whole.G.x.array, 1e-8)


def test_steps_are_the_same_in_any_unit_of_length():
    """In millimetres, metres and micrometres."""
    scans = [Scan(length=length) for length in (1.0, 1e-3, 1e3)]
    taken = [[len(step.all_steps) for step in scan.prestress(20.0)] for scan in scans]
    agree(taken[1] == taken[0] and taken[2] == taken[0], taken)
    for scan in scans[1:]:
        equal(scan.G.x.array, scans[0].G.x.array, 1e-8)


@pytest.mark.processes(1, 2)
def test_failure_leaves_the_last_balance():
    """A load that nothing carries: G, load and displacement are the last good."""
    scan = Scan()
    G = scan.G.x.array.copy()
    with raises(ConvergenceError, "No equilibrium was found beyond a load of 0"):
        scan.prestress(4e4, steps=Steps(first=4e4, least=4e4))
    equal(scan.G.x.array, G)
    agree(float(scan.load.value) == 0.0 and not scan.u.x.array.any())


def test_bad_input():
    scan = Scan()
    for tolerance in (0.0, -1.0, np.nan):
        with raises(ValueError, "tolerance is .*: give a positive share of the diameter"):
            scan.prestress(1.0, tolerance=tolerance)
        with raises(ValueError, "tolerance is .*: give a positive share of the diameter"):
            unload(scan.problem, scan.set_load, [1.0], STEPS, state=scan.state, tolerance=tolerance)

    def other(*element: object) -> dolfinx.fem.Function:
        G = dolfinx.fem.Function(dolfinx.fem.functionspace(scan.mesh, element))
        G.x.array[:] = np.resize(np.eye(3).ravel(), len(G.x.array))
        return G

    with raises(TypeError, "G is .*: give .*Function"):
        scan.prestress(1.0, G=ufl.Identity(3))
    with raises(ValueError, r"G has the shape \(3,\): give a Function of the shape \(3, 3\)"):
        scan.prestress(1.0, G=other("DG", 0, (3,)))
    with raises(ValueError, "whose dofs cells share"):
        scan.prestress(1.0, G=other("Lagrange", 1, (3, 3)))
    scan.G.x.array[:] = 0.0
    with raises(ValueError, "det G = 0 somewhere: let G be the identity at first"):
        scan.prestress(1.0)
