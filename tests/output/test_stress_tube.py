# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Recovered stresses of the inflated tube beside its semi-analytical ones, P2–P0, κ = 1000 kPa."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pytest
from collective import COMM, agree, small

import dolfinx
import ufl

from benchmarks.common.verification.tube import STEPS
from benchmarks.common.walls.inflated_tube import InflatedTube, create_inflated_tube, create_slice
from benchmarks.common.walls.oracle import KPA_PER_MMHG, Tube, Wall, inflate
from dolfinx_feti.output import recovered_field

pytestmark = pytest.mark.serial  # on two, test_stress.py recovers from both

KAPPA = 1000.0


@dataclass(frozen=True, slots=True)
class Found:
    """What is compared at a pressure.

    Attributes:
        errors: Of σ_rr and σ_θθ, those of the stress inside the cells (``stress_``), of the
            recovered one without a normal (``plain_``) and with it (``recovered_``).
        hoop: Mean of σ_θθ over the deformed media, and the truth [kPa].
        pressure: Errors of p and of the recovered pressure.
    """

    errors: Mapping[str, float]
    hoop: tuple[float, float]
    pressure: tuple[float, float]


def inflated(size: float, pressures: list[float]) -> dict[float, Found]:
    """Inflate a quarter tube, as long as its elements, and recover its stresses."""
    wall = create_slice(COMM, size=size)
    tube = create_inflated_tube(wall, c=3.0, kappa=KAPPA, subdomains=4)
    found = {}

    def report(step) -> None:
        if step.load in pressures:
            truth = inflate(step.load * KPA_PER_MMHG, Wall(kappa=KAPPA))
            plain = recovered_field(tube.body.stress, tube.patches)
            errors = tube.compare(truth) | tube.stress_errors(truth, plain, "plain")
            e, J = tube.frame[1], ufl.det(ufl.Identity(3) + ufl.grad(tube.body.u))
            hoop = ufl.inner(e, tube.recovered_stress * e) / ufl.inner(e, e)
            media = ufl.Measure("dx", subdomain_data=wall.cell_tags)(wall.layers["media"], degree=4)
            forms = (dolfinx.fem.form(f * J * media) for f in (hoop, 1))
            total, volume = (COMM.allreduce(dolfinx.fem.assemble_scalar(form)) for form in forms)
            mean = (total / volume, mean_hoop(truth))
            found[step.load] = Found(errors, mean, pressure_errors(tube, truth))

    tube.body.inflate(pressures, STEPS, on_step=report)
    return found


def mean_hoop(truth: Tube) -> float:
    """Mean of σ_θθ over the deformed media [kPa]."""
    media = truth.wall.layers[0]
    radii = np.linspace(media.inner, media.outer, 400)
    r = np.array([truth.radius(R) for R in radii])
    stress = np.array([truth.stress(R)[1] for R in radii])
    return float(np.trapezoid(stress * r, r) / np.trapezoid(r, r))


def pressure_errors(tube: InflatedTube, truth: Tube) -> tuple[float, float]:
    """Errors in the media, relative to the truth p = κ (J − 1)."""
    media = truth.wall.layers[0]
    radii = np.linspace(media.inner, media.outer, 100)
    exact = [KAPPA * (truth.jacobian(R) - 1) for R in radii]
    weights = tube.weights[tube.layer == 0]
    there = np.interp(tube.radii[tube.layer == 0], radii, exact)

    def norm(values) -> float:
        return np.sqrt(COMM.allreduce(float((weights * values**2).sum())))

    fields = (tube.body.p, recovered_field(tube.body.p, tube.patches))
    values = [tube.at_points(p)[tube.layer == 0] for p in fields]
    return tuple(norm(p - there) / norm(there) for p in values)


@pytest.fixture(scope="module")
def tube() -> dict[float, Found]:
    return inflated(0.09, [10.0, 100.0, 300.0])


@pytest.mark.parametrize(
    ("mmhg", "inside", "hoop", "radial"),
    [
        (10.0, (0.018, 0.03), 0.009, 0.014),
        (100.0, (0.15, 0.43), 0.06, 0.075),
        (300.0, (0.13, 0.6), 0.035, 0.08),
    ],
)
def test_bounds(tube, mmhg, inside, hoop, radial):
    """With the normal below these errors of σ_θθ and σ_rr; ``inside`` the cells they are larger."""
    errors = tube[mmhg].errors
    agree(errors["stress_tt_error"] > inside[0] and errors["stress_rr_error"] > inside[1], errors)
    agree(errors["recovered_tt_error"] < hoop and errors["recovered_rr_error"] < radial, errors)


@pytest.mark.parametrize("mmhg", [10.0, 100.0, 300.0])
def test_without_a_normal(tube, mmhg):
    """Tractions on the wall are the same, the stress along it is less accurate."""
    errors = tube[mmhg].errors
    small(errors["plain_rr_error"] / errors["recovered_rr_error"] - 1.0, 0.01)
    agree(errors["recovered_tt_error"] < 0.75 * errors["plain_tt_error"], errors)
    agree(errors["plain_tt_error"] < 0.65 * errors["stress_tt_error"], errors)


@pytest.mark.parametrize("mmhg", [10.0, 100.0, 300.0])
def test_pressure_and_mean(tube, mmhg):
    inside, recovered = tube[mmhg].pressure
    agree(recovered < 0.4 * inside, (recovered, inside))
    mean, exact = tube[mmhg].hoop
    small(mean / exact - 1.0, 0.015)


def test_order_of_convergence():
    """About two at 10 mmHg, where the stresses inside the cells have one."""
    coarse, half = (inflated(size, [10.0])[10.0].errors for size in (0.13, 0.065))
    for component in ("tt", "rr"):
        inside, recovered = (
            np.log2(coarse[name] / half[name])
            for name in (f"stress_{component}_error", f"recovered_{component}_error")
        )
        agree(inside < 1.2 and recovered > 1.8, (component, inside, recovered))
