# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Imaged walls under load: prestress, with the code of docs/prestress.md, and unloading."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cases import each
from collective import COMM, agree, equal, norm, raises, small
from ufl_values import scalar
from walls import INNER, LUMEN, OUTER, fibres, lumen_measure, symmetric, tube, under_pressure

import dolfinx
import ufl

from dolfinx_feti import ConvergenceError, kinematics, loads, materials
from dolfinx_feti.errors import InadmissibleStartError
from dolfinx_feti.fem.nodes import Nodes
from dolfinx_feti.loading import Checkpoint, LoadStep, Steps, follow_load, prestress, unload
from dolfinx_feti.output import cell_values

PAGE = Path(__file__).parents[2] / "docs/prestress.md"
INCREMENTS: dict[str, float] = {"first": 10.0, "least": 1.0, "rtol": 1e-3}
STEPS = Steps(**INCREMENTS, quick=8)

both = pytest.mark.parametrize("prestressed", [True, False])


def program() -> list[str]:
    """Return the Python blocks of docs/prestress.md: wall, energy, problem, solves."""
    section = PAGE.read_text(encoding="utf-8").partition("\n## Prestress")[2]
    return re.findall(r"^```python\n(.*?)^```", section.partition("\n## ")[0], re.M | re.S)


class Scan:
    """A quarter tube in plane strain, imaged under pressure, to be prestressed or unloaded."""

    def __init__(self, *, prestressed: bool, length: float = 1.0, degree: int = 2) -> None:
        self.mesh = mesh = tube(quarter=True, around=8, along=1, length=0.2)
        V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        Q = dolfinx.fem.functionspace(mesh, ("DG", 0))
        u = dolfinx.fem.Function(V)
        p = dolfinx.fem.Function(Q)
        self.u = u
        self.p = p
        self.prestressed = prestressed
        self.length = length
        self.fibres = a1, a2 = [fibres(mesh, sign) for sign in (1.0, -1.0)]

        def psi(C, J, *a):
            elastic = materials.holzapfel_gasser_ogden(C, *a, c=100.0, k1=2.3632, k2=0.8393, J=J)
            return elastic + materials.perturbed_lagrangian(J, p, kappa=1000.0)

        self.names: dict[str, Any] = globals() | {
            "mesh": mesh,
            "u": u,
            "p": p,
            "a1": a1,
            "a2": a2,
            "psi": psi,
            "set_load": self.set_load,
            "increments": INCREMENTS,
        }
        if prestressed:
            exec(program()[1], self.names)
            self.F, energy, self.G = (self.names[name] for name in ("F", "energy", "G"))
        else:
            self.F = kinematics.deformation_gradient(u)
            energy = psi(kinematics.right_cauchy_green(self.F), ufl.det(self.F), a1, a2)
        self.stress = kinematics.cauchy_stress(energy, self.F)
        potential = energy * ufl.dx(metadata={"quadrature_degree": 2})
        ds = lumen_measure(mesh)(LUMEN, metadata={"quadrature_degree": 4})
        body = under_pressure(u, p, symmetric(V), potential, ds, "symmetric")
        self.load = body.load
        self.problem = body.problem(4)
        self.names["problem"] = self.problem
        mesh.geometry.x[:] *= length
        self.nodes = Nodes(mesh)

    def set_load(self, pressure: float) -> None:
        self.load.value = loads.mmhg(pressure)

    def find(self, *targets: float, steps: Steps = STEPS, **options: object) -> list[LoadStep]:
        """Prestress or unload the image."""
        given = self.problem, self.set_load, targets, steps
        return (
            prestress(*given, **{"G": self.G} | options)
            if self.prestressed
            else unload(*given, **options)
        )

    def found(self) -> np.ndarray:
        """Return G, or the unloaded nodes."""
        return self.G.x.array if self.prestressed else self.mesh.geometry.x / self.length

    def inflate(self, start: float, target: float) -> list[LoadStep]:
        return follow_load(self.problem, self.set_load, [target], STEPS, start=start)

    def moved(self) -> float:
        """Return the largest displacement of a dof [mm]."""
        return self.nodes.longest(self.u.x.array.reshape(-1, 3))

    def distance(self) -> float:
        """Return the distance of the loaded wall from the image [mm]."""
        loaded = self.mesh.geometry.x + self.nodes.displacement(self.u)
        return self.nodes.longest(loaded - self.nodes.initial)

    def hoop_stress(self) -> ufl.core.expr.Expr:
        """Return σ_θθ [kPa]."""
        x = ufl.SpatialCoordinate(self.mesh) + self.u
        e = ufl.as_vector([-x[1], x[0], 0])
        return ufl.inner(e, self.stress * e) / ufl.inner(e, e)

    def mean_hoop_stress(self) -> float:
        """Return the mean of σ_θθ through the wall [kPa]."""
        x = ufl.SpatialCoordinate(self.mesh) + self.u
        weight = ufl.det(self.F) / ufl.sqrt(x[0] ** 2 + x[1] ** 2)  # dv/r = dr dθ dz
        dx = ufl.dx(metadata={"quadrature_degree": 4})
        return scalar(self.hoop_stress() * weight * dx) / scalar(weight * dx)


