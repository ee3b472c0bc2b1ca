# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Moduli at small strains, from the tangent at the reference F = I.

With P = ∂Ψ/∂F and A = ∂²Ψ/∂F∂F at F = I, both with the pressure p = −tr(∂Ψ/∂F)/3 if the material
is incompressible, the stiffness is D_ijkl = A_ijkl − δ_ik P_jl. An incompressible material has
strains without trace, and only the part of D that acts on those counts.

Isotropic or not, K = D_iijj/9 and μ = (D_ijij − D_iijj/3)/10 are the moduli of the isotropic
tensor nearest to D (Voigt's averages). From the compliance S = D⁻¹ follow Young's moduli
1/(n⊗n : S : n⊗n), Poisson's ratios −S_iijj/S_iiii, Reuss's averages K_R and μ_R, and the universal
anisotropy index 5 μ/μ_R + K/K_R − 6, which vanishes for an isotropic material (Ranganathan,
Ostoja-Starzewski, Phys. Rev. Lett. 101, 055504, 2008).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dolfinx_feti.runtime.tables import number
from dolfinx_feti.workshop.compiled import Material, evaluate
from dolfinx_feti.workshop.directions import hemisphere, minimise
from dolfinx_feti.workshop.equilibrium import total_tangent

__all__ = ["Moduli", "small_strain_moduli"]

Array = npt.NDArray[np.float64]

#: Relative distance from an isotropic tensor, or eigenvalue, that counts as zero.
ZERO_STIFFNESS = 1e-8
VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


@dataclass(frozen=True, slots=True)
class Compliance:
    """What follows from the inverse of a positive definite stiffness.

    Attributes:
        young: Young's moduli along the coordinate axes [kPa], (3,).
        young_range: Least and largest Young's modulus over all directions [kPa].
        poisson: Poisson's ratios ν_ij, contraction along j in tension along i, (3, 3); the
            diagonal has no meaning.
        anisotropy: Universal anisotropy index, zero for an isotropic material.
    """

    young: Array
    young_range: tuple[float, float]
    poisson: Array
    anisotropy: float


@dataclass(frozen=True, slots=True)
class Moduli:
    """Moduli at small strains; ``str`` prints them.

    Attributes:
        stiffness: D in Voigt's order 11, 22, 33, 23, 13, 12 [kPa], (6, 6); of an incompressible
            material the part on strains without trace.
        least: Least eigenvalue of D, which is 2 μ (or 3 K) of an isotropic material [kPa].
        bulk: K [kPa], infinite for an incompressible material.
        shear: μ [kPa].
        isotropic: Whether D is isotropic.
        compliance: What follows from D⁻¹; None if D is not positive definite.
    """

    stiffness: Array
    least: float
    bulk: float
    shear: float
    isotropic: bool
    compliance: Compliance | None

    def __str__(self) -> str:
        """Return a few lines."""
        averages = "" if self.isotropic else " (Voigt's averages)"
        lines = [
            f"shear modulus {number(self.shear)} kPa, bulk modulus {number(self.bulk)} kPa"
            + averages
        ]
        if self.compliance is None:
            return "\n".join([*lines, "not positive definite: no Young's modulus"])
        young, ν = self.compliance.young, self.compliance.poisson
        if self.isotropic:
            lines.append(
                f"isotropic: Young's modulus {number(young[0])} kPa, Poisson's ratio "
                f"{number(ν[0, 1])}"
            )
            return "\n".join(lines)
        least, most = map(number, self.compliance.young_range)
        axes = ", ".join(map(number, young))
        ratios = ", ".join(number(ν[i, j]) for i, j in ((0, 1), (0, 2), (1, 2)))
        lines += [
            f"anisotropic: universal index {number(self.compliance.anisotropy)}",
            f"Young's modulus {axes} kPa along x, y, z, and {least} to {most} kPa overall",
            f"Poisson's ratios {ratios} of xy, xz, yz",
        ]
        return "\n".join(lines)


def small_strain_moduli(material: Material) -> Moduli:
    """Compute the moduli at the reference.

    Args:
        material: The compiled energy.

    Raises:
        ValueError: The energy has no finite derivatives at the reference.
    """
    B = _strains(material.incompressible)
    M = np.einsum("aij,ijkl,bkl->ab", B, _stiffness(material), B)
    D = _tensor(B, M)
    hydrostatic, deviatoric = _split(D)
    on_axis = np.trace(B, axis1=1, axis2=2) > 1  # the multiple of I in the basis
    nearest = _tensor(B, np.diag(np.where(on_axis, hydrostatic, deviatoric)))
    least = float(np.linalg.eigvalsh(M)[0])
    return Moduli(
        stiffness=np.array([[D[ij + kl] for kl in VOIGT] for ij in VOIGT]),
        least=least,
        bulk=np.inf if material.incompressible else hydrostatic / 3,
        shear=deviatoric / 2,
        isotropic=bool(np.linalg.norm(D - nearest) <= ZERO_STIFFNESS * np.linalg.norm(D)),
        compliance=_invert(B, M) if least > ZERO_STIFFNESS * np.abs(M).max() else None,
    )


def _stiffness(material: Material) -> Array:
    """D at the reference, (3, 3, 3, 3)."""
    reference = evaluate(material, np.eye(3))
    if not reference.finite.all():
        raise ValueError("psi, its stress or its tangent is no finite number at F = I.")
    p = -np.trace(reference.P[0]) / 3 if material.incompressible else 0.0
    A = total_tangent(reference.A, reference.F, np.array([p]))[0]
    return A - np.einsum("ik,jl->ijkl", np.eye(3), reference.P[0] + p * np.eye(3))


def _strains(incompressible: bool) -> Array:
    """Orthonormal basis of the symmetric tensors, (6, 3, 3), or of those without trace, (5, …)."""
    diagonals = [[1, -1, 0], [1, 1, -2], [1, 1, 1]]
    shears = [np.outer(*np.eye(3)[list(ij)]) for ij in ((1, 2), (0, 2), (0, 1))]
    B = np.array([np.diag(d) for d in diagonals] + [s + s.T for s in shears], dtype=np.float64)
    B /= np.linalg.norm(B, axis=(1, 2), keepdims=True)
    return np.delete(B, 2, axis=0) if incompressible else B


def _tensor(B: Array, M: Array) -> Array:
    """Fourth-order tensor of a matrix in the basis B, (3, 3, 3, 3)."""
    return np.einsum("aij,ab,bkl->ijkl", B, M, B)


def _split(D: Array) -> tuple[float, float]:
    """Mean eigenvalues on the multiples of I and on the tensors without trace: 3 K and 2 μ."""
    hydrostatic = np.einsum("iijj", D) / 3
    return float(hydrostatic), float(np.einsum("ijij", D) - hydrostatic) / 5


def _invert(B: Array, M: Array) -> Compliance:
    """Invert the stiffness with the matrix M in the basis B."""
    S = _tensor(B, np.asarray(np.linalg.inv(M), dtype=np.float64))
    normal = np.einsum("iijj->ij", S)
    bulk, shear = (
        stiff * soft for stiff, soft in zip(_split(_tensor(B, M)), _split(S), strict=True)
    )  # K/K_R, which is 0 for an incompressible material, and μ/μ_R
    return Compliance(
        young=1 / np.diag(normal),
        young_range=_young_range(S),
        poisson=-normal / np.diag(normal)[:, None],
        anisotropy=max(5 * (shear - 1) + (bulk - 1 if len(B) == 6 else 0.0), 0.0),
    )


def _young_range(S: Array) -> tuple[float, float]:
    """Least and largest 1/(n⊗n : S : n⊗n)."""
    directions = np.vstack((np.eye(3), hemisphere()))
    values = np.einsum("ijkl,ni,nj,nk,nl->n", S, *[directions] * 4, optimize=True)
    scale = values.max()

    def compliance(n: Array) -> float:
        return float(np.einsum("ijkl,i,j,k,l", S, n, n, n, n, optimize=True) / scale)

    least, _ = minimise(compliance, directions[values.argmin()])
    most, _ = minimise(lambda n: -compliance(n), directions[values.argmax()])
    return -1 / (scale * most), 1 / (scale * least)
