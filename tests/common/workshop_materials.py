# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Materials of the tests of the workshop, each compiled once per session."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable

import numpy as np

import ufl

from dolfinx_feti import kinematics, materials
from dolfinx_feti.workshop import Material, compile_material

#: Without optimisation: quick to compile, slow to run.
JIT = {"cffi_extra_compile_args": ["-O0"]}

C = 3.0
HGO = {"c": 3.0, "k1": 2.3632, "k2": 0.8393}
C10 = 2.0
C01 = 0.5
LMBDA = 5.0
MU = 2.0
#: Stiffness of the fibres of the standard reinforcing model; they kink at λ² = 1 − c/(2 k).
FIBRE = 4.0
ANGLE = 0.5


def family(angle: float) -> ufl.core.expr.Expr:
    """Return a direction of fibres in the x-y plane, at an angle to x."""
    return ufl.as_vector([math.cos(angle), math.sin(angle), 0.0])


def neo_hookean(C, J, c=C):
    return materials.neo_hookean(C, c=c, J=J)


def mooney_rivlin(C, J, c10=C10, c01=C01):
    return materials.mooney_rivlin(C, c10=c10, c01=c01, J=J)


def hgo(C, J, c=HGO["c"], k1=HGO["k1"], k2=HGO["k2"]):
    a1 = family(ANGLE)
    a2 = family(-ANGLE)
    return materials.holzapfel_gasser_ogden(C, a1, a2, c=c, k1=k1, k2=k2, J=J)


def goh(C, J):
    families = family(ANGLE), family(-ANGLE)
    return materials.gasser_ogden_holzapfel(C, *families, **HGO, dispersion=0.226, J=J)


def oblique(C, J):
    """One family, oblique to all axes of loading."""
    return materials.holzapfel_gasser_ogden(C, family(ANGLE), family(ANGLE), **HGO, J=J)


def reinforced(C, J, c=C, k=FIBRE):
    """The standard reinforcing model, k/2 (Ī₄ − 1)², whose fibres also resist compression."""
    return (
        neo_hookean(C, J, c) + k / 2 * (kinematics.isochoric_invariant_4(C, family(0), J) - 1) ** 2
    )


def fung(C, J, c=C, b=1.5):
    I1 = kinematics.isochoric_invariant_1(C, J)
    return c / (2 * b) * (ufl.exp(b * (I1 - 3)) - 1)


def guccione(C, J):
    """The heart's muscle, parameters of problem 1 of Land et al. (2015)."""
    return materials.guccione(C, family(ANGLE), c=2.0, b_f=8.0, b_t=2.0, b_fs=4.0, J=J)


def holzapfel_ogden(C, J):
    """The heart's muscle, fitted to shear tests by Holzapfel and Ogden (2009)."""
    directions = family(ANGLE), family(ANGLE + math.pi / 2)
    fibres = {"a_f": 18.472, "b_f": 16.026, "a_s": 2.481, "b_s": 11.120}
    shear = {"a_fs": 0.216, "b_fs": 11.436}
    return materials.holzapfel_ogden(C, *directions, a=0.059, b=8.023, **fibres, **shear, J=J)


def contracting(C, J, tension=5.0):
    """Guccione's muscle with an active tension."""
    return guccione(C, J) + materials.active_tension(C, family(ANGLE), tension=tension)


def unsplit(C, c=C):
    """Neo-Hookean in I₁ instead of Ī₁; the two are equal if J = 1."""
    return c / 2 * (ufl.tr(C) - 3)


def saint_venant(C):
    return materials.saint_venant_kirchhoff(C, lmbda=LMBDA, mu=MU)


def no_lambda(C):
    """St Venant-Kirchhoff with λ = 0."""
    E = (C - ufl.Identity(3)) / 2
    return MU * ufl.inner(E, E)


def linear(F):
    """Hooke's law for the gradient of the displacement: not frame-indifferent."""
    strain = ufl.sym(F) - ufl.Identity(3)
    return LMBDA / 2 * ufl.tr(strain) ** 2 + MU * ufl.inner(strain, strain)


def wrong_sign(C, J):
    return -neo_hookean(C, J)


def stressed(C, J):
    """A fibre that pulls at rest."""
    return neo_hookean(C, J) + kinematics.isochoric_invariant_4(C, family(0), J)


def flat(C, J):
    """No stiffness at rest."""
    return (kinematics.isochoric_invariant_1(C, J) - 3) ** 2


def not_a_number(C, J):
    """NaN where a fibre along x is longer than √1.3."""
    return neo_hookean(C, J) * (1 + ufl.sqrt(1.3 - C[0, 0]))


def root(C, J):
    """The square root of an energy: no derivative at rest."""
    return ufl.sqrt(neo_hookean(C, J))


def wavy(C, J):
    """Ripples that are shorter than the increments of finite differences."""
    return neo_hookean(C, J) + 1e-6 * ufl.sin(1e6 * ufl.tr(C))


@functools.cache
def compiled(psi: Callable, *parameters: str) -> Material:
    """Compile an energy; the parameters have the values 1."""
    return compile_material(psi, parameters=dict.fromkeys(parameters, 1.0), jit_options=JIT)


def material(psi: Callable, kappa: float = math.inf, **parameters: float) -> Material:
    """Return a compiled energy with the given κ and values of its parameters."""
    return dataclasses.replace(compiled(psi, *parameters), kappa=kappa, parameters=dict(parameters))


def rotation(seed: int) -> np.ndarray:
    """A random rotation."""
    Q, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    return Q * np.linalg.det(Q)
