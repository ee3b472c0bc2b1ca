# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The estimated error η of an approximate solution x: its preconditioned residual, by components.

.. math:: η = \max_c \frac{\|z_c\|}{\bigl(\|x_c\|^2 + \sum_{d ≠ c} C_{cd}^2 \|x_d\|^2\bigr)^{1/2}},
          \quad z = M (b - A x), \qquad
          C_{cd}^2 = \operatorname{mean}_i \sum_j \frac{a_{ci,dj}^2}{a_{ci,ci}^2}

for the components c of a block of dofs, with the preconditioner M of either formulation;
:math:`a_{ci,dj}` is the entry of A in the row of component c of block i, and the column of
component d of block j. η does not depend on the unit of any unknown or equation:

- Each z_c is compared with x of the same component: a temperature does not hide a displacement.
- :math:`C_{cd} \|x_d\|` is the contribution of component d to x_c through A. An x_c in which such
  contributions cancel, like u_x of a bent strip, is accurate to their rounding only. If
  :math:`C_{cd} C_{dc} > 1`, as with a condensed pressure, both factors are divided by the root of
  this product.
- A component that may be zero, because no load acts on it or because it is tiny in a state, is
  compared in units of energy: :math:`w_c \|z_c\|` with
  :math:`(\sum_d w_d^2 \|x_d\|^2)^{1/2}`, where :math:`w_c^2` is the median of the diagonal of A
  for c.

C and w are means and medians over sampled rows of the torn matrices K instead of A: their rows are
on one process, and a dof on the interface counts as several.

The *references* of η are the vectors in the denominator: x and others, whose squares are added.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from dolfinx_feti.runtime.arrays import Array, Integers, Mask
from dolfinx_feti.runtime.collective import total_of
from dolfinx_feti.runtime.petsc_library import csr_of
from dolfinx_feti.torn.matrix import Torn
from dolfinx_feti.torn.rounding import EPS

#: Number of blocks of rows on each process, evenly spread, over which C² is averaged: this number
#: to nearly twice as many. Half as many change C² by a few percent; all blocks would take as long
#: as some products with K.
MIN_SAMPLED_BLOCKS = 500

#: Largest load of a component, relative to the largest one, that counts as zero; both in units of
#: energy. With half of it, cancellation in the sum over the cells of a dof would count as a load;
#: with ten times as much, a component with a small load would not be compared with itself.
ZERO_LOAD_SHARE = 100.0 * EPS

#: Largest norm of a component of a state, relative to all components, that counts as zero; both in
#: units of energy. It is the default tolerance of a solve: M mixes errors of about this size into a
#: component that should be zero.
ZERO_STATE_SHARE = 1e-8


class ComponentNorms:
    """Norms of a vector by components, with which η is computed.

    Attributes:
        bs: Number of components, the block size of the matrix.
    """

    def __init__(self, torn: Torn) -> None:
        """Compute the coupling of the components in the present matrix. Collective."""
        self.bs = torn.A.getBlockSize()
        self._comm = torn.comm
        self._coupling_squares = np.zeros((self.bs, self.bs))  # C²
        self._energy_weights = np.ones(self.bs)  # w²
        if self.bs > 1:
            self._coupling_squares, self._energy_weights = _coupling_and_weights(torn)

    def for_load(self, r: Array) -> ComponentNorms:
        """Return norms for solutions with a load r, (N,). Collective.

        Components without load are compared in units of energy.
        """
        if self.bs == 1:
            return self
        squares = total_of(self.squares(r), self._comm)
        energies = squares / self._energy_weights  # ‖r_c‖²/w_c²
        return self._compared_by_energy(energies <= ZERO_LOAD_SHARE**2 * energies.max())

    def for_state(self, x: Array) -> ComponentNorms:
        """Return norms for changes of a state x, (N,). Collective.

        Tiny components are compared in units of energy.
        """
        if self.bs == 1:
            return self
        squares = total_of(self.squares(x), self._comm)
        energies = squares * self._energy_weights  # w_c² ‖x_c‖²
        return self._compared_by_energy(energies <= ZERO_STATE_SHARE**2 * energies.sum())

    def _compared_by_energy(self, components: Mask) -> ComponentNorms:
        """Return norms that compare some components in units of energy.

        Args:
            components: Mask of these components, (bs,).
        """
        norms = copy(self)
        w_squares = self._energy_weights
        in_energy = w_squares[None, :] / w_squares[:, None]  # (w_d / w_c)², in place of C_cd²
        np.fill_diagonal(in_energy, 0.0)  # ‖x_c‖² itself is added to the sum
        norms._coupling_squares = np.where(components[:, None], in_energy, self._coupling_squares)
        return norms

    def largest_ratio(self, z_squares: Array, x_squares: Array) -> float:
        """Return η, the largest over the components, from sums of squares.

        Args:
            z_squares: ‖z_c‖² over all processes, (bs,).
            x_squares: ‖x_c‖² likewise, summed over all references.

        Returns:
            η: zero for z = 0, infinite if z_c ≠ 0 and its denominator is zero, nan if z is not
            finite.
        """
        if not np.all(np.isfinite(z_squares)):
            return np.nan
        denominators = x_squares + self._coupling_squares @ x_squares  # ‖x_c‖² + Σ_d C_cd² ‖x_d‖²
        η_squares = np.full(self.bs, np.inf)
        np.divide(z_squares, denominators, out=η_squares, where=denominators > 0.0)
        η_squares[z_squares == 0.0] = 0.0
        return float(np.sqrt(η_squares.max()))

    def total_ratio(self, z_squares: Array, x_squares: Array) -> float:
        """Return ‖z‖/‖x‖ of all components together, in units of energy, from sums of squares.

        Args:
            z_squares: ‖z_c‖² over all processes, (bs,).
            x_squares: ‖x_c‖² likewise, summed over all references.
        """
        z = self._energy_weights @ z_squares  # Σ w_c² ‖z_c‖²
        x = self._energy_weights @ x_squares
        if z == 0.0:
            return 0.0
        return float(np.sqrt(z / x)) if x > 0.0 else np.inf

    def ratios_of_correction(self, z: Array, references: Sequence[Array]) -> tuple[float, float]:
        """Return the estimated error η by which a correction z changes a solution. Collective.

        Args:
            z: The correction, (N,).
            references: Vectors that it is relative to, (N,) each; their squares are added.

        Returns:
            η, the largest over the components (:meth:`largest_ratio`), and η of all components
            together (:meth:`total_ratio`).
        """
        local = np.array([self.squares(vector) for vector in (z, *references)])
        z_squares, *reference_squares = self._comm.allreduce(local)
        x_squares = np.sum(reference_squares, axis=0)
        largest = self.largest_ratio(z_squares, x_squares)
        return largest, self.total_ratio(z_squares, x_squares)

    def squares(self, x: Array) -> Array:
        """Return this process's part of ‖x_c‖², (bs,), of an assembled vector, (N,)."""
        return np.asarray((x.reshape(-1, self.bs) ** 2).sum(axis=0))

    def components_of(self, dofs: Integers) -> Integers | None:
        """Return the component of each of some torn dofs, in an array of the same length.

        It is None if the dofs are full blocks in order. The components of a vector are then the
        columns of the vector reshaped to (blocks, bs).

        Args:
            dofs: Torn dofs, or interface dofs.
        """
        components = dofs % self.bs
        in_order = np.arange(len(dofs)) % self.bs
        has_full_blocks = len(dofs) % self.bs == 0 and np.array_equal(components, in_order)
        return None if has_full_blocks else components

    def weighted_squares(self, t: Array, weights: Array, components: Integers | None) -> Array:
        """Return this process's part of ‖x_c‖², (bs,), of a vector given by copies.

        Args:
            t: Copies T x, (n,).
            weights: Weights δ, which sum to one over the copies of a dof, (n,).
            components: Component of each copy, or None for full blocks; see
                :meth:`components_of`.
        """
        squares = weights * t * t
        if components is None:
            return np.asarray(squares.reshape(-1, self.bs).sum(axis=0))
        sums = np.bincount(components, squares, minlength=self.bs)
        return sums.astype(np.float64, copy=False)  # without dofs, they are integers


