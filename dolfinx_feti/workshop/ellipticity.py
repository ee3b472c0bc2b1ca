# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Strong ellipticity: the smallest eigenvalue of the acoustic tensor over all directions.

    Q_ik(n) = 𝒜_ijkl n_j n_l,   𝒜_ijkl = J⁻¹ A_iJkL F_jJ F_lL

with a unit normal n in the deformed body. The energy is strongly elliptic at F if m · Q(n) m > 0
for all m and n; in an incompressible material for all m ⟂ n, where the pressure has no effect
(docs/fitting.md; Merodio, Ogden, Int. J. Solids Struct. 40, 2003).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.optimize

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.workshop.compiled import Material, evaluate
from dolfinx_feti.workshop.equilibrium import equilibrate, stiffness_scale
from dolfinx_feti.workshop.paths import DeformationPath

__all__ = ["Ellipticity", "least_eigenvalues", "scan_ellipticity"]

#: Eigenvalue, over the stiffness at rest, up to which it counts as zero: rounding with a margin.
ZERO_EIGENVALUE = 1e-10

#: Number of directions in the first search; they are some 7° apart.
N_DIRECTIONS = 400

#: Number of directions around the best one in each further search.
N_AROUND = 12

#: Distances of the directions of the further searches from the best one [rad]. The first, 0.1, is
#: that between directions of the first search. The square of the last, 1e-14, is the relative error
#: of an eigenvalue.
DISTANCES = 0.1 * 0.6 ** np.arange(28)


@dataclass(frozen=True, slots=True)
class Ellipticity:
    """The acoustic tensor along a path."""

    path: DeformationPath  #: The path
    least: Array  #: Smallest eigenvalues [kPa], (n,); NaN for states without equilibrium
    rest: float  #: Value of the path at the state nearest to the reference
    lost: tuple[float, ...]  #: Values nearest to rest, below and above, where ellipticity is lost


def scan_ellipticity(
    material: Material, make_path: Callable[[npt.ArrayLike], DeformationPath], values: npt.ArrayLike
) -> Ellipticity:
    """Compute the smallest eigenvalue of the acoustic tensor along a path.

    Args:
        material: The compiled energy.
        make_path: Path as a function of its values, such as ``uniaxial``.
        values: Stretches or amounts of shear in ascending order, on both sides of rest, (n,).

    Raises:
        ValueError: The values are not in ascending order, or ``make_path`` does not accept them.
    """
    path = make_path(values)
    if (np.diff(path.values) <= 0).any():
        raise ValueError(f"values = {values!r}: give them in ascending order.")
    zero = ZERO_EIGENVALUE * stiffness_scale(material)
    least = _least_along(material, path)
    rest = int(np.linalg.norm(path.F - np.eye(3), axis=(1, 2)).argmin())

    def least_at(value: float) -> float:
        return float(_least_along(material, make_path([value]))[0])

    lost = set()
    for side in (np.arange(rest, len(least)), np.arange(rest, -1, -1)):
        value = _first_loss(least_at, path.values[side], least[side], zero)
        if value is not None:
            lost.add(value)
    return Ellipticity(path, least, float(path.values[rest]), tuple(sorted(lost)))


def least_eigenvalues(F: Array, A: Array, *, incompressible: bool) -> tuple[Array, Array]:
    """Minimise the eigenvalues of the acoustic tensor over all directions.

    Args:
        F: Deformation gradients, (n, 3, 3).
        A: Tangents ∂²Ψ/∂F∂F [kPa], finite, (n, 3, 3, 3, 3).
        incompressible: Whether only polarisations m ⟂ n are admissible.

    Returns:
        Smallest eigenvalues [kPa], (n,), and their normals n, (n, 3).
    """
    J = np.linalg.det(F)[:, None, None, None, None]
    spatial = np.einsum("niJkL,njJ,nlL->nijkl", A, F, F, optimize=True) / J
    lattice = _lattice()
    candidates = np.broadcast_to(lattice, (len(F), *lattice.shape))
    least, n = _least_of(candidates, spatial, incompressible=incompressible)
    angle = np.linspace(0, 2 * np.pi, N_AROUND, endpoint=False)
    circle = np.column_stack((np.cos(angle), np.sin(angle)))
    ring = np.vstack((np.zeros(2), circle))  # with the middle, which is the best one so far
    for distance in DISTANCES:
        candidates = n[:, None] + distance * ring @ _tangents(n).swapaxes(-1, -2)
        candidates /= np.linalg.norm(candidates, axis=-1, keepdims=True)
        least, n = _least_of(candidates, spatial, incompressible=incompressible)
    return least, n


