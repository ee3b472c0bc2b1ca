# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Options: defaults, choices, misspelt names, and the database as it was found."""

from __future__ import annotations

import dataclasses

from petsc4py import PETSc

import numpy as np
import pytest
from collective import agree, equal, raises, whole
from problems import cube, elasticity, owned, poisson

import dolfinx_feti
from dolfinx_feti.feti.options import CHOICES, NUMBERS, SHARES, FETIOptions, read_options
from dolfinx_feti.petsc_options import inserted, require_prefix


def read(prefix="o_", **options):
    with inserted(prefix, options):
        return read_options(prefix)


def test_defaults_are_those_of_the_class():
    agree(read() == FETIOptions())
    fields = {field.name: field.default for field in dataclasses.fields(FETIOptions)}
    expected = {name: choices[0] for name, choices in CHOICES.items()}
    agree(fields == expected | NUMBERS | SHARES)


@pytest.mark.parametrize(
    ("name", "value"), [(name, value) for name, choices in CHOICES.items() for value in choices]
)
def test_every_choice_is_read(name, value):
    options = read(**{f"feti_{name}": value})
    agree(options == dataclasses.replace(FETIOptions(), **{name: value}))


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_are_read(name):
    agree(getattr(read(**{f"feti_{name}": 17}), name) == 17)
    agree(getattr(read(**{f"feti_{name}": 0}), name) == 0)
    with raises(ValueError, f"-o_feti_{name} is -1"):
        read(**{f"feti_{name}": -1})


@pytest.mark.parametrize("name", SHARES)
def test_shares_are_read(name):
    agree(getattr(read(**{f"feti_{name}": 0.5}), name) == 0.5)
    agree(getattr(read(**{f"feti_{name}": 0}), name) == 0.0)
    for wrong in (-0.1, 1.5, "nan"):
        with raises(ValueError, f"-o_feti_{name} is {wrong}; it takes a number between 0 and 1"):
            read(**{f"feti_{name}": wrong})


@pytest.mark.parametrize("name", CHOICES)
def test_other_values_are_refused(name):
    with raises(ValueError, f"-o_feti_{name} is 'other'.*{CHOICES[name][-1]}"):
        read(**{f"feti_{name}": "other"})


@pytest.mark.parametrize(
    ("wrong", "meant"),
    [
        ("feti_pctype", "-o_feti_pc_type"),
        ("feti_typ", "-o_feti_type"),
        ("feti_coarse_qq", "-o_feti_coarse_q"),
        ("feti_scalling", "-o_feti_scaling"),
        ("feti_glueing", "-o_feti_gluing"),
        ("feti_dul_ksp_type", "-o_feti_dual_ksp"),
        ("feti_stagnations", "-o_feti_stagnation"),
        ("feti_dual_recycles", "-o_feti_dual_recycle"),
    ],
)
def test_misspelt_options_are_refused_with_a_guess(wrong, meant):
    with raises(ValueError, f"-o_{wrong} does not exist; did you mean {meant}"):
        read(**{wrong: "x"})


@pytest.mark.parametrize("name", ["feti_nonsense_at_all", "feti_xyz"])
def test_unknown_options_are_refused(name):
    with raises(ValueError, f"-o_{name} does not exist"):
        read(**{name: "x"})


@pytest.mark.parametrize(
    "name",
    [
        "feti_dual_ksp_type",
        "feti_dual_ksp_rtol",
        "feti_local_mat_mumps_icntl_14",
        "feti_local_pc_type",
        "feti_dirichlet_pc_factor_mat_solver_type",
        "feti_coarse_ksp_type",
        "feti_coarse_pc_type",
        "ksp_rtol",
        "snes_rtol",
    ],
)
def test_options_of_others_are_left_alone(name):
    agree(read(**{name: "1"}) == FETIOptions())


def test_options_of_another_prefix_are_left_alone():
    with inserted("other_", {"feti_type": "classical", "feti_nonsense": 1}):
        agree(read() == FETIOptions())


def test_prefix_may_be_empty_for_a_solver_alone():
    agree(read("", feti_type="classical").type == "classical")


@pytest.mark.parametrize("prefix", ["", None, 3, b"x_"])
def test_prefix_of_a_problem_may_not(prefix):
    with raises(ValueError, "petsc_options_prefix is .*non-empty"):
        require_prefix(prefix)


def test_inserted_options_vanish_and_others_come_back():
    database = PETSc.Options()
    database.setValue("o_feti_type", "classical")
    database.setValue("o_kept", "7")
    before = database.getAll()
    with inserted("o_", {"feti_type": "all_floating", "flag": None, "ksp_rtol": 1e-3}):
        agree(database.getString("o_feti_type") == "all_floating")
        agree(database.hasName("o_flag") and database.getReal("o_ksp_rtol") == 1e-3)
    agree(database.getAll() == before)
    with raises(RuntimeError, "on purpose"), inserted("o_", {"new": 1, "kept": 8}):
        raise RuntimeError("on purpose")
    agree(database.getAll() == before)
    database.delValue("o_feti_type")
    database.delValue("o_kept")


def test_problem_takes_its_options_and_leaves_the_database():
    problem = elasticity(cube(2, 4))
    before = PETSc.Options().getAll()
    linear = dolfinx_feti.LinearProblem(
        problem.a,
        problem.L,
        bcs=problem.bcs,
        subdomains=4,
        petsc_options_prefix="mine_",
        petsc_options={"feti_type": "classical", "feti_pc_type": "lumped", "ksp_rtol": 1e-5},
    )
    agree(PETSc.Options().getAll() == before)
    linear.solve()
    agree(PETSc.Options().getAll() == before)
    options = linear.solver.getPythonContext().report().options
    agree((options.type, options.pc_type) == ("classical", "lumped"))
    agree(linear.solver.getTolerances()[0] == 1e-5)
    agree(linear.solver.getOptionsPrefix() == "mine_")


def test_command_line_serves_the_problem_too():
    """Options that the user has put under the prefix; those in the call take precedence."""
    problem = poisson(cube(2, 4))
    with inserted("mine_", {"feti_type": "classical", "feti_gluing": "nonred"}):
        linear = dolfinx_feti.LinearProblem(
            problem.a,
            problem.L,
            bcs=problem.bcs,
            subdomains=4,
            petsc_options_prefix="mine_",
            petsc_options={"feti_gluing": "full"},
        )
        linear.solve()
    options = linear.solver.getPythonContext().report().options
    agree((options.type, options.gluing) == ("classical", "full"))


def test_two_problems_do_not_share_options():
    problem = poisson(cube(2, 4))
    first, second = (
        dolfinx_feti.LinearProblem(
            problem.a,
            problem.L,
            bcs=problem.bcs,
            subdomains=4,
            petsc_options_prefix=prefix,
            petsc_options={"feti_pc_type": pc_type},
        )
        for prefix, pc_type in (("a_", "lumped"), ("b_", "identity"))
    )
    first.solve()
    second.solve()
    agree(first.solver.getPythonContext().report().options.pc_type == "lumped")
    agree(second.solver.getPythonContext().report().options.pc_type == "identity")
    equal(whole(owned(first.u)), whole(owned(second.u)), 1e-6)
    agree(np.all(np.isfinite(owned(first.u))))
