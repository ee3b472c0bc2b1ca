# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Options: defaults, choices, misspelt names, and the database as it was found."""

import dataclasses
import re

from petsc4py import PETSc

import pytest
from collective import COMM, agree, equal, raises, whole
from problems import cube, elasticity, owned, torn

import dolfinx_feti
from dolfinx_feti.feti.options import CHOICES, KINDS, FETIOptions, read_options
from dolfinx_feti.problems.solvers import options_without_effect
from dolfinx_feti.runtime.petsc_options import inserted, require_prefix, withheld

NUMBERS = [name for name, kind in KINDS.items() if kind is int]
SHARES = [name for name, kind in KINDS.items() if kind is float]


def read(prefix="o_", **options):
    with inserted(prefix, options):
        return read_options(prefix)


def test_defaults_are_those_of_the_class():
    agree(read() == FETIOptions())
    fields = {field.name: field.default for field in dataclasses.fields(FETIOptions)}
    agree(len(fields) <= 12 and set(fields) == {*CHOICES, *NUMBERS, *SHARES})
    agree(all(fields[name] == choices[0] for name, choices in CHOICES.items()))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, value) for name, choices in CHOICES.items() for value in choices),
        *((name, number) for name in NUMBERS for number in (0, 17)),
        *((name, share) for name in SHARES for share in (0, 0.5)),
    ],
)
def test_every_option_is_read(name, value):
    options = read(**{f"feti_{name}": value})
    agree(options == dataclasses.replace(FETIOptions(), **{name: value}))


COUNT, SHARE, BELOW_ONE = "a whole number ≥ 0", "a number between 0 and 1", "a number ≥ 0 and < 1"

#: Options, wrong values, and what they are to be.
WRONG = [
    *((f"feti_{name}", "other", f"one of: .*{CHOICES[name][-1]}") for name in CHOICES),
    *((f"feti_{name}", wrong, COUNT) for name in NUMBERS for wrong in (-1, "abc", 1.5)),
    *((f"feti_{name}", wrong, SHARE) for name in SHARES for wrong in (-0.1, 1.5, "nan", "abc")),
    ("ksp_rtol", "abc", BELOW_ONE),
    ("ksp_rtol", 1.0, BELOW_ONE),
    ("snes_rtol", -1e-3, BELOW_ONE),
    ("ksp_atol", "nan", "a number ≥ 0"),
    ("snes_stol", "small", "a number ≥ 0"),
    ("ksp_max_it", "1e3", COUNT),
    ("snes_max_it", -1, COUNT),
    ("feti_dual_ksp_rtol", "abc", BELOW_ONE),
    ("feti_dual_ksp_gmres_restart", "many", COUNT),
    ("feti_coarse_ksp_max_it", "few", COUNT),
]

#: Names of options that do not exist, and those that are meant.
MISSPELT = {
    "feti_pctype": "feti_pc_type",
    "feti_typ": "feti_type",
    "feti_coarse_qq": "feti_coarse_q",
    "feti_scalling": "feti_scaling",
    "feti_deflatoin": "feti_deflation",
    "feti_dul_ksp_type": "feti_dual_ksp",
    "feti_lags": "feti_lag",
    "feti_coarse_mode": "feti_coarse_modes",
}

REFUSED = [
    *(({name: wrong}, f"-o_{name} is '{wrong}'; it takes {what}") for name, wrong, what in WRONG),
    *(({n: 1}, f"-o_{n} does not exist; did you mean -o_{meant}") for n, meant in MISSPELT.items()),
    *(({name: 1}, f"-o_{name} does not exist") for name in ("feti_nonsense_at_all", "feti_xyz")),
    ({"pc_type": "lu"}, "-o_pc_type is 'lu', but no preconditioner .*leave it out.*_feti_pc_t"),
    *(
        ({"feti_formulation": "primal", "feti_pc_type": kind}, f"primal and .*pc_type {kind} excl")
        for kind in ("lumped", "identity")
    ),
]


@pytest.mark.parametrize(("options", "message"), REFUSED, ids=str)
def test_refused(options, message):
    """When the options are read, with what they may be."""
    with raises(ValueError, message):
        read(**options)


#: What is not FETI's own, and counts without a bound.
OTHERS = {
    "pc_type": "none",
    **dict.fromkeys(("ksp_max_it", "snes_max_it", "snes_max_funcs"), "unlimited"),
    **dict.fromkeys(("feti_dual_ksp_type", "feti_dual_ksp_rtol", "ksp_rtol", "snes_rtol"), "0.1"),
    "feti_local_mat_mumps_icntl_14": "0.1",
    "feti_local_pc_type": "0.1",
    "feti_dirichlet_pc_factor_mat_solver_type": "0.1",
    "feti_coarse_ksp_type": "0.1",
    "feti_coarse_pc_type": "0.1",
}


