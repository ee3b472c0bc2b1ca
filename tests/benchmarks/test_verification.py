# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Verification in small: published numbers, the tube in closed form, inf-sup constants."""

from __future__ import annotations

import json

import numpy as np
import pytest
from collective import COMM, agree, small
from wall_files import on_first

import dolfinx
import ufl

from benchmarks.common.bodies import create_solid
from benchmarks.common.verification import inf_sup
from benchmarks.common.verification.cases import create_stressed_tube
from benchmarks.common.walls.inflated_tube import create_slice
from benchmarks.common.walls.oracle import KPA_PER_MMHG, Wall, inflate
from benchmarks.common.walls.problem import tube_fibres
from benchmarks.verification import STUDY
from dolfinx_feti import NonlinearProblem, loads, materials
from dolfinx_feti.loading import Steps, follow_load
from dolfinx_feti.meshes.ellipsoid import create_ellipsoid, ellipsoid_fibre
from dolfinx_feti.wall import Pressure, Slide, apply_conditions

pytest.importorskip("matplotlib")

COARSE = ["--part", "tube", "--size", "0.26", "--subdomains", "4"]


def inflated(*words: object) -> list[dict]:
    """Inflate a coarse tube; return a record for each pressure."""
    return STUDY.main([*COARSE, *map(str, words)])


@pytest.mark.serial
def test_records_and_their_page(tmp_path):
    """The coarsest beam is outside of the published spread, and the page says so."""
    path = tmp_path / "verification.json"
    words = ["--case", "land-1", "--mesh", "1", "--pair", "q2-p1d,q1-p0", "--cells", "2"]
    words += ["--part", "published,inf-sup", "--json", str(path)]
    first = STUDY.main(words)
    agree(STUDY.main(words) == first == json.loads(path.read_text()))
    small(first[0]["mumps"]["tip"] / first[0]["values"]["tip"] - 1, 1e-6)
    text = STUDY.write_page([path], tmp_path)
    agree("| 4.0 to 4.2 | 4 to 4.2 | 4.215 | **no** |" in text, text)
    agree("| Q2–P1disc | 0.395 | – | – | 0 |" in text, text)


def test_records_of_another_study_are_not_its_own():
    """Their fields may have the same names; only values of this study are accepted."""
    for field, own in (("case", "land-1"), ("element", "p2-p0"), ("pair", "q1-p0")):
        agree(STUDY.known({field: own}))
        agree(not any(STUDY.known({field: other}) for other in ("cube", 1, None, ["p2-p0"])))


@pytest.mark.serial
def test_one_displacement():
    """2³ cubes, Q1–P0: one node is free, and each component has one pattern of pressures ±1."""
    found = inf_sup.inf_sup_constant("q1-p0", 2)
    h = 0.5
    energy = 3 * (2 / h) * (2 * h / 3) ** 2  # ∫|∇φ|² of the node's hat function
    felt = h**2 / 4 * np.sqrt(8)  # ∫ ∂φ/∂x over a cell, times the root of the number of cells
    small(found["beta"] - felt / np.sqrt(energy) / np.sqrt(h**3), 1e-12)
    agree(found["spurious"] == 8 - 1 - 3 and found["displacements"] == 3)


@pytest.mark.serial
def test_stable_and_unstable_pairs():
    stable, locking = (inf_sup.inf_sup_constant(name, 2) for name in ("q2-p1d", "p2-p1d"))
    agree(stable["spurious"] == 0 and stable["beta"] > 0.3)
    agree(locking["spurious"] > locking["displacements"])


def integral(form: ufl.Form) -> float:
    return COMM.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(form)))


def test_ellipsoid():
    """The volume is π r_s² (z − z³/(3 r_l²)) between apex and base, outer minus inner."""
    mesh = create_ellipsoid(COMM, 2).mesh
    inner, outer = (
        np.pi * a**2 * (5 + b - (5**3 + b**3) / (3 * b**2)) for a, b in ((7, 17), (10, 20))
    )
    small(integral(1.0 * ufl.dx(mesh)) / (outer - inner) - 1, 1e-3)
    f = ellipsoid_fibre(mesh)
    x = ufl.SpatialCoordinate(mesh)
    length = integral((ufl.dot(f, f) - 1) ** 2 * ufl.dx(mesh, degree=4))
    small(length / (outer - inner), 1e-12)
    outwards = ufl.as_vector([x[0] / 8.5**2, x[1] / 8.5**2, x[2] / 18.5**2])  # of the middle
    across = ufl.dot(f, outwards) ** 2 / ufl.dot(outwards, outwards)
    small(integral(across * ufl.dx(mesh, degree=4)) / (outer - inner), 1e-2)


@pytest.mark.serial
def test_tube_with_opening_angles():
    """On a mesh coarser than the study's, u_r is within 0.2 % of theory, stresses within 3 %."""
    tube = create_stressed_tube(COMM, size=0.13)
    follow_load(tube.problem, tube.set_load, [1.0], Steps(0.02, least=1e-3), state=[tube.u, tube.p])
    found = tube.measure()
    small(found["u_r"] - 1, 2e-3)
    small(max(found["hoop"], found["radial"]), 3e-2)