def _lattice() -> Array:
    """Return a Fibonacci lattice on half of the sphere, (N_DIRECTIONS, 3), as Q(−n) = Q(n)."""
    z = (np.arange(N_DIRECTIONS) + 0.5) / N_DIRECTIONS
    φ = np.arange(N_DIRECTIONS) * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z**2)
    return np.column_stack((r * np.cos(φ), r * np.sin(φ), z))


def _least_of(directions: Array, spatial: Array, *, incompressible: bool) -> tuple[Array, Array]:
    """Return the smallest eigenvalue of the acoustic tensor over given directions.

    Args:
        directions: Unit normals to choose from, (n, directions, 3).
        spatial: Tangents 𝒜 of the states [kPa], (n, 3, 3, 3, 3).
        incompressible: Whether only polarisations normal to a direction are admissible.

    Returns:
        Smallest eigenvalues [kPa], (n,), and their directions, (n, 3).
    """
    Q = np.einsum("nijkl,naj,nal->naik", spatial, directions, directions, optimize=True)
    if incompressible:
        T = _tangents(directions)
        Q = T.swapaxes(-1, -2) @ Q @ T
    values = np.linalg.eigvalsh(Q)[..., 0]
    best = values.argmin(axis=1)
    state = np.arange(len(values))
    return values[state, best], directions[state, best]


def _least_along(material: Material, path: DeformationPath) -> Array:
    """Return the smallest eigenvalues along a path, (n,); NaN without equilibrium or tangent."""
    F, _ = equilibrate(material, path.F, path.free)
    states = evaluate(material, F)
    least = np.full(len(F), np.nan)
    is_finite = states.finite
    least[is_finite], _ = least_eigenvalues(
        F[is_finite], states.A[is_finite], incompressible=material.incompressible
    )
    return least


def _tangents(n: Array) -> Array:
    """Return two orthonormal vectors normal to each direction, as columns, (…, 3, 2)."""
    helper = np.eye(3)[np.abs(n).argmin(axis=-1)]
    t1 = np.cross(n, helper)
    t1 /= np.linalg.norm(t1, axis=-1, keepdims=True)
    return np.stack((t1, np.cross(n, t1)), axis=-1)


def _first_loss(
    least_at: Callable[[float], float], values: Array, least: Array, zero: float
) -> float | None:
    """Return the value of a path at which the energy first ceases to be strongly elliptic.

    Args:
        least_at: Smallest eigenvalue of the acoustic tensor [kPa] at any value of the path.
        values: Values of the path, from rest on, (n,).
        least: Smallest eigenvalues there [kPa], (n,).
        zero: Eigenvalue up to which ellipticity is lost [kPa].

    Returns:
        The value; None if the energy is elliptic up to the end, or to a state without equilibrium.
    """
    is_lost = ~(least > zero)
    k = int(is_lost.argmax())
    if not is_lost[k] or np.isnan(least[k]):
        return None
    if k == 0:
        return float(values[0])

    def margin(value: float) -> float:
        return least_at(value) - zero

    try:
        return float(scipy.optimize.brentq(margin, values[k - 1], values[k], xtol=1e-9))
    except (RuntimeError, ValueError):  # a state between the two has no equilibrium
        return float(values[k])
