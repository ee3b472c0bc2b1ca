# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Strong ellipticity: the least eigenvalue of the acoustic tensor over all directions.

    Q_ik(n) = 𝒜_ijkl n_j n_l,   𝒜_ijkl = J⁻¹ A_iJkL F_jJ F_lL

with a unit normal n in the deformed body. The energy is strongly elliptic at F if
m · Q(n) m > 0 for all m and n. In an incompressible material only m ⟂ n count, on which the
pressure has no effect. Where this is lost the problem becomes ill-posed: localised bands, kinks of
fibres, and results that depend on the mesh (Merodio, Ogden, Int. J. Solids Struct. 40, 2003).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.optimize

from dolfinx_feti.runtime.tables import Cell, table
from dolfinx_feti.workshop.compiled import Material, evaluate
from dolfinx_feti.workshop.directions import hemisphere, minimise, tangents
from dolfinx_feti.workshop.equilibrium import equilibrate, stiffness_scale
from dolfinx_feti.workshop.paths import MaterialTest

__all__ = ["Ellipticity", "least_eigenvalues", "scan_ellipticity"]

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

#: Eigenvalue, relative to the stiffness at rest, that counts as zero.
ZERO_EIGENVALUE = 1e-10


@dataclass(frozen=True, slots=True)
class Ellipticity:
    """The acoustic tensor along a path; ``str`` prints a table.

    Attributes:
        name: Name of the path.
        symbol: Letter of its values, λ or γ.
        values: Stretches or amounts of shear, (n,).
        least: Least eigenvalue over all directions [kPa], (n,); NaN where no equilibrium was found.
        normal: Unit normals n of the least eigenvalue, in the deformed body, (n, 3).
        polarisation: Unit vectors m of the least eigenvalue, (n, 3).
        rest: The value nearest to the reference state.
        lost: Values at which strong ellipticity is first lost above and below the state at rest;
            empty if it is not.
    """

    name: str
    symbol: str
    values: Array
    least: Array
    normal: Array
    polarisation: Array
    rest: float
    lost: tuple[float, ...]

    def __str__(self) -> str:
        """Return a table of the least eigenvalues and their directions."""
        head = [self.symbol, "least eigenvalue [kPa]", "n", "m"]
        rows: list[list[Cell]] = [
            [float(value), float(least), _vector(self.normal[k]), _vector(self.polarisation[k])]
            for k, (value, least) in enumerate(zip(self.values, self.least, strict=True))
        ]
        where = " and ".join(f"{self.symbol} = {v:.4g}" for v in self.lost) or "nowhere"
        return f"{self.name}\n{table(head, rows)}\nstrong ellipticity is lost at: {where}"


def scan_ellipticity(
    material: Material, make_path: Callable[[npt.ArrayLike], MaterialTest], values: npt.ArrayLike
) -> Ellipticity:
    """Follow the least eigenvalue of the acoustic tensor along a path.

    Args:
        material: The compiled energy.
        make_path: Path as a function of its values, such as
            :func:`~dolfinx_feti.workshop.paths.uniaxial`.
        values: Stretches or amounts of shear in ascending order, on both sides of rest, (n,).

    Raises:
        ValueError: The values are not in ascending order, or are none of the path's.
    """
    path = make_path(values)
    if (np.diff(path.values) <= 0).any():
        raise ValueError(f"values = {values!r}: give them in ascending order.")
    least, normal, polarisation = _along(material, path)
    zero = ZERO_EIGENVALUE * stiffness_scale(material)
    rest = int(np.linalg.norm(path.F - np.eye(3), axis=(1, 2)).argmin())

    def margin(value: float) -> float:
        return float(_along(material, make_path([value]))[0][0]) - zero

    lost = {
        first
        for side in (np.arange(rest, len(least)), np.arange(rest, -1, -1))
        if (first := _first_loss(margin, path.values[side], least[side] - zero)) is not None
    }
    return Ellipticity(
        path.name,
        path.symbol,
        path.values,
        least,
        normal,
        polarisation,
        float(path.values[rest]),
        tuple(sorted(lost)),
    )