@pytest.mark.serial
@pytest.mark.parametrize("mmhg", [0.0, 10.0])
def test_tube_that_is_pulled_and_inflated(mmhg):
    """Its ends are moved. Radii are within 1 % of theory, and far from those without a stretch."""
    wall = create_slice(COMM, size=0.26)
    tissue = materials.ArteryParameters()
    stretch = 1.15
    fibres = tube_fibres(wall.mesh)
    parameters = {"c": tissue.c, "k1": tissue.k1, "k2": tissue.k2}
    solid = create_solid(
        wall.mesh,
        lambda C, J: materials.holzapfel_gasser_ogden(C, *fibres, **parameters, J=J),
        kappa=1000.0,
        supports=[],
        pressures=("DG", 0),
    )
    ends = dict.fromkeys(("opening_1", "opening_2", "symmetry_x", "symmetry_y"), Slide())
    boundary = apply_conditions(wall, solid.u, {"lumen": Pressure()} | ends, axis="z")
    problem = NonlinearProblem(
        solid.energy + boundary.energy,
        solid.u,
        bcs=boundary.bcs,
        condense=solid.p,
        subdomains=2,
        petsc_options_prefix="pulled_",
        quadrature_degree=4,
    )
    for pulled, share in [(1.075, 0.0), (stretch, 0.0), *((stretch, i / 4) for i in range(1, 5))]:
        boundary.set_stretch(pulled)
        boundary.pressure.value = loads.mmhg(share * mmhg)
        problem.solve()
    X = solid.u.function_space.tabulate_dof_coordinates()
    u = solid.u.x.array.reshape(-1, 3)
    x = X + u
    top = np.isclose(X[:, 2], X[:, 2].max())
    small(np.abs(x[top, 2] / X[top, 2] - stretch).max(), 1e-9)
    theory, unpulled = (inflate(loads.mmhg(mmhg), Wall(kappa=1e3, stretch=λ)) for λ in (stretch, 1))
    for R in (0.71, 1.10):
        nodes = np.isclose(np.hypot(X[:, 0], X[:, 1]), R, rtol=1e-9)  # not on chords
        radii = np.hypot(x[nodes, 0], x[nodes, 1])
        error = abs(radii.mean() - theory.radius(R))
        agree(np.ptp(radii) <= 0.02 * R and error <= 0.01 * R, radii)
        agree(error <= 0.1 * abs(radii.mean() - unpulled.radius(R)))


def test_tube(tmp_path, capfd):
    """There is a record for each pressure, with costs from rest and the exact solution at its κ."""
    path = tmp_path / "new/tube.json"
    records = inflated("--pressures", "2,10", "--c", 4, "--kappa", 500, "--json", path)
    agree(on_first(lambda: json.loads(path.read_text())) == records and len(records) == 2)
    for record, pressure in zip(records, (2.0, 10.0), strict=True):
        agree(record.keys() >= {"size", "element", "degree", "subdomains", "augmented"}, record)
        agree((record["kappa"], record["c"], record["processes"]) == (500.0, 4.0, COMM.size))
        agree(record["pressure_mmhg"] == pressure, record)
        agree("cg" in record["linear_methods"], record)
        truth = inflate(pressure * KPA_PER_MMHG, Wall(c=4.0, kappa=500.0))
        for name, exact in (
            ("u_r_inner", truth.inner_displacement),
            ("thickness", truth.thickness),
            ("mean_J", truth.mean_jacobian),
        ):
            small(record[f"{name}_exact"] / exact - 1.0, 1e-12)
            small(record[name] / exact - 1.0, 0.03)
        agree(0.5 < record["min_J"] < record["mean_J"] < record["max_J"] < 1.5)
        agree(0.0 < record["stress_tt_error"] < 0.3 and 0.0 < record["stress_rr_error"] < 0.6)
        small(record["max_linear_ratio"], 1.0)
    for name in ("steps", "newton_iterations", "linear_iterations"):
        agree(0 < records[0][name] < records[1][name], "counted from rest")
    said = capfd.readouterr().out
    lines = 2 if COMM.rank == 0 else 0
    agree(said.count('"pressure_mmhg": ') == said.count("\n") == lines, said)


@pytest.mark.serial
def test_second_order_elements():
    """At κ = 1e5, and with no more dofs than P2–P0."""
    words = ("--pressures", 10, "--kappa", 1e5)
    record, old = (inflated(*words, "--element", e)[-1] for e in ("q2-p1d", "p2-p0"))
    agree(record["u_r_inner_error"] <= 5e-4 and 0.98 <= record["min_J"] <= record["max_J"] <= 1.02)
    for name in ("recovered_rr_error", "recovered_tt_error"):
        agree(record[name] <= 0.5 * old[name], (name, record[name], old[name]))


@pytest.mark.serial
def test_multipliers_keep_the_volume():
    """The mean of J in each cell stays at one."""
    (record,) = inflated("--pressures", 4, "--augmented")
    agree(record["volume_change"] <= 1e-6 and record["updates"] > 1, record)
    small(record["mean_J"] - 1.0, 1e-6)