# -- prestress


@pytest.mark.processes(1, 2)
def test_image_in_balance():
    """The prestressed image is in equilibrium, with a mean hoop stress of p r/h."""
    scan = Scan(prestressed=True)
    unloaded = Scan(prestressed=False)
    scan.find(80.0)
    agree(not scan.u.x.array.any())
    scan.problem.solve()
    small(scan.moved(), 1e-8)
    small(scan.mean_hoop_stress() / (loads.mmhg(80.0) * INNER / (OUTER - INNER)) - 1.0, 1e-3)
    unloaded.find(80.0, fibres=unloaded.fibres)
    stress, other = (cell_values(body.hoop_stress(), body.mesh) for body in (unloaded, scan))
    small(norm(other - stress), 0.04 * norm(stress))
    for body in (scan, unloaded):
        body.inflate(80.0, 120.0)
    agree(scan.moved() > 0.03)
    small(scan.mean_hoop_stress() / unloaded.mean_hoop_stress() - 1.0, 0.01)


@pytest.mark.processes(1, 2)
def test_lines_of_the_page():
    """The code of docs/prestress.md reaches 120 mmHg."""
    scan = Scan(prestressed=True)
    exec(program()[3], scan.names)
    agree(float(scan.load.value) == loads.mmhg(120.0) and scan.moved() > 0.03)


# -- unloading


@pytest.mark.processes(1, 2)
@pytest.mark.parametrize("degree", [1, 2])
def test_loaded_again_it_is_the_image(degree):
    """The unloaded wall, loaded again, is the image, at the cost of at most three inflations."""
    scan = Scan(prestressed=False, degree=degree)
    inflation = scan.inflate(0.0, 80.0)
    for f in (scan.u, scan.p):
        f.x.array[:] = 0.0
    steps = scan.find(80.0)
    for spent, once in zip(cost(steps), cost(inflation), strict=True):
        agree(spent <= 3 * once, (spent, once))
    agree(scan.nodes.longest(scan.mesh.geometry.x - scan.nodes.initial) > 0.01)
    small(scan.distance(), 1e-12)  # u leads to the image
    for f in (scan.u, scan.p):
        f.x.array[:] = 0.0
    scan.inflate(0.0, 80.0)
    small(scan.distance(), 1e-6)


def cost(steps: list[LoadStep]) -> tuple[int, int]:
    """Return the number of load steps and Newton steps, failed attempts included."""
    return sum(1 + step.failures for step in steps), sum(len(step.all_steps) for step in steps)


def test_fibres_follow():
    """Fibres of the unloaded wall, moved by F, have the image's directions in each cell."""
    scan = Scan(prestressed=False)
    moves = []
    a = scan.fibres[0]
    nodes = scan.nodes
    image = a.x.array.copy()

    def on_move() -> None:
        moves.append(nodes.longest(scan.mesh.geometry.x - nodes.initial))

    scan.find(10.0, fibres=[a], on_move=on_move)
    F = ufl.Identity(3) + ufl.grad(scan.u)
    pushed, length = (cell_values(e, scan.mesh) for e in (F * a, ufl.sqrt(ufl.inner(a, a))))
    equal(length, np.ones_like(length), 1e-12)
    pushed /= np.linalg.norm(pushed, axis=1, keepdims=True)
    equal(pushed, image.reshape(-1, 3)[: len(pushed)], 1e-12)
    agree(moves[0] == 0.0 and moves[-1] > 0.0, moves)
    agree(all(moved == 0.0 for moved in moves[1::2]), moves)  # back to the image


@pytest.mark.processes(1, 2)
def test_failure_of_the_last_move_leaves_the_image():
    """If ``on_move`` raises, the image is restored and ``on_move`` is called for it."""
    moves = []
    Scan(prestressed=False).find(10.0, on_move=lambda: moves.append(None))
    scan = Scan(prestressed=False)
    last = len(moves)
    moves.clear()

    def on_move() -> None:
        moves.append(scan.mesh.geometry.x.copy())
        if len(moves) == last and COMM.rank == COMM.size - 1:
            raise ZeroDivisionError("the last move")

    with raises(ZeroDivisionError, "the last move"):
        scan.find(10.0, on_move=on_move)
    agree(len(moves) == last + 1 and np.any(moves[-2] != scan.nodes.initial))
    equal(moves[-1], scan.nodes.initial)
    equal(scan.mesh.geometry.x, scan.nodes.initial)


def test_inverted_cells_are_counted():
    """The error of inverted cells counts them."""
    scan = Scan(prestressed=False)
    agree(scan.nodes.inverted() == 0)
    scan.mesh.geometry.x[:, 0] *= -1.0
    agree(scan.nodes.inverted() == scan.mesh.topology.index_map(3).size_global)


