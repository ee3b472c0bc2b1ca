# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Bad input to NonlinearProblem: an error that names it and what helps, on all processes."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, raises
from walls import Wall, clamped, tube, wall

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti import ConvergenceError, NonlinearProblem, kinematics, materials


@pytest.fixture(scope="module")
def body() -> Wall:
    """A small wall of P1–P0 elements; no test moves it."""
    return wall(tube(around=6, along=1), degree=1)


def create(body: Wall, **changes: object) -> NonlinearProblem:
    """Make a problem that is all right but for the changes."""
    arguments = {
        "F": [body.F_u, body.F_p],
        "u": body.u,
        "bcs": body.bcs,
        "condense": body.p,
        "subdomains": 2,
        "petsc_options_prefix": "bad_",
    }
    return NonlinearProblem(**(arguments | changes))


def space(body: Wall, *element: object) -> dolfinx.fem.FunctionSpace:
    """Make another space on the mesh of the wall."""
    element = element[0] if len(element) == 1 else element
    return dolfinx.fem.functionspace(body.u.function_space.mesh, element)


def solid(body: Wall) -> tuple[ufl.core.expr.Expr, ufl.core.expr.Expr]:
    """Return an energy without a pressure, and det F."""
    F = kinematics.deformation_gradient(body.u)
    J = kinematics.jacobian(F)
    return materials.neo_hookean(kinematics.right_cauchy_green(F), c=3.0, J=J), J


def test_nothing_is_wrong(body):
    """The other tests fail for the reason that they change, and for no other."""
    create(body)


# ---- forms ----------------------------------------------------------------------------------


def test_rank_of_the_residual(body):
    du, v = ufl.TrialFunction(body.u.function_space), ufl.TestFunction(body.u.function_space)
    with raises(ValueError, "F has 2 arguments: give a residual or an energy"):
        create(body, F=ufl.inner(du, v) * ufl.dx, condense=None)
    with raises(ValueError, "F has 1 arguments: .*the pair of its residuals"):
        create(body, F=body.F_u)


def test_number_of_residuals(body):
    with raises(ValueError, "F is a sequence of 2 forms: .*condense=p"):
        create(body, condense=None)
    with raises(ValueError, "F is a sequence of 3 forms: give a residual .* and one for"):
        create(body, F=[body.F_u, body.F_p, body.F_p])
    with raises(ValueError, "F is a sequence of 2 forms: give a residual "):
        create(body, F=[body.energy, body.F_p])


def test_residuals_in_the_wrong_order(body):
    with raises(ValueError, "residuals on other spaces: test them with v in V and q in Q"):
        create(body, F=[body.F_p, body.F_u])


@pytest.mark.parametrize("degree", [1, 2])
def test_test_function_of_another_space(body, degree):
    v = ufl.TestFunction(space(body, "Lagrange", degree, (3,)))
    with raises(ValueError, "F has a test or trial function on another function space than u"):
        create(body, F=ufl.inner(body.u, v) * ufl.dx, condense=None)


def test_tangent(body):
    V = space(body, "Lagrange", 2, (3,))
    with raises(ValueError, "J has 1 test and trial functions, but takes 2"):
        create(body, J=body.F_u)
    with raises(ValueError, "J has a test or trial function on another function space than u"):
        create(body, J=ufl.inner(ufl.TrialFunction(V), ufl.TestFunction(V)) * ufl.dx)


def test_unknown_that_does_not_occur(body):
    v = ufl.TestFunction(body.u.function_space)
    one = dolfinx.fem.Constant(body.u.function_space.mesh, 1.0)
    for F in (one * ufl.dx, ufl.inner(ufl.as_vector([0.0, 0.0, one]), v) * ufl.dx):
        with raises(ValueError, "unknown 'u' does not occur in F"):
            create(body, F=F, condense=None)


def test_interior_facets(body):
    psi, _ = solid(body)
    inside = ufl.inner(ufl.jump(ufl.grad(body.u)), ufl.jump(ufl.grad(body.u))) * ufl.dS
    with raises(ValueError, r"interior-facet integrals, .*use a form with dx and ds only"):
        create(body, F=psi * ufl.dx + inside, condense=None)
    q = ufl.TestFunction(body.p.function_space)
    stabilised = body.F_p + ufl.jump(body.p) * ufl.jump(q) * ufl.dS
    with raises(ValueError, r"interior-facet integrals"):
        create(body, F=[body.F_u, stabilised])


# ---- the condensed pressure -----------------------------------------------------------------


@pytest.mark.parametrize("element", [("Lagrange", 1), ("DG", 0, (3,)), ("CR", 1), ("RT", 1)])
def test_space_of_the_pressure(body, element):
    p = dolfinx.fem.Function(space(body, *element), name="π")
    with raises(TypeError, r"condense is 'π' with the element .*use a discontinuous element"):
        create(body, condense=p)


