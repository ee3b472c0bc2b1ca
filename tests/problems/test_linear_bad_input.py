# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Bad input to LinearProblem: an error that names argument, value and remedy, on all processes."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, raises
from problems import Cell, Problem, cube, dirichlet, elasticity, left, poisson

import basix.ufl
import dolfinx
import ufl

import dolfinx_feti
from dolfinx_feti.runtime.petsc_options import inserted


def create(problem, **changes):
    arguments = {
        "bcs": problem.bcs,
        "subdomains": 4,
        "petsc_options_prefix": "bad_",
    }
    return dolfinx_feti.LinearProblem(problem.a, problem.L, **(arguments | changes))


# ---- subdomains -----------------------------------------------------------------------------


@pytest.mark.parametrize("subdomains", [0, -1, 33])
def test_number_of_subdomains(subdomains):
    problem = poisson(cube(2, 4))  # of 32 cells
    with raises(ValueError, f"subdomains is {subdomains}, but the mesh has 32 cells"):
        create(problem, subdomains=subdomains)


def test_parts_of_the_wrong_length():
    problem = poisson(cube(2, 4))
    with raises(ValueError, "subdomains has shape.*process.*owns"):
        create(problem, subdomains=np.zeros(problem.cells + 1, dtype=np.int32))


def test_parts_of_the_wrong_length_on_one_process():
    problem = poisson(cube(2, 4))
    with raises(ValueError, "subdomains"):
        create(problem, subdomains=np.zeros(problem.cells + (COMM.rank == 0), dtype=np.int32))


def test_parts_of_the_wrong_type():
    problem = poisson(cube(2, 4))
    with raises(TypeError, "float64.*integers"):
        create(problem, subdomains=np.zeros(problem.cells))


# ---- options --------------------------------------------------------------------------------


@pytest.mark.parametrize("prefix", ["", 7])
def test_empty_prefix(prefix):
    with raises(ValueError, "petsc_options_prefix"):
        create(poisson(cube(2, 4)), petsc_options_prefix=prefix)


def test_misspelt_option():
    with raises(ValueError, "-bad_feti_pctype.*did you mean -bad_feti_pc_type"):
        create(poisson(cube(2, 4)), petsc_options={"feti_pctype": "lumped"})


def test_value_that_is_no_choice():
    with raises(ValueError, "-bad_feti_scaling is 'deluxe'.*stiffness, multiplicity"):
        create(poisson(cube(2, 4)), petsc_options={"feti_scaling": "deluxe"})


@pytest.mark.parametrize(
    ("name", "wrong", "message"),
    [
        ("ksp_rtol", "abc", "-bad_ksp_rtol is 'abc'; it takes a number ≥ 0 and < 1"),
        ("ksp_max_it", "many", "-bad_ksp_max_it is 'many'; it takes a whole number"),
        ("ksp_norm_type", "foo", "PETSc refuses one of the options -bad_…: .*foo"),
    ],
)
def test_options_of_petsc_that_are_wrong(name, wrong, message):
    with raises(ValueError, message):
        create(poisson(cube(2, 4)), petsc_options={name: wrong})
    with inserted("bad_", {name: wrong}), raises(ValueError, message):  # from the command line
        create(poisson(cube(2, 4)))


def test_options_are_gone_after_an_error():
    before = PETSc.Options().getAll()
    with raises(ValueError, "deluxe"):
        create(
            poisson(cube(2, 4)), petsc_options={"feti_scaling": "deluxe", "feti_type": "classical"}
        )
    agree(PETSc.Options().getAll() == before)


# ---- spaces and forms -----------------------------------------------------------------------

ELEMENTS = {
    "H(div)": lambda cell: basix.ufl.element("RT", cell, 1),
    "H(curl)": lambda cell: basix.ufl.element("N1curl", cell, 1),
    "DG": lambda cell: basix.ufl.element("DG", cell, 1, shape=(2,)),
    "DG 0": lambda cell: basix.ufl.element("DG", cell, 0),
    "discontinuous Lagrange": lambda cell: basix.ufl.element("P", cell, 1, discontinuous=True),
    "Crouzeix-Raviart": lambda cell: basix.ufl.element("CR", cell, 1),
}


@pytest.mark.parametrize("element", ELEMENTS.values(), ids=ELEMENTS)
def test_elements_that_cannot_be_torn(element):
    mesh = cube(2, 3)
    V = dolfinx.fem.functionspace(mesh, element(mesh.basix_cell()))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    form = ufl.inner(u, v) * ufl.dx
    with raises(TypeError, "needs a continuous element, scalar or blocked: use .'Lagrange'"):
        create(Problem(V, form, ufl.inner(dolfinx.fem.Function(V), v) * ufl.dx, []))


