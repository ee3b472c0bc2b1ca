# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Warnings of bad cells come once and in accepted states only; a diagnosis has remedies."""

from __future__ import annotations

import json
import logging

import numpy as np
import pytest
from collective import COMM, agree, logged_messages, small
from problems import dirichlet, left, owned
from strips import DISTORTED, INVERTED, ROWS, SOUND, Strip, volume_warnings

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem
from dolfinx_feti.diagnosis.cell_volumes import CLAMPED, REFINE, SECOND_ORDER
from dolfinx_feti.loading import Motion, Steps, TimeSteps, follow_load, follow_time, prestress


def test_warnings_come_once(caplog):
    """A strip compressed further causes one warning of distorted cells and one of inverted ones."""
    strip = Strip()
    for strain, expected in ((SOUND, 0), (DISTORTED, 1), (DISTORTED, 1), (INVERTED, 2)):
        strip.solve(strain)
        agree(len(volume_warnings(caplog)) == expected, volume_warnings(caplog))
    strip.solve(INVERTED + 1e-4)
    first, second = volume_warnings(caplog)
    agree("times its mean in" in first and "inside out" in second, (first, second))
    agree(f"in {2 * ROWS} cells" in second and "(0.667, 0.917)" in second, second)
    agree(second.endswith(REFINE) and "Stresses" in second, second)


def test_inverted_at_once(caplog):
    """After a warning of inverted cells there is none of distorted ones."""
    strip = Strip()
    for strain in (INVERTED, DISTORTED, INVERTED):
        strip.solve(strain)
    agree(
        len(volume_warnings(caplog)) == 1 and "inside out" in volume_warnings(caplog)[0],
        volume_warnings(caplog),
    )


def test_a_solve_need_not_look(caplog):
    """With ``check_cells=False`` a solve does not warn; warn_of_cells does."""
    strip = Strip()
    strip.place(strip.aim, INVERTED)
    strip.place(strip.u, INVERTED)
    strip.problem.solve(check_cells=False)
    agree(not volume_warnings(caplog))
    strip.problem.warn_of_cells()
    agree(len(volume_warnings(caplog)) == 1)


def test_load_steps_look_at_what_they_accept(caplog):
    """Load steps warn of cells in accepted states."""
    strip = Strip()
    seen = []
    follow_load(
        strip.problem,
        lambda strain: strip.place(strip.aim, strain),
        [SOUND, INVERTED],
        Steps(first=0.3, least=0.01),
        state=[strip.u],
        on_step=lambda step: seen.append((step.load, len(volume_warnings(caplog)))),
    )
    agree([count for load, count in seen if load <= SOUND] == [0] * 2, seen)
    agree(seen[-1] == (INVERTED, 2), seen)


def test_time_steps_do_not_look_at_what_they_refuse(caplog):
    """Inverted cells of a rejected time step cause no warning."""
    mesh = dolfinx.mesh.create_rectangle(COMM, [(0, 0), (2, 1)], (2, ROWS))
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    u = dolfinx.fem.Function(V)
    motion = Motion(u, density=1.0)
    problem = NonlinearProblem(
        Strip.density(u) * ufl.dx + motion.inertia,
        u,
        bcs=[dirichlet(V, left)],
        subdomains=4,
        quadrature_degree=4,
    )
    motion.velocity.interpolate(lambda x: np.stack([-0.1 * x[0] ** 2, 0 * x[1]]))
    looked = []
    solved = []
    warn_of_cells = problem.warn_of_cells
    solve = problem.solve

    def recorded_warn_of_cells():
        looked.append(warn_of_cells())

    def recorded_solve(**settings):
        solved.append(solve(**settings))

    problem.warn_of_cells = recorded_warn_of_cells
    problem.solve = recorded_solve
    steps = follow_time(
        problem,
        motion,
        lambda t: None,
        [0.1],
        TimeSteps(first=0.1, least=1e-4, tolerance=2e-5),
        state=[u],
    )
    agree(len(looked) == len(steps) < len(solved), (len(looked), len(steps), len(solved)))
    agree(not volume_warnings(caplog))


