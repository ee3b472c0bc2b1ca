# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Options are read once, with defaults, checked values and names; the database stays as it is."""

import dataclasses
import re

from petsc4py import PETSc

import pytest
from collective import COMM, agree, equal, logged_messages, raises, whole
from ids import id_of
from problems import cube, elasticity, owned, poisson, torn

import dolfinx
import ufl

import dolfinx_feti
from dolfinx_feti import LinearProblem, NonlinearProblem
from dolfinx_feti.feti.options import CHOICES, OPTION_TYPES, FETIOptions, read_options
from dolfinx_feti.problems.solver_options import options_without_effect
from dolfinx_feti.runtime.petsc_options import inserted, require_prefix, withheld

COUNT_OPTIONS = [name for name, kind in OPTION_TYPES.items() if kind is int]
SHARE_OPTIONS = [name for name, kind in OPTION_TYPES.items() if kind is float]


def read_with(prefix="o_", **options):
    """Return FETI's options with others inserted under a prefix."""
    with inserted(prefix, options):
        return read_options(prefix)


def test_defaults_are_the_first_choices():
    """Without options all fields of FETIOptions have their defaults."""
    agree(read_with() == FETIOptions())
    fields = {field.name: field.default for field in dataclasses.fields(FETIOptions)}
    agree(len(fields) <= 12 and set(fields) == {*CHOICES, *COUNT_OPTIONS, *SHARE_OPTIONS})
    agree(all(fields[name] == choices[0] for name, choices in CHOICES.items()))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, value) for name, choices in CHOICES.items() for value in choices),
        *((name, number) for name in COUNT_OPTIONS for number in (0, 17)),
        *((name, share) for name in SHARE_OPTIONS for share in (0, 0.5)),
    ],
)
def test_every_option_is_read(name, value):
    """-feti_NAME sets the field NAME of FETIOptions."""
    options = read_with(**{f"feti_{name}": value})
    agree(options == dataclasses.replace(FETIOptions(), **{name: value}))


COUNT = "a whole number ≥ 0"
SHARE = "a number between 0 and 1"
BELOW_ONE = "a number ≥ 0 and < 1"

