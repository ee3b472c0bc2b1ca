# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Moduli at small strains, from the tangent at the reference F = I.

P and A are the stress and the tangent at F = I. For an incompressible material they include the
pressure p = −tr(∂Ψ/∂F)/3. The stiffness is D_ijkl = A_ijkl − δ_ik P_jl; that of an incompressible
material acts on strains without trace. K = D_iijj/9 and μ = (D_ijij − D_iijj/3)/10 are Voigt's
averages. With the compliance S = D⁻¹, 1/S_iiii are Young's moduli and −S_iijj/S_iiii are Poisson's
ratios.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.text_tables import format_number
from dolfinx_feti.workshop.compiled import Material, evaluate
from dolfinx_feti.workshop.equilibrium import total_tangent

__all__ = ["ZERO_STIFFNESS", "Moduli", "small_strain_moduli"]

#: Eigenvalue of the stiffness, over its largest entry, up to which it counts as zero: rounding with
#: a margin.
ZERO_STIFFNESS = 1e-8

#: Indices of Voigt's components 1 to 6.
VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


@dataclass(frozen=True, slots=True)
class Moduli:
    """Moduli at small strains; ``str`` prints them."""

    stiffness: Array  #: D in Voigt's order 11, 22, 33, 23, 13, 12 [kPa], (6, 6)
    least: float  #: Smallest eigenvalue of D [kPa], 2 μ or 3 K for an isotropic material
    bulk: float  #: K [kPa], infinite for an incompressible material
    shear: float  #: μ [kPa]
    young: Array  #: Young's moduli along x, y and z [kPa], (3,); NaN if D is not positive definite
    poisson: Array  #: Poisson's ratios ν_ij, contraction along j in tension along i, (3, 3)

    def __str__(self) -> str:
        """Return the moduli as text."""
        shear = format_number(self.shear)
        bulk = format_number(self.bulk)
        lines = [f"shear modulus {shear} kPa, bulk modulus {bulk} kPa"]
        if np.isnan(self.young).any():
            return "\n".join([*lines, "not positive definite: no Young's modulus"])
        ratios = ", ".join(format_number(self.poisson[i, j]) for i, j in ((0, 1), (0, 2), (1, 2)))
        lines += [
            f"Young's moduli {', '.join(map(format_number, self.young))} kPa along x, y, z",
            f"Poisson's ratios {ratios} of xy, xz, yz",
        ]
        return "\n".join(lines)


def small_strain_moduli(material: Material) -> Moduli:
    """Compute the moduli at the reference.

    Raises:
        ValueError: The energy or its derivatives are not finite there.
    """
    B = _strains(material.incompressible)
    M = np.einsum("aij,ijkl,bkl->ab", B, _stiffness(material), B)
    least = float(np.linalg.eigvalsh(M)[0])
    D = _tensor(B, M)
    S = np.full((3, 3), np.nan)  # S_iijj
    if least > ZERO_STIFFNESS * np.abs(M).max():
        S = np.einsum("iijj->ij", _tensor(B, np.linalg.inv(M)))
    trace = float(np.einsum("iijj", D))
    return Moduli(
        stiffness=_voigt_matrix(D),
        least=least,
        bulk=np.inf if material.incompressible else trace / 9,
        shear=(float(np.einsum("ijij", D)) - trace / 3) / 10,
        young=1 / np.diag(S),
        poisson=-S / np.diag(S)[:, None],
    )


def _voigt_matrix(D: Array) -> Array:
    """Return a tensor, (3, 3, 3, 3), as a matrix in Voigt's order, (6, 6)."""
    i, j = np.transpose(VOIGT)
    return D[i[:, None], j[:, None], i, j]


def _stiffness(material: Material) -> Array:
    """Return D at the reference, (3, 3, 3, 3).

    Raises:
        ValueError: The energy or its derivatives are not finite there.
    """
    reference = evaluate(material, np.eye(3))
    if not reference.finite.all():
        raise ValueError(
            "psi, its stress or its tangent is no finite number at F = I: there are no moduli at "
            "rest unless psi is smooth there."
        )
    p = -np.trace(reference.P[0]) / 3 if material.incompressible else 0.0
    A = total_tangent(reference.A, reference.F, np.array([p]))[0]
    return A - np.einsum("ik,jl->ijkl", np.eye(3), reference.P[0] + p * np.eye(3))


def _strains(incompressible: bool) -> Array:
    """Return an orthonormal basis of the symmetric tensors, (6, 3, 3).

    If incompressible, only of those without trace, (5, 3, 3).
    """
    diagonals = [[1, -1, 0], [1, 1, -2], [1, 1, 1]]
    shears = [np.outer(*np.eye(3)[list(ij)]) for ij in ((1, 2), (0, 2), (0, 1))]
    B = np.array([np.diag(d) for d in diagonals] + [s + s.T for s in shears], dtype=np.float64)
    B /= np.linalg.norm(B, axis=(1, 2), keepdims=True)
    return np.delete(B, 2, axis=0) if incompressible else B  # without the identity


def _tensor(B: Array, M: Array) -> Array:
    """Return the tensor, (3, 3, 3, 3), of a matrix M in the basis B."""
    return np.einsum("aij,ab,bkl->ijkl", B, M, B)
