# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Recovered stresses of an inflated tube agree with semi-analytical ones: P2–P0, κ = 1000 kPa."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, small
from ufl_values import scalar

import dolfinx
import ufl

from benchmarks.common.verification.tube import STEPS
from benchmarks.common.walls.inflated_tube import InflatedTube, create_inflated_tube, create_slice
from benchmarks.common.walls.oracle import KPA_PER_MMHG, Tube, Wall, inflate
from dolfinx_feti.output import recovered_field

pytestmark = pytest.mark.serial  # on two, test_stress.py recovers from both

KAPPA = 1000.0


def inflated(size: float, pressures: list[float]) -> dict[float, dict[str, float]]:
    """Inflate a quarter tube, one element long, and return relative errors by pressure.

    They are those of σ_rr and σ_θθ inside the cells (``stress_``), recovered without a normal
    (``plain_``) and with it (``recovered_``), of the mean of σ_θθ over the media, and of p.
    """
    wall = create_slice(COMM, size=size)
    tube = create_inflated_tube(wall, c=3.0, kappa=KAPPA, subdomains=4)
    found = {}

    def report(step) -> None:
        if step.load not in pressures:
            return
        truth = inflate(step.load * KPA_PER_MMHG, Wall(kappa=KAPPA))
        plain = recovered_field(tube.body.stress, tube.patches)
        errors = tube.compare(truth) | tube.stress_errors(truth, plain, "plain")
        e = tube.frame[1]
        J = ufl.det(ufl.Identity(3) + ufl.grad(tube.body.u))
        hoop = ufl.inner(e, tube.recovered_stress * e) / ufl.inner(e, e)
        media = ufl.Measure("dx", subdomain_data=wall.cell_tags)(wall.layers["media"], degree=4)
        mean = scalar(hoop * J * media) / scalar(J * media)
        errors["mean"] = mean / mean_hoop(truth) - 1.0
        for name, p in (("p", tube.body.p), ("p*", recovered_field(tube.body.p, tube.patches))):
            errors[name] = pressure_error(tube, truth, p)
        found[step.load] = errors

    tube.body.inflate(pressures, STEPS, on_step=report)
    return found


def mean_hoop(truth: Tube) -> float:
    """Return the mean of σ_θθ over the deformed media [kPa]."""
    radii = np.linspace(truth.wall.layers[0].inner, truth.wall.layers[0].outer, 400)
    r = np.array([truth.radius(R) for R in radii])
    stress = np.array([truth.stress(R)[1] for R in radii])
    return float(np.trapezoid(stress * r, r) / np.trapezoid(r, r))


def pressure_error(tube: InflatedTube, truth: Tube, p: dolfinx.fem.Function) -> float:
    """Return the error of a pressure in the media, relative to p = κ (J − 1)."""
    radii = np.linspace(truth.wall.layers[0].inner, truth.wall.layers[0].outer, 100)
    exact = [KAPPA * (truth.jacobian(R) - 1) for R in radii]
    media = tube.layer == 0
    there = np.interp(tube.radii[media], radii, exact)
    weights = tube.weights[media]
    error, norm = ((weights * f**2).sum() for f in (tube.at_points(p)[media] - there, there))
    return float(np.sqrt(COMM.allreduce(error) / COMM.allreduce(norm)))


@pytest.fixture(scope="module")
def tube() -> dict[float, dict[str, float]]:
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
    """Recovered with the normal, errors of σ_θθ and σ_rr are at most ``hoop`` and ``radial``.

    Inside the cells they are larger than the numbers ``inside``. Recovered without a normal, the
    stress along the wall is less accurate, and tractions are the same.
    """
    errors = tube[mmhg]
    agree(errors["stress_tt_error"] > inside[0] and errors["stress_rr_error"] > inside[1], errors)
    agree(errors["recovered_tt_error"] < hoop and errors["recovered_rr_error"] < radial, errors)
    small(errors["plain_rr_error"] / errors["recovered_rr_error"] - 1.0, 0.01)
    agree(errors["recovered_tt_error"] < 0.75 * errors["plain_tt_error"], errors)
    agree(errors["plain_tt_error"] < 0.65 * errors["stress_tt_error"], errors)
    agree(errors["p*"] < 0.4 * errors["p"], errors)
    small(errors["mean"], 0.015)


def test_order_of_convergence():
    """Recovered stresses at 10 mmHg converge with about order two, those inside cells with one."""
    coarse, half = (inflated(size, [10.0])[10.0] for size in (0.13, 0.065))
    for component in ("tt", "rr"):
        inside, recovered = (
            np.log2(coarse[name] / half[name])
            for name in (f"stress_{component}_error", f"recovered_{component}_error")
        )
        agree(inside < 1.2 and recovered > 1.8, (component, inside, recovered))
