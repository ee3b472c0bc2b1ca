# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What the linear study computes: errors, counts, condition numbers, and the effect of choices."""

from __future__ import annotations

from pathlib import Path

from petsc4py import PETSc

import numpy as np
import paper_cube
import pytest
from collective import COMM, agree, small
from linear_study import SMALL
from wall_files import on_first

from benchmarks.common.cube import PATTERNS

#: What a record has to hold, whatever else it holds.
KEYS = (
    "degree level type pc scaling gluing subdomains dofs_local_max dofs multipliers coarse_size "
    "iterations condition_number lambda_min lambda_max l2_error seconds_setup seconds_solve "
    "peak_mib"
).split()


def test_patterns_of_stiff_subcubes():
    place = np.stack(np.meshgrid(*3 * [np.arange(4)], indexing="ij"), axis=-1).reshape(-1, 3)
    stiff = {name: mark(place, 4).reshape(4, 4, 4) for name, mark in PATTERNS.items()}
    agree(not stiff["none"].any() and stiff["checkerboard"].sum() == 32)
    agree(not np.any(stiff["checkerboard"][1:] & stiff["checkerboard"][:-1]))
    agree(stiff["layer"].sum() == 16 and stiff["layer"][:, :, 2].all())


@pytest.mark.serial
@pytest.mark.parametrize(("degree", "levels"), [(1, (2, 3)), (2, (1, 2))])
def test_error_converges_to_the_fundamental_solution(degree, levels, study_of):
    """Order two for linear and three for quadratic elements."""
    level = ",".join(map(str, levels))
    status, records = study_of(*SMALL, "--degree", degree, "--level", level)
    agree(status == 0 and [r["level"] for r in records] == list(levels))
    coarse, fine = (r["l2_error"] for r in records)
    agree(np.log2(coarse / fine) > degree + 0.9, (coarse, fine))


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
def test_records_say_what_the_hand_torn_cube_says(kind, study_of, feti):
    """Two codes that share the solver alone agree on counts and on the condition number."""
    status, records = study_of("--subdomains-per-edge", "3", "--type", kind)
    agree(status == 0 and len(records) == 3)
    problem = paper_cube.cube(3, 1)
    for record in records:
        agree(set(KEYS) <= set(record), set(KEYS) - set(record))
        options = {"type": kind, "pc_type": record["pc"], "scaling": "multiplicity"}
        options |= {"coarse_q": "identity", "coarse_modes": 0, "dual_ksp_rtol": 1e-8}
        ksp = feti(problem.A, **{f"feti_{name}": value for name, value in options.items()})
        load = np.random.default_rng(5).standard_normal(len(problem.dirichlet))
        b = problem.vector(np.where(problem.dirichlet, load, 0.0))
        ksp.solve(b, problem.A.createVecRight())
        context = ksp.getPythonContext()
        found = context.report()
        agree(record["multipliers"] == found.multipliers)
        agree(record["coarse_size"] == found.coarse_size)
        agree(record["dofs"] == found.dofs and record["dofs_local_max"] == 45)
        agree(record["subdomains"] == 27 and record["kernels"] == list(found.kernels))
        small(record["condition_number"] / context.condition_number - 1.0, 0.02)
        small(record["lambda_max"] / record["lambda_min"] / record["condition_number"] - 1, 1e-12)
        if record["pc"] != "identity":
            agree(record["lambda_min"] > 1.0 - 1e-6, record["lambda_min"])
    problem.destroy()


def corners_and_edges(x: np.ndarray) -> np.ndarray:
    """Conditions on a cube of 3³ subcubes that leave kernels of all dimensions.

    A face of one subcube is clamped, and so an edge or a vertex of its neighbours; components are
    fixed in an edge of another one (two of them), and in two corners (one of them, and two).
    """
    face = (x[:, 0] == 0) & np.all(x <= 1, axis=1)
    mark = np.repeat(face[:, None], 3, axis=1)
    mark[(x[:, 0] == 3) & (x[:, 1] == 3) & (x[:, 2] <= 1), :2] = True
    mark[np.all(x == (3, 0, 0), axis=1), :2] = True
    mark[np.all(x == (3, 3, 3), axis=1), 0] = True
    return mark


def test_kernels_of_all_dimensions_in_one_decomposition(feti, tmp_path):
    """Theory bounds the eigenvalues from below by one, whatever is left of the rigid motions."""
    problem = paper_cube.cube(3, 1, fixed=corners_and_edges)
    options = {"type": "classical", "pc_type": "dirichlet", "scaling": "multiplicity"}
    options |= {"coarse_q": "identity", "coarse_modes": 0}
    ksp = feti(problem.A, **{f"feti_{name}": value for name, value in options.items()})
    load = np.random.default_rng(5).standard_normal(len(problem.dirichlet))
    b, x = problem.vector(load), problem.A.createVecRight()
    ksp.solve(b, x)
    context = ksp.getPythonContext()
    agree(context.report().kernels == (1, 2, 1, 1, 2, 1, 19), context.report().kernels)
    agree(context.eigenvalues[0] >= 1.0 - 1e-6, context.eigenvalues)
    small(context.residual, 1e-8)
    path = COMM.bcast(str(tmp_path / "view.txt"))
    viewer = PETSc.Viewer().createASCII(path, comm=COMM)
    ksp.view(viewer)
    viewer.destroy()
    said = on_first(Path(path).read_text)
    agree("1 of dimension 0, 2 of dimension 1, 1 of dimension 2, 1 of dimension 3" in said, said)
    agree("2 of dimension 4, 1 of dimension 5, 19 of dimension 6; 27 exact" in said, said)
    problem.destroy()


@pytest.mark.serial
def test_stiffness_scaling_and_weight_bear_a_jump(study_of):
    """Neither the scaling alone nor the weight Q alone does."""
    choices = ["--scaling", "multiplicity,stiffness", "--coarse-q", "identity,diagonal"]
    jump = ["--jump", "1e4", "--pattern", "layer", "--level", "2"]
    status, records = study_of(*SMALL, *choices, *jump)
    agree(status == 0 and all(r["l2_error"] is None for r in records))
    condition = {(r["scaling"], r["coarse_q"]): r["condition_number"] for r in records}
    bounded = condition.pop(("stiffness", "diagonal"))
    agree(bounded < 20.0 and min(condition.values()) > 10 * bounded, (bounded, condition))


@pytest.mark.serial
def test_reorthogonalisation_gives_the_same_condition_number(study_of):
    study_of(*SMALL, "--level", "2")
    _, records = study_of(*SMALL, "--level", "2", "--reorthogonalize")
    agree([r["reorthogonalize"] for r in records] == [False, True])
    plain, full = (r["condition_number"] for r in records)
    small(plain / full - 1.0, 1e-3)