#: Options, wrong values, and what they are to be.
WRONG = [
    *((f"feti_{name}", "other", f"one of: .*{CHOICES[name][-1]}") for name in CHOICES),
    *((f"feti_{name}", wrong, COUNT) for name in COUNT_OPTIONS for wrong in (-1, "abc", 1.5)),
    *(
        (f"feti_{name}", wrong, SHARE)
        for name in SHARE_OPTIONS
        for wrong in (-0.1, 1.5, "nan", "abc")
    ),
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
MISSPELT_FOR_FETI = {
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
    *(
        ({n: 1}, f"-o_{n} does not exist; did you mean -o_{meant}")
        for n, meant in MISSPELT_FOR_FETI.items()
    ),
    *(({name: 1}, f"-o_{name} does not exist") for name in ("feti_nonsense_at_all", "feti_xyz")),
    ({"pc_type": "lu"}, "-o_pc_type is 'lu', but no preconditioner .*leave it out.*_feti_pc_t"),
    *(
        ({"feti_formulation": "primal", "feti_pc_type": kind}, f"primal and .*pc_type {kind} excl")
        for kind in ("lumped", "identity")
    ),
]


@pytest.mark.parametrize(
    ("options", "message"),
    [pytest.param(options, message, id=id_of(options, "options")) for options, message in REFUSED],
)
def test_wrong_options_are_refused_when_read(options, message):
    """The error lists the allowed values, or the nearest name."""
    with raises(ValueError, message):
        read_with(**options)


#: What is not FETI's own, and counts without a bound.
OTHER_OPTIONS = {
    "pc_type": "none",
    **dict.fromkeys(("ksp_max_it", "snes_max_it", "snes_max_funcs"), "unlimited"),
    **dict.fromkeys(("feti_dual_ksp_rtol", "ksp_rtol", "snes_rtol"), "0.1"),
    "feti_local_mat_mumps_icntl_14": "0.1",
    "feti_local_pc_type": "0.1",
    "feti_dirichlet_pc_factor_mat_solver_type": "0.1",
    "feti_coarse_ksp_type": "0.1",
    "feti_coarse_pc_type": "0.1",
}


@pytest.mark.parametrize(("name", "value"), OTHER_OPTIONS.items())
def test_options_of_other_solvers_are_ignored(name, value):
    """These are options of PETSc's sub-solvers, and all under another prefix."""
    with inserted("other_", {"feti_type": "classical", "feti_nonsense": 1}):
        agree(read_with(**{name: value}) == FETIOptions())


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
def test_wrong_options_are_refused_for_a_ksp_alone(by, name, wrong, message, torn_grid, lifetime):
    """If PETSc replaces the error by another, ours is its cause."""
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
    """A program with one KSP may use options without a prefix."""
    agree(read_with("", feti_type="classical").type == "classical")


@pytest.mark.parametrize("prefix", ["", None, 3, b"x_"])
def test_prefix_of_a_problem_must_not_be_empty(prefix):
    """Several problems of a program would share their options."""
    with raises(ValueError, "petsc_options_prefix is .*non-empty"):
        require_prefix(prefix)


def test_inserted_and_withheld_options_restore_the_database():
    """This holds after nested blocks and after an error in a block."""
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


def test_options_without_effect_are_found():
    """They choose another KSP, PC or SNES; FETI's and those it passes on are not among them."""
    others = {
        "ksp_type": "preonly",
        "pc_type": "lu",
        "pc_factor_mat_solver_type": "mumps",
        "mat_mumps_icntl_14": "80",
        "snes_type": "newtonls",
        "snes_linesearch_type": "bt",
    }
    used = {"feti_pc_type": "lumped", "feti_local_pc_type": "lu", "ksp_rtol": 1e-6, "snes_atol": 1}
    with inserted("o_", others | used), inserted("other_", {"ksp_type": "cg"}):
        agree(options_without_effect("o_") == others)
    with inserted("o_", {"ksp_type": "python", "snes_type": "python", "pc_type": "none"}):
        agree(options_without_effect("o_") == {})


def test_problems_read_only_options_of_their_prefix():
    """Options of a call take precedence over those of the command line.

    The database is left as it was.
    """
    problem = elasticity(cube(2, 4))
    with inserted("a_", {"feti_type": "classical", "feti_scaling": "multiplicity"}):
        before = PETSc.Options().getAll()
        call_options = {"feti_pc_type": "lumped", "feti_scaling": "stiffness", "ksp_rtol": 1e-9}
        first = torn(problem, 4, "a_", **call_options)
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


# -- options that nothing reads, and arguments that do not exist


def diffusion_problem(*, nonlinear, **options):
    """Return a linear or nonlinear problem of diffusion; options are PETSc's, without prefix."""
    body = poisson(cube(2, 5))
    common = {"bcs": body.bcs, "petsc_options_prefix": "unread_", "petsc_options": options}
    if not nonlinear:
        return LinearProblem(body.a, body.L, subdomains=4, **common)
    u = dolfinx.fem.Function(body.V)
    return NonlinearProblem(ufl.action(body.a, u) - body.L, u, subdomains=4, **common)


MISSPELT_IN_PROBLEMS = {
    "ksp_rtoll": "ksp_rtol",
    "kps_rtol": "ksp_rtol",
    "ksp_max_its": "ksp_max_it",
    "ksp_monitr": "ksp_monitor",
    "-ksp_rtol": "ksp_rtol",
    "unread_ksp_rtol": "ksp_rtol",
    "feti_dual_ksp_tpye": "feti_dual_ksp_type",
    "snes_rtoll": "snes_rtol",
}


@pytest.mark.parametrize("way", ["argument", "command line"])
@pytest.mark.parametrize("nonlinear", [False, True])
@pytest.mark.parametrize("name", MISSPELT_IN_PROBLEMS)
def test_misspelt_options_are_reported_once_with_the_nearest_name(name, nonlinear, way, caplog):
    """The warning follows the first solve, and the database is left as it was."""
    if way == "command line" and name in ("-ksp_rtol", "unread_ksp_rtol"):
        pytest.skip("on the command line the prefix is not put in front of it")
    command_line = {name: "1e-3"} if way == "command line" else {}
    arguments = {name: "1e-3"} if way == "argument" else {}
    with inserted("unread_", command_line):
        before = PETSc.Options().getAll()
        problem = diffusion_problem(nonlinear=nonlinear, ksp_rtol=1e-9, **arguments)
        for _ in range(2):
            problem.solve()
        problem.create_linear_solver().destroy()
        agree(PETSc.Options().getAll() == before)
    (warning,) = logged_messages(caplog)
    agree(
        f"-unread_{name} 1e-3: did you mean -unread_{MISSPELT_IN_PROBLEMS[name]}?" in warning,
        warning,
    )


def test_unknown_option_of_a_call_is_reported(caplog):
    """An unknown option of the command line may belong to another program part."""
    with inserted("unread_", {"other_thing": 1, "b_ksp_rtol": 1e-3}):
        diffusion_problem(nonlinear=False, colour="red").solve()
    (warning,) = logged_messages(caplog)
    agree("-unread_colour red: see docs/petsc_options.md" in warning, warning)
    agree("other_thing" not in warning and "b_ksp_rtol" not in warning, warning)


def test_options_that_are_read_cause_no_warning(caplog, tmp_path):
    """These are monitors, views, tolerances and options of sub-solvers."""
    file = f"ascii:{COMM.bcast(str(tmp_path))}/out"
    names = ("ksp_monitor", "ksp_view", "ksp_converged_reason", "ksp_view_solution")
    options = dict.fromkeys(names, file)
    options |= {"ksp_rtol": 1e-9, "ksp_atol": 1e-30, "ksp_max_it": 200}
    options |= {"feti_type": "classical", "feti_formulation": "dual", "feti_dual_ksp_type": "cg"}
    options |= {"feti_coarse_ksp_type": "preonly", "feti_coarse_q": "diagonal"}
    options |= {"ksp_error_if_not_converged": True}
    snes = dict.fromkeys(("snes_monitor", "snes_view", "snes_converged_reason"), file)
    snes |= {"snes_rtol": 1e-9, "snes_max_it": 20, "snes_error_if_not_converged": True}
    for nonlinear in (False, True):
        diffusion_problem(nonlinear=nonlinear, **options, **(snes if nonlinear else {})).solve()
    agree(logged_messages(caplog) == [])


WITHOUT_EFFECT = ["snes_mf", "snes_fd", "snes_lag_jacobian", "snes_stol", "snes_npc_side"]
WITHOUT_EFFECT += ["ksp_initial_guess_nonzero", "ksp_norm_type", "ksp_divtol", "ksp_min_it"]


@pytest.mark.parametrize("name", WITHOUT_EFFECT)
def test_options_that_petsc_reads_without_effect_are_reported(name, caplog):
    """PETSc does read them, but its solver is replaced by FETI or by our Newton's method."""
    value = {"snes_npc_side": "left", "ksp_norm_type": "none"}.get(name, 1)
    diffusion_problem(nonlinear=True, **{name: value}).solve()
    (warning,) = logged_messages(caplog)
    agree(f"Without effect: -unread_{name}" in warning, warning)


@pytest.mark.parametrize("prefix", ["", "o_"])
def test_misspelt_option_of_a_ksp_alone_is_reported(prefix, caplog, torn_grid, lifetime):
    """A KSP of the user's own warns once after its first solve, with or without a prefix."""
    A = torn_grid((2, 2), (3, 3)).A
    misspelt = {"ksp_rtoll": "1e-3", "feti_dual_ksp_maxit": 7, "ksp_rtol": 1e-6}
    with inserted(prefix, {**misspelt, "feti_type": "classical"}):
        ksp = lifetime.own(PETSc.KSP().create(COMM))
        ksp.setOptionsPrefix(prefix)
        ksp.setOperators(A)
        ksp.setType(PETSc.KSP.Type.PYTHON)
        ksp.setPythonContext(dolfinx_feti.FETI())
        ksp.setFromOptions()
        x, b = (lifetime.own(v) for v in A.createVecs())
        b.set(1.0)
        for _ in range(2):
            ksp.solve(b, x)
    warnings = [text for text in logged_messages(caplog) if "nothing has read" in text]
    agree(len(warnings) == 1, warnings)
    agree(f"-{prefix}ksp_rtoll 1e-3: did you mean -{prefix}ksp_rtol?" in warnings[0], warnings)
    agree(f"did you mean -{prefix}feti_dual_ksp_max_it?" in warnings[0], warnings)
    agree(
        f"-{prefix}feti_type" not in warnings[0] and f"-{prefix}ksp_rtol " not in warnings[0],
        warnings,
    )


@pytest.mark.parametrize(
    ("wrong", "nearest"),
    [
        ("subdomain", "subdomains"),
        ("petsc_option", "petsc_options"),
        ("petsc_options_prefx", "petsc_options_prefix"),
        ("bc", "bcs"),
        ("scalar", "scalars"),
        ("jit_option", "jit_options"),
    ],
)
@pytest.mark.parametrize("nonlinear", [False, True])
def test_misspelt_arguments_are_refused_with_the_nearest_name(wrong, nearest, nonlinear):
    """An argument unlike all others is refused with Python's own message."""
    body = poisson(cube(2, 2))
    u = dolfinx.fem.Function(body.V)
    problem_class = NonlinearProblem if nonlinear else LinearProblem
    forms = (ufl.action(body.a, u) - body.L, u) if nonlinear else (body.a, body.L)
    with raises(
        TypeError, rf"{problem_class.__name__}\(\) got .* '{wrong}'. Did you mean '{nearest}'\?"
    ):
        problem_class(*forms, **{wrong: None})
    with raises(TypeError, "got an unexpected keyword argument 'colour'$"):
        problem_class(*forms, colour="red")
