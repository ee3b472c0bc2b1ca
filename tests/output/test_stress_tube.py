# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Recovered stresses of the inflated tube beside its semi-analytical ones, P2–P0, κ = 1000 kPa."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest
import wall_files
from collective import COMM, agree, small
from walls import fibres, wall

import basix
import dolfinx
import ufl
from ufl.core.expr import Expr

from benchmarks.tube_oracle import KPA_PER_MMHG, inflate
from benchmarks.tube_oracle import Wall as Oracle
from dolfinx_feti import kinematics, loads, materials
from dolfinx_feti.loading import Steps, follow_load
from dolfinx_feti.output import components, create_patches, layer_means, recovered_field

Array = npt.NDArray[np.float64]
Errors = dict[str, tuple[float, float]]

KAPPA = 1000.0


@dataclass(frozen=True, slots=True)
class Inflated:
    """What is compared at a pressure.

    Attributes:
        errors: Of σ_θθ and σ_rr in the L2 norm over the wall, relative to the truth: of the stress
            inside the cells, and of the recovered ones without and with the normal.
        hoop: Mean of σ_θθ over each layer of the deformed wall, and the truth [kPa].
        pressure: Error of the recovered pressure, and of p itself, relative to the truth.
    """

    errors: Errors
    hoop: dict[str, tuple[float, float]]
    pressure: tuple[float, float]


def inflated(folder, size: float, pressures: list[float]) -> dict[float, Inflated]:
    """Inflate a quarter tube, as long as its elements, and recover its stresses."""
    tube = wall_files.tube(folder, size=size, length=size, quarter=True)
    mesh = tube.mesh
    body = wall(mesh, kappa=KAPPA, quarter=True)
    patches = create_patches(mesh, tube.cell_tags)
    x = ufl.SpatialCoordinate(mesh)
    e_r = ufl.as_vector([x[0], x[1], 0.0]) / ufl.sqrt(x[0] ** 2 + x[1] ** 2)
    e_t = ufl.as_vector([-e_r[1], e_r[0], 0.0])
    F = kinematics.deformation_gradient(body.u)
    C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
    a1, a2 = (fibres(mesh, sign) for sign in (1.0, -1.0))
    psi = materials.holzapfel_gasser_ogden(C, a1, a2, c=3.0, k1=2.3632, k2=0.8393, J=J)
    sigma = kinematics.cauchy_stress(psi + materials.perturbed_lagrangian(J, body.p, KAPPA), F)
    normal = ufl.inv(F).T * e_r
    found = {}

    def report(step) -> None:
        if step.load not in pressures:
            return
        plain, split = (recovered_field(sigma, patches, normal=n) for n in (None, normal))
        truth = Truth(tube, step.load)
        errors = {
            name: tuple(truth.error(ufl.inner(e, s * e), i) for i, e in ((1, e_t), (0, e_r)))
            for name, s in (("raw", sigma), ("plain", plain), ("split", split))
        }
        hoop = components(split, {"hoop": e_t})
        means = layer_means(hoop, patches, tube.cell_tags, tube.layers, weight=J)
        p = recovered_field(body.p, patches)
        found[step.load] = Inflated(
            errors,
            {name: (mean["hoop"], truth.hoop(name)) for name, mean in means.items()},
            (truth.error(p, 2), truth.error(body.p, 2)),
        )

    follow_load(
        body.problem(4),
        lambda mmhg: setattr(body.load, "value", loads.mmhg(mmhg)),
        pressures,
        Steps(first=10.0, least=0.5, growth=2.0),
        state=[body.u, body.p],
        on_step=report,
    )
    return found


