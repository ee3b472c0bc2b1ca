# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Energies by hand, mostly without a mesh; forms with one.

Their derivatives, objectivity and state of rest are checked by the workshop (tests/workshop).
"""

from __future__ import annotations

import dataclasses

from mpi4py import MPI

import numpy as np
import pytest
from ufl_values import scalar, value, variable

import dolfinx
import ufl

from dolfinx_feti import kinematics as kin
from dolfinx_feti import loads
from dolfinx_feti import materials as mat
from dolfinx_feti.fem.quadrature import limit_quadrature_degree

KAPPA = 50.0
HGO = {"c": 3.0, "k1": 2.3632, "k2": 0.8393}
A1 = np.array([np.cos(0.5), np.sin(0.5), 0.0])
A2 = np.array([np.cos(0.5), -np.sin(0.5), 0.0])
STRETCHED = np.array([[1.2, 0.3, -0.1], [0.05, 0.9, 0.2], [-0.2, 0.1, 1.1]])
SQUEEZED = np.diag([0.8, 0.85, 1.5])
SHEARED = np.array([[1.0, 0.4, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def fibred(F, J=None):
    return mat.holzapfel_gasser_ogden(
        kin.right_cauchy_green(F),
        ufl.as_vector(A1.tolist()),
        ufl.as_vector(A2.tolist()),
        J=J,
        **HGO,
    )


def dispersed(F, dispersion=0.226):
    families = (ufl.as_vector(a.tolist()) for a in (A1, A2))
    C, J = kin.right_cauchy_green(F), kin.jacobian(F)
    return mat.gasser_ogden_holzapfel(C, *families, **HGO, dispersion=dispersion, J=J)


ENERGIES = {
    "neo-Hookean": lambda F: mat.neo_hookean(kin.right_cauchy_green(F), c=3.0),
    "Mooney-Rivlin": lambda F: mat.mooney_rivlin(kin.right_cauchy_green(F), c10=2.0, c01=0.5),
    "GOH": dispersed,
    "HGO": fibred,
    "HGO with J": lambda F: fibred(F, kin.jacobian(F)),
    "volumetric": lambda F: mat.volumetric(kin.jacobian(F), KAPPA),
    "St Venant-Kirchhoff": lambda F: mat.saint_venant_kirchhoff(
        kin.right_cauchy_green(F), lmbda=5.0, mu=2.0
    ),
}


def hand_stress(F):
    """First Piola stress of the HGO energy, derived on paper."""
    J, inverse = np.linalg.det(F), np.linalg.inv(F).T
    scale = J ** (-2 / 3)
    piola = HGO["c"] * scale * (F - np.sum(F * F) / 3 * inverse)
    for a in (A1, A2):
        I4 = a @ F.T @ F @ a
        E = max(scale * I4 - 1, 0.0)
        factor = 2 * HGO["k1"] * E * np.exp(HGO["k2"] * E**2) * scale
        piola += factor * (np.outer(F @ a, a) - I4 / 3 * inverse)
    return piola


def piola(energy, F):
    F = variable(F)
    return value(ufl.diff(energy(F), F))


# -- by hand -----------------------------------------------------------------------------------


def test_dilation_by_hand():
    """F = 1.1 I: the isochoric part is asleep, J = 1.331."""
    F = variable(1.1 * np.eye(3))
    assert value(fibred(F)) == pytest.approx(0, abs=1e-14)
    np.testing.assert_allclose(piola(fibred, 1.1 * np.eye(3)), 0, atol=1e-13)
    assert value(ENERGIES["volumetric"](F)) == pytest.approx(25 * 0.331**2)
    np.testing.assert_allclose(
        piola(ENERGIES["volumetric"], 1.1 * np.eye(3)), 50 * 0.331 * 1.21 * np.eye(3), atol=1e-13
    )
    # E = 0.105 I: λ/2 (3·0.105)² + 3 μ 0.105²
    assert value(ENERGIES["St Venant-Kirchhoff"](F)) == pytest.approx(0.2480625 + 0.06615)
    # P = F (λ tr E + 2 μ E) = 1.1 (5·0.315 + 4·0.105)
    np.testing.assert_allclose(
        piola(ENERGIES["St Venant-Kirchhoff"], 1.1 * np.eye(3)), 2.1945 * np.eye(3), atol=1e-14
    )


def test_simple_shear_by_hand():
    """γ = 0.4: I₁ = 3 + γ²; I₄ = 1 ± γ sin 2θ + γ² sin²θ with θ = 0.5; family 2 is compressed."""
    shift = 0.16 * np.sin(0.5) ** 2
    E1, E2 = 0.4 * np.sin(1.0) + shift, -0.4 * np.sin(1.0) + shift
    assert E2 < 0 < E1
    psi = 1.5 * 0.16 + 2.3632 / (2 * 0.8393) * np.expm1(0.8393 * E1**2)
    assert value(fibred(variable(SHEARED))) == pytest.approx(psi, rel=1e-13)


def test_uniaxial_by_hand():
    """F = diag(λ, λ^{-1/2}, λ^{-1/2}), J = 1: both families see the same stretch."""
    stretch = 1.3
    F = np.diag([stretch, stretch**-0.5, stretch**-0.5])
    cosine2 = np.cos(0.5) ** 2
    E = stretch**2 * cosine2 + (1 - cosine2) / stretch - 1
    psi = 1.5 * (stretch**2 + 2 / stretch - 3) + 2.3632 / 0.8393 * np.expm1(0.8393 * E**2)
    assert value(fibred(variable(F))) == pytest.approx(psi, rel=1e-13)
    # dΨ/dλ along this path is P₁₁ − λ^{-3/2} (P₂₂ + P₃₃)/2
    P = piola(fibred, F)
    slope = 3.0 * (stretch - stretch**-2)
    slope += (
        2
        * 2.3632
        * E
        * np.exp(0.8393 * E**2)
        * (2 * stretch * cosine2 - (1 - cosine2) / stretch**2)
    )
    assert P[0, 0] - stretch**-1.5 * (P[1, 1] + P[2, 2]) / 2 == pytest.approx(slope, rel=1e-13)


def test_mooney_rivlin_by_hand():
    """F = diag(λ, λ, λ^-2), λ = 1.2: I₁ = 2 λ² + λ^-4, and I₂ = λ^4 + 2 λ^-2 as J = 1."""
    psi = value(ENERGIES["Mooney-Rivlin"](variable(np.diag([1.2, 1.2, 1.2**-2]))))
    by_hand = 2.0 * (2 * 1.44 + 1.44**-2 - 3) + 0.5 * (1.44**2 + 2 / 1.44 - 3)
    assert psi == pytest.approx(by_hand, rel=1e-13)


@pytest.mark.parametrize("F", [STRETCHED, SQUEEZED, SHEARED])
def test_fibres_without_dispersion_are_those_of_hgo(F):
    parallel = piola(lambda F: dispersed(F, 0.0), F)
    np.testing.assert_allclose(parallel, piola(fibred, F), rtol=1e-12, atol=1e-13)


def test_fully_dispersed_fibres_are_isotropic():
    """ϰ = 1/3: E = (Ī₁ − 3)/3 for both families, whatever their direction."""
    E = value(kin.isochoric_invariant_1(variable(STRETCHED.T @ STRETCHED))) / 3 - 1
    psi = 4.5 * E + 2.3632 / 0.8393 * np.expm1(0.8393 * E**2)
    assert value(dispersed(variable(STRETCHED), 1 / 3)) == pytest.approx(psi, rel=1e-13)


@pytest.mark.parametrize("F", [STRETCHED, SQUEEZED, SHEARED])
@pytest.mark.parametrize("name", ["HGO", "HGO with J"])
def test_stress_is_the_one_derived_on_paper(name, F):
    np.testing.assert_allclose(piola(ENERGIES[name], F), hand_stress(F), rtol=1e-12, atol=1e-13)


# -- properties --------------------------------------------------------------------------------


def test_fibres_are_off_in_compression():
    assert max(a @ SQUEEZED**2 @ a for a in (A1, A2)) < np.linalg.det(SQUEEZED) ** (2 / 3)
    matrix = ENERGIES["neo-Hookean"]
    assert value(fibred(variable(SQUEEZED))) == value(matrix(variable(SQUEEZED)))
    np.testing.assert_array_equal(piola(fibred, SQUEEZED), piola(matrix, SQUEEZED))


@pytest.mark.parametrize("length", [1 - 4e-16, 1.0, 1 + 4e-16])
def test_fibres_stiffen_the_reference_state_whatever_the_rounding(length):
    """∂²Ψ/∂F₁₁² at F = I: 4/3 c of the matrix, and 8 k₁ (cos²θ − 1/3)² of two families."""
    F = variable(np.eye(3))
    a1, a2 = (ufl.as_vector((length * a).tolist()) for a in (A1, A2))
    psi = mat.holzapfel_gasser_ogden(kin.right_cauchy_green(F), a1, a2, **HGO)
    curvature = value(ufl.diff(ufl.diff(psi, F)[0, 0], F)[0, 0])
    by_hand = 4 / 3 * HGO["c"] + 2 * 4 * HGO["k1"] * (np.cos(0.5) ** 2 - 1 / 3) ** 2
    assert curvature == pytest.approx(by_hand, rel=1e-12)


def test_inverted_state_is_not_hidden():
    """With J at hand its energy is no number: NaN in compiled code, a complex power here."""
    F = variable(np.diag([-1.1, 1.0, 1.0]))
    with pytest.raises(TypeError):
        value(fibred(F, kin.jacobian(F)))


def test_perturbed_lagrangian_is_the_volumetric_energy_at_its_pressure():
    J = 1.07
    pressure = KAPPA * (J - 1)
    field = ufl.variable(ufl.as_ufl(pressure))
    psi = mat.perturbed_lagrangian(ufl.as_ufl(J), field, KAPPA)
    assert value(psi) == pytest.approx(value(mat.volumetric(ufl.as_ufl(J), KAPPA)), rel=1e-13)
    assert value(ufl.diff(psi, field)) == pytest.approx(0, abs=1e-15)


# -- parameters --------------------------------------------------------------------------------


def test_parameters_of_the_paper():
    assert dataclasses.asdict(mat.ArteryParameters()) == HGO
    with pytest.raises(dataclasses.FrozenInstanceError):
        mat.ArteryParameters().c = 6.0


# -- forms -------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Wall:
    """A P2-P0 cube with two layers of HGO material in a deformed state."""

    u: dolfinx.fem.Function
    p: dolfinx.fem.Function
    energy: ufl.Form
    v: ufl.Argument
    q: ufl.Argument
    du: ufl.Argument
    dp: ufl.Argument


def wall(comm, **measure):
    mesh = dolfinx.mesh.create_unit_cube(comm, 2, 2, 2)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    Q = dolfinx.fem.functionspace(mesh, ("Discontinuous Lagrange", 0))
    W = dolfinx.fem.functionspace(mesh, ("Discontinuous Lagrange", 0, (3,)))
    u, p, c, a1, a2 = (dolfinx.fem.Function(space) for space in (V, Q, Q, W, W))
    u.interpolate(
        lambda x: np.array([0.2 * x[0] * x[1], 0.1 * x[1] ** 2 - 0.05 * x[0], 0.1 * x[2]])
    )
    p.interpolate(lambda x: 2 + x[0])
    c.interpolate(lambda x: np.where(x[0] < 0.5, 3.0, 6.0))
    a1.interpolate(lambda x: np.outer(A1, np.ones_like(x[0])))
    a2.interpolate(lambda x: np.outer(A2, np.ones_like(x[0])))
    k1, k2, kappa = (dolfinx.fem.Constant(mesh, x) for x in (HGO["k1"], HGO["k2"], 1000.0))
    F = kin.deformation_gradient(u)
    C, J = kin.right_cauchy_green(F), kin.jacobian(F)
    psi = mat.holzapfel_gasser_ogden(C, a1, a2, c=c, k1=k1, k2=k2, J=J)
    energy = (psi + mat.perturbed_lagrangian(J, p, kappa)) * ufl.dx(mesh, **measure)
    arguments = (f(space) for f in (ufl.TestFunction, ufl.TrialFunction) for space in (V, Q))
    return Wall(u, p, energy, *arguments)


def all_forms(w, pressure, ds):
    """Residual and tangent of the internal energy and the pressure, by UFL."""
    F_u, F_p = ufl.derivative(w.energy, w.u, w.v), ufl.derivative(w.energy, w.p, w.q)
    K_up = ufl.derivative(F_u, w.p, w.dp)
    return {
        "F_u": F_u + loads.follower_pressure(pressure, w.u, w.v, ds),
        "F_p": F_p,
        "K_uu": ufl.derivative(F_u, w.u, w.du)
        + loads.follower_pressure_tangent(pressure, w.u, w.v, w.du, ds, "symmetric"),
        "K_up": K_up,
        "K_pu": ufl.adjoint(K_up),
        "K_pp": ufl.derivative(F_p, w.p, w.dp),
    }


@pytest.mark.serial
def test_code_of_all_forms_is_short(tmp_path):
    """Compilation takes time in proportion to the code, of which UFL could make much more."""
    w = wall(MPI.COMM_WORLD, metadata={"quadrature_degree": 4})
    pressure = dolfinx.fem.Constant(w.u.function_space.mesh, 1.3)
    forms = all_forms(w, pressure, ufl.ds(metadata={"quadrature_degree": 4}))
    for form in forms.values():
        dolfinx.fem.form(form, jit_options={"cache_dir": tmp_path})
    code = {path.name: path.stat().st_size for path in tmp_path.rglob("*.c")}
    assert 0 < sum(code.values()) < 900_000, code


def test_forms_by_finite_differences():
    """K_uu, K_up and K_pu against differences of the residual, F_u and F_p against the energy's."""
    w = wall(MPI.COMM_WORLD, metadata={"quadrature_degree": 4})
    forms = all_forms(w, 0.0, ufl.ds)
    d_u, d_p = dolfinx.fem.Function(w.u.function_space), dolfinx.fem.Function(w.p.function_space)
    d_u.interpolate(lambda x: np.array([np.sin(x[1]), x[0] * x[2], np.cos(x[0])]))
    d_p.interpolate(lambda x: 1 + x[1])

    def difference(form, *arguments, function, direction, h=1e-4):
        ends = []
        for sign in (1, -1):
            function.x.array[:] += sign * h * direction.x.array
            ends.append(scalar(form, *arguments))
            function.x.array[:] -= sign * h * direction.x.array
        return (ends[0] - ends[1]) / (2 * h)

    in_u, in_p = {"function": w.u, "direction": d_u}, {"function": w.p, "direction": d_p}
    F_u, F_p = forms["F_u"], forms["F_p"]
    pairs = [
        (scalar(F_u, d_u), difference(w.energy, **in_u)),
        (scalar(F_p, d_p), difference(w.energy, **in_p)),
        (scalar(forms["K_uu"], d_u, d_u), difference(F_u, d_u, **in_u)),
        (scalar(forms["K_up"], d_p, d_u), difference(F_u, d_u, **in_p)),
        (scalar(forms["K_pu"], d_u, d_p), difference(F_p, d_p, **in_u)),
        (scalar(forms["K_pp"], d_p, d_p), difference(F_p, d_p, **in_p)),
    ]
    for exact, approximate in pairs:
        assert exact == pytest.approx(approximate, rel=1e-6)


def test_quadrature_degree_is_limited_where_the_user_left_it_open():
    free, chosen = wall(MPI.COMM_SELF), wall(MPI.COMM_SELF, degree=3)
    residual = ufl.derivative(limit_quadrature_degree(free.energy), free.u, free.v)
    tangent = ufl.derivative(residual, free.u, free.du)
    for form in (residual, tangent):
        assert [i.metadata() for i in form.integrals()] == [{"quadrature_degree": 4}]
    kept = limit_quadrature_degree(chosen.energy, 2)
    assert [i.metadata() for i in kept.integrals()] == [{"quadrature_degree": 3}]


def test_limit_of_the_quadrature_degree():
    mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_SELF, 1, 1, 1)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    x = ufl.SpatialCoordinate(mesh)
    cheap = ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * ufl.dx
    dear = ufl.exp(x[0] ** 3) * ufl.inner(u, v) * ufl.dx
    assert limit_quadrature_degree(cheap) == cheap
    for degree, expected in ((None, 2), (5, 5), (0, 0)):
        (integral,) = limit_quadrature_degree(dear, degree).integrals()
        assert integral.metadata() == {"quadrature_degree": expected}
    with pytest.raises(ValueError, match="degree = -1"):
        limit_quadrature_degree(dear, -1)
