# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Figures, numbers that describe a torn problem: sizes, copies, stiffness, pressures.

The jump of the stiffness is the largest :math:`k_i / \min_j k_j` over all dofs, where i and j are
copies of the dof, and k their stiffnesses. The condensed pressure multiplies the diagonal of K by
about the ratio of κ to the shear modulus. This factor, and the number of pressures per dof,
indicate whether the volume constraint locks the elements.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx_feti.feti.formulation import Formulation
from dolfinx_feti.runtime.collective import allgather_rows
from dolfinx_feti.torn.matrix import Torn

__all__ = ["Figures", "Spread", "collect_figures", "figure_text"]


@dataclass(frozen=True, slots=True)
class Spread:
    """Smallest, mean and largest of a number over all subdomains or processes."""

    smallest: float
    mean: float
    largest: float

    def __str__(self) -> str:
        """Return the three numbers with dots between them."""
        return " … ".join(figure_text(value) for value in (self.smallest, self.mean, self.largest))


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of a torn problem. The same on all processes.

    Attributes:
        dofs_per_subdomain: Dofs of a subdomain.
        interface_share: Share of the dofs of a subdomain that have copies in other subdomains.
        subdomains_per_process: Subdomains of a process.
        dofs_per_process: Torn dofs of a process.
        mib_per_process: Memory of the solver on a process [MiB].
        dofs_by_copies: Number of dofs with one, two, … copies.
        stiffness_jump: Largest ratio of the stiffnesses of two copies of a dof.
        near_kernel: The near kernel in words: translations and rotations, or constants.
        null_vectors: Number of null vectors of all subdomains that are not rigid modes.
        pressures_per_dof: Number of condensed pressures over that of free dofs; None without
            condensed pressures.
        pressure_stiffening: Mean diagonal entry of K after the condensation of the pressures over
            that before it; None without condensed pressures.
    """

    dofs_per_subdomain: Spread
    interface_share: Spread
    subdomains_per_process: Spread
    dofs_per_process: Spread
    mib_per_process: Spread
    dofs_by_copies: tuple[int, ...]
    stiffness_jump: float
    near_kernel: str
    null_vectors: int
    pressures_per_dof: float | None
    pressure_stiffening: float | None

    def rows(self) -> list[tuple[str, str]]:
        """Return a row of a table for each figure: its label and its value."""
        counts = ", ".join(figure_text(count) for count in self.dofs_by_copies)
        rows = [
            ("dofs of a subdomain", str(self.dofs_per_subdomain)),
            ("interface share", str(self.interface_share)),
            ("subdomains / process", str(self.subdomains_per_process)),
            ("dofs / process", str(self.dofs_per_process)),
            ("MiB / process", str(self.mib_per_process)),
            ("dofs by copies", counts),
            ("jump of stiffness", figure_text(self.stiffness_jump)),
            ("rigid body modes", self.near_kernel),
            ("null vectors", figure_text(self.null_vectors)),
        ]
        if self.pressures_per_dof is not None and self.pressure_stiffening is not None:
            rows.append(("pressures per dof", figure_text(self.pressures_per_dof)))
            rows.append(("stiffer by pressures", figure_text(self.pressure_stiffening)))
        return rows


def figure_text(value: float) -> str:
    """Return a number with three digits, an integer from 100 on; a dash for nan."""
    if np.isnan(value):
        return "–"
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def collect_figures(formulation: Formulation) -> Figures:
    """Return the figures of a solver's problem over all processes. Collective."""
    torn = formulation.pattern.torn
    comm = torn.comm
    multiplicity = torn.multiplicity()
    torn_multiplicity = torn.tear(multiplicity)
    most_copies = comm.allreduce(multiplicity.max(initial=0), op=MPI.MAX)
    counts = comm.allreduce(np.bincount(multiplicity, minlength=most_copies + 1))
    shares = [float(np.mean(torn_multiplicity[dofs] > 1)) for dofs in torn.subdomains]
    pressures_per_dof, pressure_stiffening = _pressure_figures(torn)
    return Figures(
        dofs_per_subdomain=_spread([len(dofs) for dofs in torn.subdomains], comm),
        interface_share=_spread(shares, comm),
        subdomains_per_process=_spread([len(torn.subdomains)], comm),
        dofs_per_process=_spread([torn.n], comm),
        mib_per_process=_spread([formulation.memory()], comm),
        dofs_by_copies=tuple(int(count) for count in counts[1:]),
        stiffness_jump=_stiffness_jump(torn),
        near_kernel=_near_kernel_in_words(torn),
        null_vectors=comm.allreduce(sum(modes.n_null for modes in formulation.modes)),
        pressures_per_dof=pressures_per_dof,
        pressure_stiffening=pressure_stiffening,
    )


def _spread(values: Sequence[float], comm: MPI.Comm) -> Spread:
    """Return the spread of values over all processes; nan if there are none. Collective."""
    everywhere = allgather_rows(values, comm).astype(float)
    if not len(everywhere):
        return Spread(np.nan, np.nan, np.nan)
    return Spread(float(everywhere.min()), float(everywhere.mean()), float(everywhere.max()))


def _stiffness_jump(torn: Torn) -> float:
    """Return the largest ratio of the stiffnesses of two copies of a dof. Collective."""
    k = torn.gather(torn.stiffness())  # all copies of the first owned dof, of the second one, …
    multiplicity = torn.multiplicity()
    first_copy = (np.cumsum(multiplicity) - multiplicity)[multiplicity > 0]
    least = np.minimum.reduceat(k, first_copy)
    most = np.maximum.reduceat(k, first_copy)
    jump = float(np.max(most / np.where(least > 0.0, least, np.inf), initial=1.0))
    return torn.comm.allreduce(jump, op=MPI.MAX)


def _pressure_figures(torn: Torn) -> tuple[float | None, float | None]:
    """Return the condensed pressures per free dof, and the factor by which they stiffen a dof.

    Both are None without condensed pressures. Collective.
    """
    without_pressure = torn.A.query("stiffness")  # the diagonal of K before the condensation
    if torn.n_condensed_pressures is None or without_pressure is None:
        return None, None
    is_free = torn.assemble((~torn.is_dirichlet_copy).astype(np.float64)) > 0.5
    pressures, dofs = torn.comm.allreduce(np.array([torn.n_condensed_pressures, is_free.sum()]))
    raised = torn.comm.allreduce(float(np.abs(torn.diagonal()).sum()))
    original = torn.comm.allreduce(float(np.abs(without_pressure.array_r).sum()))
    return _ratio(pressures, dofs), _ratio(raised, original)


def _ratio(numerator: float, denominator: float) -> float:
    """Return a ratio of two positive numbers; nan if one of them is zero."""
    if numerator > 0.0 and denominator > 0.0:
        return float(numerator / denominator)
    return np.nan


def _near_kernel_in_words(torn: Torn) -> str:
    """Return the near kernel as text: translations and rotations, or constants."""
    near_kernel = torn.A.getNearNullSpace()
    modes = len(near_kernel.getVecs()) if near_kernel.handle else 1
    block_size = torn.A.getBlockSize()
    if block_size == 2 and modes == 3:
        return "2 translations, 1 rotation"
    if block_size == 3 and modes == 6:
        return "3 translations, 3 rotations"
    return "1 constant" if modes == 1 else f"{modes} constants"