def test_condensed_fields(body):
    p, u = body.p, body.u
    with raises(ValueError, r"condense\[1\] is 'p', which is the unknown or given twice"):
        create(body, condense=[p, p])
    with raises(ValueError, r"condense\[0\] is 'u', which is the unknown"):
        create(body, condense=u)
    with raises(TypeError, r"condense\[0\] is 7: give a dolfinx.fem.Function"):
        create(body, condense=[7])
    other = dolfinx.mesh.create_unit_cube(COMM, 2, 2, 2)
    elsewhere = dolfinx.fem.Function(dolfinx.fem.functionspace(other, ("DG", 0)), name="q")
    with raises(ValueError, "condense is 'q' on another mesh than the unknown"):
        create(body, condense=elsewhere)
    θ = dolfinx.fem.Function(p.function_space, name="θ")
    with raises(ValueError, "F is a sequence of 2 forms: .* one for each condensed field"):
        create(body, F=[body.F_u, body.F_p], condense=[θ, p])


def test_pressure_that_does_not_occur(body):
    p = dolfinx.fem.Function(body.p.function_space, name="other")
    for F in (body.energy, [body.F_u, body.F_p]):
        with raises(ValueError, "condense is 'other', which does not occur in the energy"):
            create(body, F=F, condense=p)


def test_pressure_without_a_term_of_its_own(body):
    """A Lagrange multiplier, as for an incompressible wall, has no diagonal to divide by."""
    psi, J = solid(body)
    with raises(ValueError, r"K_pp of 'p' is zero: .*such as p \(J − 1\) − p²/\(2κ\)"):
        create(body, F=(psi + body.p * (J - 1)) * ufl.dx)
    with raises(ValueError, "K_up is zero"):
        create(body, F=(psi + body.p**2) * ufl.dx)


# ---- spaces, conditions, decomposition, options ---------------------------------------------


@pytest.mark.parametrize("element", [("RT", 1), ("N1curl", 1), ("DG", 1, (3,)), ("DG", 0, (3,))])
def test_space_of_the_unknown(body, element):
    u = dolfinx.fem.Function(space(body, *element))
    with raises(TypeError, "tearing needs a continuous element"):
        create(body, F=ufl.inner(u, u) * ufl.dx, u=u, bcs=[], condense=None)


def test_mixed_space(body):
    P2 = basix.ufl.element("P", "tetrahedron", 2, shape=(3,))
    P1 = basix.ufl.element("P", "tetrahedron", 1)
    u = dolfinx.fem.Function(space(body, basix.ufl.mixed_element([P2, P1])))
    with raises(
        TypeError, "mixed element of 2, but only .* is torn. Condense a discontinuous pressure"
    ):
        create(body, F=ufl.inner(u, u) * ufl.dx, u=u, bcs=[], condense=None)


@pytest.mark.parametrize("degree", [1, 2])
def test_conditions_on_another_space(body, degree):
    bcs = clamped(space(body, "Lagrange", degree, (3,)))
    with raises(ValueError, r"bcs\[0\] lives on another function space than the unknown"):
        create(body, bcs=bcs)


def test_subdomains(body):
    n = body.p.function_space.dofmap.index_map.size_local
    cells = COMM.allreduce(n)
    with raises(ValueError, f"subdomains is {cells + 1}, but the mesh has {cells} cells"):
        create(body, subdomains=cells + 1)
    with raises(ValueError, "subdomains has shape"):
        create(body, subdomains=np.zeros(n + (COMM.rank == 0), dtype=np.int64))
    with raises(TypeError, "integers"):
        create(body, subdomains=np.zeros(n))


@pytest.mark.parametrize("prefix", ["", 7])
def test_prefix(body, prefix):
    with raises(ValueError, "petsc_options_prefix is .*non-empty string"):
        create(body, petsc_options_prefix=prefix)


def test_options(body):
    for options, message in (
        ({"feti_typ": "classical"}, "-bad_feti_typ does not exist; did you mean -bad_feti_type"),
        ({"feti_type": "all_flotting"}, "takes one of: all_floating, classical"),
        ({"ksp_rtol": "abc"}, "-bad_ksp_rtol is 'abc'; it takes a number"),
        ({"snes_max_it": 2.5}, "-bad_snes_max_it is '2.5'; it takes a whole number"),
        ({"snes_monitor_cancel": "maybe"}, "PETSc refuses one of the options -bad_…: .*maybe"),
    ):
        with raises(ValueError, message):
            create(body, petsc_options=options)


def test_energy_given_twice(body):
    """The same one is fine; of two different ones only one can be meant."""
    psi, J = solid(body)
    energy, other = ((psi + kappa * (J - 1) ** 2) * ufl.dx for kappa in (1.0, 2.0))
    create(body, F=energy, energy=energy, condense=None)
    with raises(ValueError, "energy is not F, which is an energy itself.*: leave energy out"):
        create(body, F=energy, energy=other, condense=None)


def test_quadrature_degree(body):
    with raises(ValueError, "degree = -1"):
        create(body, quadrature_degree=-1)


def test_no_dirichlet_conditions(body):
    """The global problem is singular; its kernel is counted."""
    psi, J = solid(body)
    energy = (psi + 10.0 * (J - 1) ** 2 + 0.1 * body.u[2]) * ufl.dx
    problem = create(body, F=energy, bcs=[], condense=None)
    with raises(ConvergenceError, "singular, with a kernel of dimension 6.*Add Dirichlet"):
        problem.solve()
    agree(not body.u.x.array.any())
