# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Compiled energies have UFL's values, follow their parameters, and refuse bad input."""

from __future__ import annotations

from functools import partial

from mpi4py import MPI

import numpy as np
import pytest
import workshop_materials as energies
from ufl_values import value, variable
from workshop_materials import HGO, JIT, compiled, family, material, neo_hookean

import dolfinx
import ufl

from dolfinx_feti import kinematics, materials
from dolfinx_feti.workshop import compile_material, evaluate

pytestmark = pytest.mark.serial

F_ANY = np.array([[1.2, 0.3, -0.1], [0.05, 0.9, 0.2], [-0.2, 0.1, 1.1]])


def states(n, seed=7331):
    return np.eye(3) + 0.1 * np.random.default_rng(seed).standard_normal((n, 3, 3))


@pytest.mark.parametrize(
    "psi", [neo_hookean, energies.mooney_rivlin, energies.hgo, energies.linear]
)
def test_values_are_those_of_ufl(psi):
    """Energy, stress and tangent are those of UFL's own evaluation."""
    at = evaluate(compiled(psi), F_ANY)
    F = variable(F_ANY)
    C = kinematics.right_cauchy_green(F)
    J = kinematics.jacobian(F)
    energy = psi(F) if psi is energies.linear else psi(C, J)
    assert at.psi[0] == pytest.approx(float(value(energy)), rel=1e-13)
    P = ufl.diff(energy, F)
    np.testing.assert_allclose(at.P[0], value(P), rtol=1e-12, atol=1e-13)
    A = ufl.diff(P, F)
    for entry in ((0, 0, 0, 0), (0, 1, 2, 0), (2, 1, 1, 2)):
        assert at.A[(0, *entry)] == pytest.approx(value(A[entry]), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("n", [1, 64, 65, 200])
def test_states_do_not_depend_on_each_other(n):
    """The value of a state does not depend on the number of states evaluated at once."""
    F = states(n)
    at = evaluate(compiled(energies.hgo), F)
    assert at.psi.shape == (n,) and at.P.shape == (n, 3, 3) and at.A.shape == (n, 3, 3, 3, 3)
    for k in {0, n // 2, n - 1}:
        alone = evaluate(compiled(energies.hgo), F[k])
        np.testing.assert_array_equal(alone.A[0], at.A[k])
        np.testing.assert_array_equal(alone.P[0], at.P[k])
        assert alone.psi[0] == at.psi[k]


def test_nan_reaches_its_own_state_only():
    """A NaN in one state does not change the values of others."""
    F = states(5)
    before = evaluate(compiled(energies.hgo), F)
    F[2, 0, 1] = np.nan
    after = evaluate(compiled(energies.hgo), F)
    np.testing.assert_array_equal(after.finite, [True, True, False, True, True])
    np.testing.assert_array_equal(after.P[after.finite], before.P[after.finite])


def test_kappa_adds_the_volumetric_energy():
    """``kappa`` adds κ/2 (J − 1)²."""
    F = states(3)
    J = np.linalg.det(F)
    pure, both = (evaluate(material(neo_hookean, kappa=kappa), F) for kappa in (0.0, 70.0))
    np.testing.assert_allclose(both.psi - pure.psi, 35 * (J - 1) ** 2, rtol=1e-10)
    cofactor = J[:, None, None] * np.linalg.inv(F).transpose(0, 2, 1)
    pressure = 70 * (J - 1)[:, None, None]
    np.testing.assert_allclose(both.P - pure.P, pressure * cofactor, rtol=1e-9, atol=1e-12)
    incompressible = evaluate(material(neo_hookean), F)
    np.testing.assert_array_equal(incompressible.P, pure.P)


def test_parameters_change_without_compilation(tmp_path):
    """New parameter values compile nothing, nor does the same energy a second time."""
    options = {**JIT, "cache_dir": tmp_path}
    first = compile_material(neo_hookean, parameters={"c": 1.0}, jit_options=options)
    made = sorted(path.name for path in tmp_path.iterdir())
    assert made
    stiff = first.with_parameters(c=5.0)
    soft, hard = (evaluate(each, F_ANY).P for each in (first, stiff))
    np.testing.assert_allclose(hard, 5 * soft, rtol=1e-13, atol=1e-14)
    assert first.parameters == {"c": 1.0}
    ufl.variable(ufl.as_ufl(1.0))
    compile_material(neo_hookean, parameters={"c": 2.0}, jit_options=options)
    assert sorted(path.name for path in tmp_path.iterdir()) == made


def test_constants_of_another_mesh_are_followed():
    """Constants in an energy are evaluated with their present values."""
    mesh = dolfinx.mesh.create_unit_square(MPI.COMM_SELF, 1, 1)
    c = dolfinx.fem.Constant(mesh, 3.0)
    a = dolfinx.fem.Constant(mesh, (np.cos(0.5), np.sin(0.5), 0.0))
    fibres = {"a1": a, "a2": family(-0.5), "k1": HGO["k1"], "k2": HGO["k2"]}
    psi = partial(materials.holzapfel_gasser_ogden, c=c, **fibres)
    user = compile_material(psi, jit_options=JIT)
    own = evaluate(compiled(energies.hgo), F_ANY)
    np.testing.assert_allclose(evaluate(user, F_ANY).A, own.A, rtol=1e-12, atol=1e-12)
    before = evaluate(user, F_ANY).psi
    c.value = 4.0
    I1 = value(kinematics.isochoric_invariant_1(variable(F_ANY.T @ F_ANY)))
    assert evaluate(user, F_ANY).psi - before == pytest.approx((I1 - 3) / 2)


def test_states_outside_the_domain_are_marked():
    """States outside the domain of the energy are NaN: J < 0, or an overflow."""
    F = np.stack([np.eye(3), np.diag([-1.0, 1.0, 1.0]), np.diag([30.0, 1.0, 1 / 30])])
    np.testing.assert_array_equal(evaluate(compiled(energies.fung), F).finite, [True, False, False])
    without_J = compile_material(partial(materials.neo_hookean, c=3.0), jit_options=JIT)
    np.testing.assert_array_equal(evaluate(without_J, F).finite, [True, False, True])


# -- bad input ---------------------------------------------------------------------------------

MESH = dolfinx.mesh.create_unit_square(MPI.COMM_SELF, 1, 1)
FIELD = dolfinx.fem.Function(dolfinx.fem.functionspace(MESH, ("DG", 0)), name="stiffness")
NAN = float("nan")


@pytest.mark.parametrize(
    ("psi", "options", "error", "message"),
    [
        (3.0, {}, TypeError, "psi is 3.0: give Callable"),
        (lambda x: x, {}, TypeError, "missing a required argument: 'x'. Name the arguments C and"),
        (lambda C, J, /: J, {}, TypeError, "positional.* Name the arguments C and J"),
        (lambda C, p: p * C[0, 0], {}, TypeError, "missing a required argument: 'p'.*partial"),
        (lambda C, J: 1.5, {}, TypeError, "psi returns 1.5"),
        (lambda C, J: C, {}, ValueError, r"shape \(3, 3\): an energy is a scalar"),
        (lambda C, J: ufl.as_ufl(2.0), {}, ValueError, "does not depend on the deformation"),
        (lambda J: FIELD * J, {}, ValueError, "stiffness, which varies in space"),
        (lambda J: ufl.SpatialCoordinate(MESH)[0] * J, {}, ValueError, "varies in space"),
        (lambda J: ufl.Constant(MESH) * J, {}, ValueError, "which has no value"),
        (lambda J, c: J**2, {"parameters": {"c": 1.0}}, ValueError, r"its parameters \['c'\]: use"),
        (neo_hookean, {"parameters": {"k": 1.0}}, TypeError, "unexpected keyword argument 'k'"),
        (neo_hookean, {"parameters": {"c": NAN}}, ValueError, "c = nan: give a finite value"),
        (neo_hookean, {"kappa": -1.0}, ValueError, "kappa = -1.0"),
        (neo_hookean, {"kappa": NAN}, ValueError, "kappa = nan"),
    ],
)
def test_bad_material(psi, options, error, message):
    """Energies with wrong arguments, shapes or parameters are refused."""
    with pytest.raises(error, match=message):
        compile_material(psi, **options, jit_options=JIT)


@pytest.mark.parametrize(
    "F", [np.eye(2), np.ones(9), np.empty((0, 3, 3))], ids=["plane", "nine-numbers", "no-state"]
)
def test_bad_states(F):
    """States of a wrong shape are refused."""
    with pytest.raises(ValueError, match="F has the shape"):
        evaluate(compiled(neo_hookean), F)


def test_parameters_that_are_not_compiled():
    """A parameter that the material was not compiled with is refused."""
    with pytest.raises(ValueError, match=r"compiled with the parameters \['c'\]"):
        material(neo_hookean, c=1.0).with_parameters(k=2.0)
