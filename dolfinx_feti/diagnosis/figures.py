# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Figures of a torn matrix and of the solver that was set up for it, over all processes.

The weights of the copies differ as the stiffnesses k of the subdomains at a dof do; their jump is
the greatest :math:`k_i / \min_j k_j` over the copies i, j of a dof. The condensed pressure raises
the diagonal of K in the ratio of κ to the shear modulus; its mean share over the dofs, and the
number of pressures for each dof, tell whether the volume constraint locks the elements.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.lasting import Form
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import join
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.matrix import Torn

__all__ = ["Figure", "collect_figures", "residual_shares"]

#: A number, words, the least, mean and greatest of a number, or a list of counts.
Figure: TypeAlias = float | str | tuple[float, float, float] | list[int]


def collect_figures(form: Form) -> dict[str, Figure]:
    """Gather the figures of all processes, by the names that a diagnosis prints. Collective."""
    torn, copies = form.pattern.torn, form.pattern.torn.multiplicity()
    comm, torn_copies = torn.comm, torn.tear(copies)

    def spread(values: Sequence[float]) -> tuple[float, float, float]:
        v = join(values, comm).astype(float)
        return (float(v.min()), float(v.mean()), float(v.max())) if len(v) else (np.nan,) * 3

    counts = np.bincount(copies, minlength=comm.allreduce(copies.max(initial=0), op=MPI.MAX) + 1)
    figures: dict[str, Figure] = {
        "dofs of a subdomain": spread([len(dofs) for dofs in torn.subdomains]),
        "interface share": spread(
            [float(np.mean(torn_copies[dofs] > 1)) for dofs in torn.subdomains]
        ),
        "subdomains / process": spread([len(torn.subdomains)]),
        "dofs / process": spread([torn.n]),
        "MiB / process": spread([form.memory()]),
        "dofs by copies": [int(n) for n in comm.allreduce(counts)[1:]],
        "jump of stiffness": _jump(torn),
        "rigid body modes": _motions(torn),
        "null vectors": comm.allreduce(sum(m.null for m in form.modes)),
    }
    pressures, before = torn.pressures, torn.A.query("stiffness")
    if pressures is not None and before is not None:
        free = torn.assemble((~torn.dirichlet).astype(np.float64)) > 0.5
        parts = np.array([pressures, free.sum(), *map(_size, (torn.diagonal(), before.array_r))])
        p, n, raised, own = np.where((total := comm.allreduce(parts)) > 0.0, total, np.nan)
        figures |= {"pressures per dof": float(p / n), "stiffer by pressures": float(raised / own)}
    return figures


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
    """Return the greatest ratio of the stiffnesses of the copies of a dof. Collective."""
    k, counts = torn.gather(torn.stiffness()), torn.multiplicity()
    jump = 1.0
    if len(k):
        first = (np.cumsum(counts) - counts)[counts > 0]
        least, most = np.minimum.reduceat(k, first), np.maximum.reduceat(k, first)
        jump = float(np.max(most / np.where(least > 0.0, least, np.inf), initial=1.0))
    return torn.comm.allreduce(jump, op=MPI.MAX)


def _motions(torn: Torn) -> str:
    """Say what the near kernel of the problem is."""
    near_kernel = torn.A.getNearNullSpace()
    modes = len(near_kernel.getVecs()) if near_kernel.handle else 1
    bs = torn.A.getBlockSize()
    if bs in (2, 3) and modes == bs * (bs + 1) // 2:
        return f"{bs} translations, {modes - bs} rotation{'s' if modes - bs > 1 else ''}"
    return "1 constant" if modes == 1 else f"{modes} constants"


def _size(values: Array) -> float:
    return float(np.abs(values).sum())
