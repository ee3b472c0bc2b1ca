# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The modes R of the subdomains, their stand-ins E and their defects D, for one matrix.

.. math:: E = ρ\, K_ρ^{-1} R, \qquad D = ρ\, (I - R^⊤ E),

which ``pseudoinverse`` finds, and from which the coarse problem and the preconditioner are made.
With :math:`K R = 0` they are :math:`E = R` and :math:`D = 0` (eq. 39, Augustin_eq:localSolutions).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Modes", "SubdomainModes"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class SubdomainModes:
    """The modes of one subdomain for one matrix, on the dofs of its matrix.

    Attributes:
        R: Orthonormal modes, (n_i, k).
        E: The kernel or its regularised stand-in, (n_i, k).
        E_left: The same for :math:`K^⊤`.
        D: Defect of the kernel, (k, k); zero while K R = 0.
        props: Columns Z of K₊ = K + Z Zᵀ, (n_i, negative eigenvalues of D).
        exact: Whether K R = 0 holds.
        rho: The stiffness ρ.
        rigid: Number of rigid body modes, the first ones of R.
        null: Number of further null vectors, the next ones.
    """

    R: Array
    E: Array
    E_left: Array
    D: Array
    props: Array
    exact: bool
    rho: float
    rigid: int
    null: int


@dataclass(frozen=True, slots=True)
class Modes:
    """The modes of all subdomains of this process for one matrix.

    Attributes:
        dofs: Torn dofs of each subdomain on which its modes live.
        of: The modes of each subdomain.
        symmetric: Whether K is symmetric: then E_left = E.
    """

    dofs: list[Indices]
    of: tuple[SubdomainModes, ...]
    symmetric: bool

    @property
    def R(self) -> list[Array]:
        """The orthonormal modes of each subdomain."""
        return [modes.R for modes in self.of]

    @property
    def E(self) -> list[Array]:
        """The kernel of each subdomain, or its stand-in."""
        return [modes.E for modes in self.of]

    @property
    def E_left(self) -> list[Array]:
        """The same for the transposed matrices."""
        return [modes.E_left for modes in self.of]

    @property
    def D(self) -> list[Array]:
        """The defect of each kernel."""
        return [modes.D for modes in self.of]

    @property
    def props(self) -> list[Array]:
        """The props of each subdomain."""
        return [modes.props for modes in self.of]

    @property
    def exact(self) -> list[bool]:
        """Whether K R = 0 holds, for each subdomain."""
        return [modes.exact for modes in self.of]

    @property
    def rho(self) -> Array:
        """The stiffness ρ of each subdomain."""
        return np.array([modes.rho for modes in self.of])

    @property
    def dimensions(self) -> npt.NDArray[np.int64]:
        """Number of modes of each subdomain."""
        return np.array([modes.R.shape[1] for modes in self.of], dtype=np.int64)

    @property
    def kernels(self) -> npt.NDArray[np.int64]:
        """Number of those that are no elastic ones: rigid body modes and null vectors."""
        return np.array([modes.rigid + modes.null for modes in self.of], dtype=np.int64)

    @property
    def negative_defects(self) -> int:
        """Number of negative eigenvalues of all D, above rounding."""
        return sum(modes.props.shape[1] for modes in self.of)