def least_eigenvalues(F: Array, A: Array, *, incompressible: bool) -> tuple[Array, Array, Array]:
    """Minimise the eigenvalues of the acoustic tensor over all directions.

    Args:
        F: Deformation gradients, (n, 3, 3).
        A: Tangents ∂²Ψ/∂F∂F [kPa], finite, (n, 3, 3, 3, 3).
        incompressible: Whether only polarisations m ⟂ n count.

    Returns:
        Least eigenvalues [kPa], (n,), with their normals n and polarisations m, (n, 3) each.
    """
    J = np.linalg.det(F)[:, None, None, None, None]
    spatial = np.einsum("niJkL,njJ,nlL->nijkl", A, F, F, optimize=True) / J
    directions = hemisphere()
    bases = _polarisations(directions, incompressible)
    minima = [_least(tensor, directions, bases, incompressible) for tensor in spatial]
    values, normals, polarisations = (np.array(part) for part in zip(*minima, strict=True))
    return values, normals, polarisations


def _along(material: Material, path: MaterialTest) -> tuple[Array, Array, Array]:
    """Least eigenvalues with n and m; NaN where there is no equilibrium, or no finite tangent."""
    equilibria = equilibrate(material, path.F, path.free)
    n = len(path.F)
    least, normal, polarisation = np.full(n, np.nan), *np.full((2, n, 3), np.nan)
    if equilibria.converged.any():
        states = evaluate(material, equilibria.F[equilibria.converged])
        usable = np.flatnonzero(equilibria.converged)[states.finite]
        if len(usable):
            least[usable], normal[usable], polarisation[usable] = least_eigenvalues(
                states.F[states.finite],
                states.A[states.finite],
                incompressible=material.incompressible,
            )
    return least, normal, polarisation


def _least(
    tensor: Array, directions: Array, bases: Array, incompressible: bool
) -> tuple[float, Array, Array]:
    """Least eigenvalue of one 𝒜 over all n: the best of many directions, refined."""
    Q = np.einsum("ijkl,nj,nl->nik", tensor, directions, directions, optimize=True)
    values = np.linalg.eigvalsh(bases.transpose(0, 2, 1) @ Q @ bases)[:, 0]
    scale = np.abs(values).max() or 1.0

    def eigenpair(n: Array) -> tuple[float, Array]:
        B = _polarisations(n, incompressible)
        Q = np.einsum("ijkl,j,l->ik", tensor, n, n)
        w, V = np.linalg.eigh(B.T @ Q @ B)
        return float(w[0]), B @ V[:, 0]

    _, n = minimise(lambda n: eigenpair(n)[0] / scale, directions[values.argmin()])
    value, m = eigenpair(n)
    return value, n, m


def _polarisations(n: Array, incompressible: bool) -> Array:
    """Orthonormal basis of the polarisations, (…, 3, 2) or (…, 3, 3)."""
    return tangents(n) if incompressible else np.broadcast_to(np.eye(3), (*n.shape, 3))


def _first_loss(margin: Callable[[float], float], values: Array, margins: Array) -> float | None:
    """Where the margin first vanishes, starting at values[0]; None if not before it is NaN."""
    gone = ~(margins > 0)
    if not gone.any():
        return None
    k = int(gone.argmax())
    if np.isnan(margins[k]):
        return None
    if k == 0:
        return float(values[0])
    try:
        return float(scipy.optimize.brentq(margin, values[k - 1], values[k], xtol=1e-9))
    except (RuntimeError, ValueError):  # no equilibrium somewhere between the two
        return float(values[k])


def _vector(n: Array) -> str:
    return "(" + ", ".join(f"{x:.3f}" for x in n + 0.0) + ")"
