# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Figures of a torn matrix and of the solver that was set up for it, over all processes.

The weights of the copies differ as the stiffnesses k of the subdomains at a dof do. Their jump is
the greatest

.. math:: k_i / \min_j k_j

over the copies i, j of a dof. The condensed pressure raises the diagonal of K in the ratio of κ to
the shear modulus; its mean share over the dofs, and the number of pressures for each dof, tell
whether the volume constraint locks the elements.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.form import Form
from dolfinx_feti.feti.report import Report
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import join
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.matrix import Torn

__all__ = ["Figures", "Spread", "collect_figures", "residual_shares"]


@dataclass(frozen=True, slots=True)
class Spread:
    """The least, mean and greatest of some values; nan without any."""

    least: float
    mean: float
    most: float

    @staticmethod
    def of(values: npt.ArrayLike) -> Spread:
        """Return the spread of values."""
        v = np.asarray(values, dtype=float)
        return Spread(v.min(), v.mean(), v.max()) if v.size else Spread(np.nan, np.nan, np.nan)


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of one solver, the same on all processes.

    Attributes:
        report: What ``-ksp_view`` shows.
        dofs_subdomain: Dofs of a subdomain.
        interface: Share of a subdomain's dofs that are on its interface.
        subdomains_process: Subdomains of a process.
        dofs_process: Torn dofs of a process.
        factor_mib_process: Memory of the local factors of a process [MiB].
        multiplicities: Number of dofs with 1, 2, … copies.
        jump: Greatest ratio of the stiffnesses of the copies of a dof.
        rigid: Rigid body modes of a subdomain.
        null: Null vectors in addition to them, of all subdomains.
        motions: What the rigid body modes are.
        pressures_per_dof: Condensed pressures over dofs without a prescribed value; zero without.
        pressure_stiffness: Factor by which the condensed pressure raises the diagonal of K, in the
            mean; one without.
    """

    report: Report
    dofs_subdomain: Spread
    interface: Spread
    subdomains_process: Spread
    dofs_process: Spread
    factor_mib_process: Spread
    multiplicities: tuple[int, ...]
    jump: float
    rigid: Spread
    null: int
    motions: str
    pressures_per_dof: float
    pressure_stiffness: float


def collect_figures(form: Form, report: Report) -> Figures:
    """Gather the figures of all processes from what was set up, and its report. Collective."""
    torn, modes = form.pattern.torn, form.modes
    comm = torn.comm
    sizes = join([len(dofs) for dofs in torn.subdomains], comm)
    copies = torn.tear(torn.multiplicity())
    on_interface = join([np.mean(copies[dofs] > 1) for dofs in torn.subdomains], comm)
    counts = np.bincount(torn.multiplicity(), minlength=1)
    length = comm.allreduce(len(counts), op=MPI.MAX)
    multiplicities = comm.allreduce(np.pad(counts, (0, length - len(counts))))
    pressures, stiffness = _pressure(torn)
    return Figures(
        report=report,
        dofs_subdomain=Spread.of(sizes),
        interface=Spread.of(on_interface),
        subdomains_process=Spread.of(join([len(torn.subdomains)], comm)),
        dofs_process=Spread.of(join([torn.n], comm)),
        factor_mib_process=Spread.of(join([form.memory()], comm)),
        multiplicities=tuple(int(n) for n in multiplicities[1:]),
        jump=_jump(torn),
        rigid=Spread.of(join([m.rigid for m in modes], comm)),
        null=comm.allreduce(sum(m.null for m in modes)),
        motions=_motions(torn),
        pressures_per_dof=pressures,
        pressure_stiffness=stiffness,
    )


def residual_shares(A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec) -> Array:
    """Return the part of each subdomain in ‖b − A x‖, (subdomains,). Collective.

    A dof counts in equal parts for the subdomains that share it; the squares sum to that of the
    norm.
    """
    with Lifetime() as owned:
        torn, r = owned.own(Torn(A)), owned.own(b.duplicate())
        torn.residual(b, x, r)
        squares = torn.tear(r.array_r) ** 2 / torn.tear(torn.multiplicity())
        parts = join([squares[dofs].sum() for dofs in torn.subdomains], torn.comm)
    return np.sqrt(parts)


def _jump(torn: Torn) -> float:
    """Return the greatest ratio of the stiffnesses of the copies of a dof."""
    k = torn.gather(torn.stiffness())
    counts = torn.multiplicity()
    first = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(int)[counts > 0]
    if not len(first):
        return torn.comm.allreduce(1.0, op=MPI.MAX)
    least, most = np.minimum.reduceat(k, first), np.maximum.reduceat(k, first)
    jumps = most / np.where(least > 0.0, least, np.inf)
    return torn.comm.allreduce(float(max(jumps.max(), 1.0)), op=MPI.MAX)


def _motions(torn: Torn) -> str:
    """Say what the near kernel of the problem is."""
    near_kernel = torn.A.getNearNullSpace()
    modes = len(near_kernel.getVecs()) if near_kernel.handle else 1
    bs = torn.A.getBlockSize()
    if bs in (2, 3) and modes == bs * (bs + 1) // 2:
        return f"{bs} translations, {modes - bs} rotation{'s' if modes - bs > 1 else ''}"
    return "1 constant" if modes == 1 else f"{modes} constants"


def _pressure(torn: Torn) -> tuple[float, float]:
    """Return the condensed pressures over free dofs, and how much stiffer they make the dofs."""
    pressures, before = torn.pressures, torn.A.query("stiffness")
    comm = torn.comm
    free = comm.allreduce(float(np.sum(torn.assemble((~torn.dirichlet).astype(np.float64)) > 0.5)))
    if pressures is None or before is None:
        return 0.0, 1.0
    raised, own = (
        comm.allreduce(float(np.abs(d).sum())) for d in (torn.diagonal(), before.array_r)
    )
    cells = comm.allreduce(pressures)
    return cells / free if free else 0.0, raised / own if own else 1.0