@dataclass(frozen=True, slots=True)
class ErrorTest:
    """Test of η that the outer loop gives to a Krylov method that can measure it.

    The iterate of the method is a correction, which is added to the solution of earlier starts.

    Attributes:
        norms: Norms of components.
        error_tolerance: Largest η; infinite if there is no bound.
        x: The solution of earlier starts, (N,).
        second_reference: Reference of η in addition to the solution, (N,).
    """

    norms: ComponentNorms
    error_tolerance: float
    x: Array
    second_reference: Array


def _coupling_and_weights(torn: Torn) -> tuple[Array, Array]:
    """Compute the coupling and the weights from sampled rows of all processes. Collective.

    Returns:
        C², (bs, bs), zero for c = d, and w², (bs,).
    """
    bs = torn.A.getBlockSize()
    blocks = torn.n // bs
    sampled = np.arange(0, blocks, max(1, blocks // MIN_SAMPLED_BLOCKS))
    rows = (sampled[:, None] * bs + np.arange(bs)).ravel()
    diagonal = np.abs(torn.diagonal()[rows])
    row_squares = _row_squares(torn, rows)
    share = np.zeros((len(rows), bs))
    np.divide(row_squares, diagonal[:, None] ** 2, out=share, where=diagonal[:, None] != 0.0)
    total = torn.comm.allreduce(share.reshape(-1, bs, bs).sum(axis=0))
    mean = total / max(1, torn.comm.allreduce(len(sampled)))  # C²
    mutual = np.sqrt(mean * mean.T)  # C_cd C_dc, without a unit
    coupling = mean / np.maximum(mutual, 1.0) * (1.0 - np.eye(bs))
    weights = np.median(np.vstack(torn.comm.allgather(diagonal.reshape(-1, bs))), axis=0)
    return np.asarray(coupling), np.where(weights > 0.0, weights, 1.0)


def _row_squares(torn: Torn, rows: Integers) -> Array:
    """Return Σ_j a_{ci,dj}² of some rows of K by the components d of the columns, (rows, bs)."""
    bs = torn.A.getBlockSize()
    with csr_of(torn.K) as csr:
        # Where the entries of these rows are in the CSR arrays, one row after the other, and to
        # which of the rows each belongs.
        first = csr.indptr[rows]
        length = csr.indptr[rows + 1] - first
        row = np.repeat(np.arange(len(rows)), length)
        number_in_row = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
        entry = first[row] + number_in_row
        row_and_component = row * bs + csr.indices[entry] % bs
        entry_squares = csr.values[entry] ** 2
        squares = np.bincount(row_and_component, entry_squares, minlength=len(rows) * bs)
    return np.asarray(squares.reshape(-1, bs), dtype=np.float64)