@pytest.mark.parametrize(("name", "value"), OTHERS.items())
def test_options_of_others_are_left_alone(name, value):
    with inserted("other_", {"feti_type": "classical", "feti_nonsense": 1}):
        agree(read(**{name: value}) == FETIOptions())


@pytest.mark.parametrize(
    ("by", "name", "wrong", "message"),
    [
        ("context", "ksp_rtol", "abc", "-o_ksp_rtol is 'abc'; it takes a number"),
        ("context", "pc_type", "lu", "-o_pc_type is 'lu'"),
        ("context", "feti_lag", "x", "-o_feti_lag is 'x'"),
        ("option", "pc_type", "lu", "-o_pc_type is 'lu'"),
        ("option", "feti_lag", "x", "-o_feti_lag is 'x'"),
    ],
)
def test_ksp_alone(by, name, wrong, message, torn_grid, lifetime):
    """Where PETSc turns the error into one of its own, ours is its cause."""
    ksp = lifetime.own(PETSc.KSP().create(COMM))
    ksp.setOptionsPrefix("o_")
    ksp.setOperators(torn_grid((2, 2), (3, 3)).A)
    types = {"ksp_type": "python", "ksp_python_type": "dolfinx_feti.FETI"}
    error = None
    try:
        with inserted("o_", {name: wrong} | (types if by == "option" else {})):
            if by == "context":
                ksp.setType(PETSc.KSP.Type.PYTHON)
                ksp.setPythonContext(dolfinx_feti.FETI())
            ksp.setFromOptions()
    except (ValueError, PETSc.Error) as caught:
        error = caught if isinstance(caught, ValueError) else caught.__cause__
    agree(isinstance(error, ValueError) and re.search(message, str(error)), repr(error))


def test_prefix_may_be_empty_for_a_solver_alone():
    agree(read("", feti_type="classical").type == "classical")


@pytest.mark.parametrize("prefix", ["", None, 3, b"x_"])
def test_prefix_of_a_problem_may_not(prefix):
    with raises(ValueError, "petsc_options_prefix is .*non-empty"):
        require_prefix(prefix)


def test_options_vanish_and_others_come_back():
    """Those that are inserted, and those that are withheld, also after an error."""
    database = PETSc.Options()
    with inserted("o_", {"feti_type": "classical", "kept": 7, "flag": None}):
        before = database.getAll()
        with inserted("o_", {"feti_type": "all_floating", "new": None, "ksp_rtol": 1e-3}):
            agree(database.getString("o_feti_type") == "all_floating")
            agree(database.hasName("o_new") and database.getReal("o_ksp_rtol") == 1e-3)
        agree(database.getAll() == before)
        with withheld(["o_feti_type", "o_flag", "o_other"]):
            agree(not {"o_feti_type", "o_flag"} & database.getAll().keys())
        agree(database.getAll() == before)
        for change in (inserted("o_", {"new": 1, "kept": 8}), withheld(["o_kept"])):
            with raises(RuntimeError, "on purpose"), change:
                raise RuntimeError("on purpose")
            agree(database.getAll() == before)


def test_options_of_another_solver():
    """Those that are without effect, and not those of FETI or of what it hands on."""
    others = {
        "ksp_type": "preonly",
        "pc_type": "lu",
        "pc_factor_mat_solver_type": "mumps",
        "mat_mumps_icntl_14": "80",
        "snes_type": "newtonls",
        "snes_linesearch_type": "bt",
    }
    own = {"feti_pc_type": "lumped", "feti_local_pc_type": "lu", "ksp_rtol": 1e-6, "snes_atol": 1}
    with inserted("o_", others | own), inserted("other_", {"ksp_type": "cg"}):
        agree(options_without_effect("o_") == others)
    with inserted("o_", {"ksp_type": "python", "snes_type": "python", "pc_type": "none"}):
        agree(options_without_effect("o_") == {})


def test_problems_share_the_command_line_and_no_options():
    """Options that the user has put under a prefix; those in the call take precedence.

    The database is left as it was.
    """
    problem = elasticity(cube(2, 4))
    with inserted("a_", {"feti_type": "classical", "feti_scaling": "multiplicity"}):
        before = PETSc.Options().getAll()
        given = {"feti_pc_type": "lumped", "feti_scaling": "stiffness", "ksp_rtol": 1e-9}
        first = torn(problem, 4, "a_", **given)
        second = torn(problem, 4, "b_", feti_pc_type="identity")
        for linear in (first, second):
            linear.solve()
            agree(PETSc.Options().getAll() == before)
    options, others = (each.solver.getPythonContext().report().options for each in (first, second))
    agree((options.type, options.scaling, options.pc_type) == ("classical", "stiffness", "lumped"))
    agree(others == dataclasses.replace(FETIOptions(), pc_type="identity"))
    agree([each.solver.getTolerances()[0] for each in (first, second)] == [1e-9, 1e-8])
    agree([each.solver.getOptionsPrefix() for each in (first, second)] == ["a_", "b_"])
    equal(whole(owned(first.u)), whole(owned(second.u)), 1e-6)