def test_interior_facet_integrals():
    problem = poisson(cube(2, 4))
    u, v = ufl.TrialFunction(problem.V), ufl.TestFunction(problem.V)
    penalty = ufl.avg(u) * ufl.avg(v) * ufl.dS
    with raises(ValueError, "dS"):
        create(Problem(problem.V, problem.a + penalty, problem.L, problem.bcs))


def test_condition_on_another_space():
    problem = poisson(cube(2, 4))
    other = dolfinx.fem.functionspace(problem.V.mesh, ("Lagrange", 1))
    with raises(ValueError, r"bcs\[1\] lives on another function space"):
        create(problem, bcs=[*problem.bcs, dirichlet(other, left)])


def test_condition_on_a_component_of_another_space():
    problem = elasticity(cube(2, 4))
    other = dolfinx.fem.functionspace(problem.V.mesh, ("Lagrange", 1, (2,)))
    with raises(ValueError, r"bcs\[0\] lives on another function space"):
        create(problem, bcs=[dirichlet(other, left, component=1)])


def test_solution_on_another_space():
    problem = elasticity(cube(2, 4))
    other = dolfinx.fem.functionspace(problem.V.mesh, ("Lagrange", 2, (2,)))
    with raises(ValueError, "u lives on another function space"):
        create(problem, u=dolfinx.fem.Function(other))


def test_test_and_trial_function_of_different_spaces():
    mesh = cube(2, 4)
    V, W = (dolfinx.fem.functionspace(mesh, ("Lagrange", k)) for k in (1, 2))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(W)
    with raises(ValueError, "a has test and trial functions"):
        create(Problem(V, u * v * ufl.dx, 1.0 * ufl.TestFunction(V) * ufl.dx, []))


def test_load_on_another_space():
    problem = poisson(cube(2, 4))
    W = dolfinx.fem.functionspace(problem.V.mesh, ("Lagrange", 2))
    with raises(ValueError, "L has"):
        create(Problem(problem.V, problem.a, 1.0 * ufl.TestFunction(W) * ufl.dx, problem.bcs))


def test_forms_in_the_wrong_place():
    problem = poisson(cube(2, 4))
    with raises(ValueError, "a has"):
        create(Problem(problem.V, problem.L, problem.a, problem.bcs))


@pytest.mark.parametrize("scalar", [np.complex128, np.float32])
def test_other_scalar_types(scalar, monkeypatch):
    monkeypatch.setattr(PETSc, "ScalarType", scalar)
    problem = poisson(cube(2, 4))
    with raises(TypeError, f"{np.dtype(scalar)}.*real double precision"):
        create(problem)


def test_mesh_in_single_precision():
    mesh = dolfinx.mesh.create_unit_square(COMM, 3, 3, dtype=np.float32)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    with raises(TypeError, "float32.*float64"):
        create(Problem(V, u * v * ufl.dx, 1.0 * v * ufl.dx, []))


# ---- problems without a unique solution, and with the wrong method --------------------------


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
def test_no_condition_at_all(kind):
    linear = create(elasticity(cube(2, 4), clamped=None), petsc_options={"feti_type": kind})
    with raises(dolfinx_feti.ConvergenceError, "dimension 3.*Add Dirichlet conditions"):
        linear.solve()


def test_unsymmetric_matrix_with_cg():
    problem = poisson(cube(2, 6))
    u, v = ufl.TrialFunction(problem.V), ufl.TestFunction(problem.V)
    a = problem.a + 5.0 * u.dx(0) * v * ufl.dx
    linear = create(
        Problem(problem.V, a, problem.L, problem.bcs), petsc_options={"feti_dual_ksp_type": "cg"}
    )
    with raises(dolfinx_feti.ConvergenceError, "not symmetric.*-bad_feti_dual_ksp_type gmres"):
        linear.solve()


def test_error_leaves_no_object_behind():
    """__del__ copes with an __init__ that has raised."""
    problem = poisson(cube(2, 4, Cell.quadrilateral))
    for changes in ({"subdomains": 0}, {"petsc_options_prefix": ""}, {"bcs": [None]}):
        try:
            create(problem, **changes)
        except (AttributeError, ValueError):
            continue
        agree(False, changes)