def lower(x):
    """Mark x₁ = 0."""
    return np.isclose(x[1], 0.0)


@pytest.mark.parametrize(("held", "clamped"), [(None, 0), (left, 2 * ROWS), (lower, 2)])
def test_diagnosis(held, clamped):
    """The diagnosis has a row for bad cells, and advice that depends on clamped boundaries."""
    strip = Strip(held=held)
    strip.place(strip.aim, INVERTED)
    strip.place(strip.u, INVERTED)
    found = strip.problem.diagnose()
    agree(found.volumes == strip.problem.cell_volumes())
    agree(found.volumes.clamped == clamped, found.volumes)
    texts = [advice.text for advice in found.advice]
    agree((CLAMPED in texts) == (clamped > 0), texts)
    agree((REFINE in texts) == (clamped < 2 * ROWS), texts)
    agree("inside out" in str(found) and str(found.volumes) in str(found), found)
    record = found.records[0]
    agree(json.loads(json.dumps(record)) == json.loads(json.dumps(record, allow_nan=False)))
    agree(record["volumes"]["inverted"] == 2 * ROWS, record["volumes"])


def test_advice_on_a_constant_pressure():
    """For inverted P2–P0 cells second-order elements are advised, and nothing if sound."""
    strip = Strip(pressure=True)
    strip.place(strip.u, INVERTED)
    texts = [advice.text for advice in strip.problem.diagnose().advice]
    agree(SECOND_ORDER in texts and REFINE not in texts, texts)
    strip.place(strip.u, SOUND)
    found = strip.problem.diagnose()
    agree(not {CLAMPED, REFINE, SECOND_ORDER} & {advice.text for advice in found.advice}, found)
    agree("det F is" in str(found), found)


def test_ratio_that_a_user_names(caplog):
    """A user's volume ratio that is no determinant is checked for its sign, under its name."""
    strip = Strip()
    named = 0.01 - strip.u[0]
    V = strip.u.function_space
    problem = NonlinearProblem(
        Strip.density(strip.u) * ufl.dx,
        strip.u,
        bcs=[dirichlet(V, left)],
        subdomains=4,
        quadrature_degree=4,
        volume_ratio=named,
    )
    strip.u.interpolate(lambda x: np.stack([0.004 * x[0], 0 * x[1]]))
    found = problem.cell_volumes()
    agree(found.is_sound and found.distorted == 0 and found.name == "volume_ratio", found)
    strip.u.interpolate(lambda x: np.stack([0.006 * x[0], 0 * x[1]]))
    found = problem.cell_volumes()
    agree(found.inverted > 0, found)
    with caplog.at_level(logging.WARNING):
        problem.warn_of_cells()
    said = logged_messages(caplog)
    agree(any("volume_ratio is" in text for text in said), said)


def test_prestressed_image(caplog):
    """Volume ratios of a prestressed strip are those of F G⁻¹, with u = 0."""
    mesh = dolfinx.mesh.create_rectangle(COMM, [(0, 0), (2, 1)], (2, 2))
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    u = dolfinx.fem.Function(V)
    load = dolfinx.fem.Constant(mesh, 0.0)
    G = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 1, (2, 2))))
    G.interpolate(lambda x: np.stack([1 + 0 * x[0], 0 * x[0], 0 * x[0], 1 + 0 * x[0]]))
    E = (ufl.Identity(2) + ufl.grad(u)) * ufl.inv(G)
    energy = (ufl.inner(E, E) - 2 * ufl.ln(ufl.det(E))) * ufl.dx - load * u[0] * ufl.dx
    problem = NonlinearProblem(
        energy, u, bcs=[dirichlet(V, left)], subdomains=2, quadrature_degree=4
    )

    def set_load(value):
        load.value = value

    prestress(problem, set_load, [0.4], Steps(first=0.2, least=0.05), G=G)
    small(np.abs(owned(u)).max(initial=0.0), 1e-7)
    found = problem.cell_volumes()
    agree(found.greatest > 1.05 and found.is_sound, found)
    agree(not volume_warnings(caplog))
