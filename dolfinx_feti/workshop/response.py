# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Response curves: the stresses of a material along a path.

With the pressure p of an incompressible material, or p = κ (J − 1), P = ∂Ψ/∂F + p cof F is the
first Piola stress (force per reference area) and σ = J⁻¹ P Fᵀ the Cauchy stress (force per deformed
area).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dolfinx_feti.runtime.tables import state, table
from dolfinx_feti.workshop.compiled import Material, evaluate
from dolfinx_feti.workshop.equilibrium import cofactor, equilibrate
from dolfinx_feti.workshop.paths import Path

__all__ = ["Response", "respond"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Response:
    """Stresses along a path; ``str`` prints a table.

    All tensors are in the loading frame. States for which no equilibrium was found hold NaN.

    Attributes:
        path: The path.
        F: Deformation gradients, (n, 3, 3).
        p: Pressures, positive in tension [kPa], (n,); zero for a complete energy.
        psi: Energies per unit reference volume, with κ/2 (J − 1)² [kPa], (n,).
        P: First Piola stresses [kPa], (n, 3, 3).
        sigma: Cauchy stresses [kPa], (n, 3, 3).
        converged: Whether the state was found, (n,).
    """

    path: Path
    F: Array
    p: Array
    psi: Array
    P: Array
    sigma: Array
    converged: npt.NDArray[np.bool_]

    @property
    def J(self) -> Array:
        """Volume ratios det F, (n,)."""
        return _volume_ratio(self.F)

    def __str__(self) -> str:
        """Return a table of stretches and stresses."""
        head = [self.path.symbol]
        columns = [self.path.values]
        for i, k in self.path.measured:
            head += [f"P{i + 1}{k + 1} [kPa]", f"σ{i + 1}{k + 1} [kPa]"]
            columns += [self.P[:, i, k], self.sigma[:, i, k]]
        head += ["F22", "F33", "J"]
        columns += [self.F[:, 1, 1], self.F[:, 2, 2], self.J]
        lines = [
            self.path.name,
            table(head, [list(map(float, row)) for row in zip(*columns, strict=True)]),
        ]
        lost = np.flatnonzero(~self.converged)
        if len(lost):
            where = state(self.path.symbol, self.path.values[lost[0]])
            lines.append(f"no equilibrium in {len(lost)} states, the first at {where}")
        return "\n".join(lines)


def respond(material: Material, path: Path) -> Response:
    """Compute the stresses of a material along a path.

    Args:
        material: The compiled energy.
        path: Homogeneous deformations, see :mod:`~dolfinx_feti.workshop.paths`.

    Raises:
        ValueError: The material is incompressible, and the path has no free entries.
    """
    equilibria = equilibrate(material, path.F, path.free)
    R, n = path.frame, len(path.F)
    psi, P, F = np.full(n, np.nan), np.full((n, 3, 3), np.nan), R.T @ equilibria.F @ R
    if equilibria.converged.any():
        states = evaluate(material, equilibria.F[equilibria.converged])
        p = equilibria.p[equilibria.converged, None, None] if material.incompressible else 0.0
        psi[equilibria.converged] = states.psi
        P[equilibria.converged] = R.T @ (states.P + p * cofactor(states.F)) @ R
    sigma = P @ F.transpose(0, 2, 1) / _volume_ratio(F)[:, None, None]
    return Response(path, F, equilibria.p, psi, P, sigma, equilibria.converged)


def _volume_ratio(F: Array) -> Array:
    """J, NaN where F is."""
    with np.errstate(invalid="ignore"):
        return np.linalg.det(F)