class Truth:
    """σ_rr, σ_θθ and p at the quadrature points of the owned cells."""

    def __init__(self, tube, mmhg: float) -> None:
        self.mesh = tube.mesh
        self.cells = np.arange(self.mesh.topology.index_map(3).size_local, dtype=np.int32)
        self.tube = inflate(mmhg * KPA_PER_MMHG, Oracle(kappa=KAPPA))
        self.points, weights = basix.make_quadrature(basix.CellType.tetrahedron, 4)
        x = ufl.SpatialCoordinate(self.mesh)
        r = self.at_points(ufl.sqrt(x[0] ** 2 + x[1] ** 2))
        size = self.at_points(abs(ufl.JacobianDeterminant(self.mesh)))
        self.weights = size * weights
        self.exact = np.zeros((3, *r.shape))
        for layer, name in zip(self.tube.wall.layers, ("media", "adventitia"), strict=True):
            cells = tube.cell_tags.find(tube.layers[name])
            cells = cells[cells < len(self.cells)]
            for exact, values in zip(self.exact, self.table(layer), strict=True):
                exact[cells] = extrapolated(*values, r[cells])

    def table(self, layer) -> Iterator[tuple[Array, Array]]:
        radii = np.linspace(layer.inner + 1e-9, layer.outer, 100)
        stress = np.array([self.tube.stress(R) for R in radii])
        pressure = np.array([KAPPA * (self.tube.jacobian(R) - 1) for R in radii])
        yield from ((radii, values) for values in (*stress.T, pressure))

    def hoop(self, name: str) -> float:
        """Mean of σ_θθ over a deformed layer."""
        layer = self.tube.wall.layers[("media", "adventitia").index(name)]
        radii = np.linspace(layer.inner + 1e-9, layer.outer, 400)
        r = np.array([self.tube.radius(R) for R in radii])
        stress = np.array([self.tube.stress(R)[1] for R in radii])
        return float(np.trapezoid(stress * r, r) / np.trapezoid(r, r))

    def at_points(self, expression: Expr) -> Array:
        values = dolfinx.fem.Expression(expression, self.points).eval(self.mesh, self.cells)
        return np.asarray(values).reshape(len(self.cells), len(self.points))

    def error(self, expression: Expr, i: int) -> float:
        difference = self.at_points(expression) - self.exact[i]
        squares = [(self.weights * f**2).sum() for f in (difference, self.exact[i])]
        error, norm = (COMM.allreduce(float(square)) for square in squares)
        return float(np.sqrt(error / norm))


def extrapolated(radii: Array, values: Array, r: Array) -> Array:
    """Interpolate, and go on straight below the first radius, where chords are."""
    slope = (values[1] - values[0]) / (radii[1] - radii[0])
    return np.interp(r, radii, values) + slope * np.minimum(r - radii[0], 0.0)


@pytest.fixture(scope="module")
def fine(tmp_path_factory) -> Callable[[float], Inflated]:
    folder = COMM.bcast(tmp_path_factory.mktemp("tube"))
    return inflated(folder, 0.09, [10.0, 100.0, 300.0]).__getitem__


@pytest.mark.parametrize(
    ("mmhg", "raw", "hoop", "radial"),
    [(10.0, (0.01, 0.025), 0.01, 0.015), (100.0, (0.14, 0.4), 0.06, 0.07), (300.0, (0.12, 0.55), 0.04, 0.08)],
)
def test_bounds(fine, mmhg, raw, hoop, radial):
    """At least ``raw`` inside the cells, at most the bounds where the stress is recovered."""
    errors = fine(mmhg).errors
    agree(errors["raw"][0] > raw[0] and errors["raw"][1] > raw[1], errors)
    agree(errors["split"][0] < hoop and errors["split"][1] < radial, errors)
    agree(errors["plain"][0] < 0.75 * errors["raw"][0], errors)
    small(errors["plain"][1] / errors["split"][1] - 1.0, 0.01)


@pytest.mark.parametrize("mmhg", [10.0, 100.0, 300.0])
def test_layer_means(fine, mmhg):
    for mean, exact in fine(mmhg).hoop.values():
        small(mean / exact - 1.0, 0.02)


@pytest.mark.parametrize("mmhg", [10.0, 100.0, 300.0])
def test_pressure(fine, mmhg):
    recovered, cellwise = fine(mmhg).pressure
    agree(recovered < 0.5 * cellwise, (recovered, cellwise))


def test_order_of_convergence(tmp_path):
    """About two at 10 mmHg, where the stresses inside the cells have one."""
    coarse, half = (inflated(tmp_path, size, [10.0])[10.0].errors for size in (0.13, 0.065))
    for i in range(2):
        raw, split = (np.log2(coarse[name][i] / half[name][i]) for name in ("raw", "split"))
        agree(raw < 1.2 and split > 1.8, (i, raw, split))