def test_cell_inside_out_on_the_way(monkeypatch):
    """A guess that inverts a cell is halved, and the unloaded wall is found."""
    scan = Scan(prestressed=False)
    calls = []
    solve = scan.problem.solve

    def refuse_second(**arguments):
        calls.append(scan.u.x.array.copy())
        if len(calls) == 2:
            raise InadmissibleStartError("a cell is inside out")
        solve(**arguments)

    monkeypatch.setattr(scan.problem, "solve", refuse_second)
    (step,) = scan.find(10.0)
    agree(step.failures == 0 and step.load == 10.0)
    equal(calls[2], (calls[0] + calls[1]) / 2, 1e-15)
    small(scan.distance(), 1e-12)


# -- both


@both
@pytest.mark.processes(1, 2)
def test_path_that_goes_on(tmp_path, prestressed):
    """Its last part is that of one in one piece; what was found is in the checkpoint.

    So is the user's own state. A path may begin at another load than zero.
    """
    folder = Path(COMM.bcast(tmp_path)) / "run"
    for targets, restart in (([10.0], False), ([10.0, 20.0], True)):
        pieces = Scan(prestressed=prestressed)
        mine = dolfinx.fem.Function(pieces.p.function_space)
        mine.x.array[:] = 0.0 if restart else 3.0
        saved = {"checkpoint": Checkpoint(folder, COMM, restart=restart), "state": [mine]}
        pieces.find(*targets, **saved)
        agree(np.all(mine.x.array == 3.0))
    whole = Scan(prestressed=prestressed)
    whole.find(10.0, 20.0)
    first = Scan(prestressed=prestressed).find(20.0, start=18.0)[0]
    agree(first.load - first.increment == 18.0, first)
    equal(pieces.found(), whole.found(), 1e-8 if prestressed else 1e-6)


@both
def test_steps_are_the_same_in_any_unit_of_length(prestressed):
    """The steps of a path are the same in millimetres, metres and micrometres."""
    scans = [Scan(prestressed=prestressed, length=length) for length in (1.0, 1e-3, 1e3)]
    taken = [[len(step.all_steps) for step in scan.find(20.0)] for scan in scans]
    agree(taken[1] == taken[0] and taken[2] == taken[0], taken)
    for scan in scans[1:]:
        equal(scan.found(), scans[0].found(), 1e-8 if prestressed else 1e-7)


@both
@pytest.mark.processes(1, 2)
def test_failure_leaves_the_image(prestressed):
    """A load without equilibrium leaves G or mesh, load and displacement of the last one."""
    scan = Scan(prestressed=prestressed)
    seen = []
    before = scan.found().copy()
    options = {} if prestressed else {"on_move": lambda: seen.append(scan.found().copy())}
    with raises(ConvergenceError, "No equilibrium was found beyond a load of 0"):
        scan.find(4e4, steps=Steps(first=4e4, least=2e4), **options)
    for found in (scan.found(), *seen[-1:]):
        equal(found, before)
    agree(float(scan.load.value) == 0.0 and not scan.u.x.array.any())


@pytest.mark.parametrize("tolerance", [0.0, -1.0, np.nan])
def test_bad_tolerance(tolerance):
    """A tolerance that is not positive is refused by prestress and unload."""
    scan = Scan(prestressed=True)
    message = "tolerance is .*: give a positive share of the diameter"
    with raises(ValueError, message):
        scan.find(1.0, tolerance=tolerance)
    with raises(ValueError, message):
        unload(scan.problem, scan.set_load, targets=[1.0], steps=STEPS, tolerance=tolerance)


def identity(mesh: dolfinx.mesh.Mesh, *element: object) -> dolfinx.fem.Function:
    """Return the identity, or its first entries, as a Function of an element."""
    G = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element))
    G.x.array[:] = np.resize(np.eye(3).ravel(), len(G.x.array))
    return G


#: What is given as G, the error, and its message.
WRONG_G = {
    "expression": (lambda mesh: ufl.Identity(3), TypeError, "G is .*: give .*Function"),
    "vector": (
        lambda mesh: identity(mesh, "DG", 0, (3,)),
        ValueError,
        r"G has the shape \(3,\): give a .* shape \(3, 3\)",
    ),
    "continuous": (
        lambda mesh: identity(mesh, "Lagrange", 1, (3, 3)),
        ValueError,
        "whose dofs cells share",
    ),
}


@each(("create", "error", "message"), WRONG_G)
def test_bad_prestress(create, error, message):
    """``prestress`` refuses a G that is not a tensor field of the forms."""
    scan = Scan(prestressed=True)
    with raises(error, message):
        scan.find(1.0, G=create(scan.mesh))


def test_first_guess_of_a_prestress_is_the_identity():
    """Prestress begins with G = I."""
    scan = Scan(prestressed=True)
    scan.G.x.array[:] = 0.0
    with raises(ValueError, "det G = 0 somewhere: let G be the identity at first"):
        scan.find(1.0)


@pytest.mark.parametrize("path", [prestress, unload])
def test_a_scan_has_the_arguments_of_a_path(path):
    """``prestress`` and ``unload`` show the arguments of follow_load, with equal defaults."""
    given = inspect.signature(path).parameters
    for name, parameter in inspect.signature(follow_load).parameters.items():
        default = given[name].default
        agree(default == parameter.default, f"{name}={default}")
