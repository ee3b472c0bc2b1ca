# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Decompositions in which one subdomain touches the clamped rim in a few points, or not at all.

"It may happen that the decomposition of a mesh results in subdomains that have only a few points on
the Dirichlet boundary" (section *Arterial model on a realistic mesh geometry*): in classical FETI
such a subdomain is held, though hardly, and has no kernel that the coarse problem could take over.
Here one is made on purpose: from a subdomain on the rim the cells on the rim are cut off, as
subdomains of their own, all of them (``none``) or all but a few that touch it in three points
(``few``). The two decompositions differ in these few cells alone.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx

from dolfinx_feti.fem.decomposition import decompose
from dolfinx_feti.wall import Wall, facets, openings

__all__ = ["CONTACTS", "Parts", "partition"]

Parts = npt.NDArray[np.int32]

#: How the chosen subdomain meets the rim: as the decomposition has it, in three points, not at all.
CONTACTS = ("whole", "few", "none")

#: Points of the rim that it keeps.
POINTS = 3


def partition(wall: Wall, subdomains: int, contact: str) -> Parts:
    """Return a part for each owned cell, (n_cells,). Collective.

    Args:
        wall: The wall; its openings are clamped.
        subdomains: Their number, before a rim is cut off.
        contact: One of :data:`CONTACTS`.

    Raises:
        ValueError: No subdomain serves. On all processes.
    """
    mesh = wall.mesh
    part = decompose(mesh, subdomains).subdomain
    if contact == "whole":
        return part
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    cells = V.dofmap.list[: len(part)]
    rims = np.concatenate([facets(wall, name) for name in openings(wall)])
    held = np.isin(cells, dolfinx.fem.locate_dofs_topological(V, 2, rims))  # (n_cells, 4)
    on_rim = held.any(axis=1)
    single = held.sum(axis=1) == 1
    point = np.where(held, cells, -1).max(axis=1, initial=-1)
    parts = range(int(part.max(initial=-1)) + 1)
    points = [np.unique(point[single & (part == i)]) for i in parts]
    rim, inside = (np.bincount(part[where], minlength=len(parts)) for where in (on_rim, ~on_rim))
    fit = (inside > rim) & (np.array([len(found) for found in points], dtype=int) >= POINTS)
    candidates = np.where(fit, rim, 0)
    best = (int(candidates.max(initial=0)), -mesh.comm.rank)
    most, owner = mesh.comm.allreduce(best, op=MPI.MAX)
    if most == 0:
        raise ValueError(
            f"subdomains={subdomains}: none of them touches a rim in {POINTS} points or more and "
            "has most of its cells elsewhere: take fewer, refine the mesh, or ask for "
            "--contact whole only."
        )
    if mesh.comm.rank != -owner:
        return part
    chosen = int(candidates.argmax())
    cut = on_rim & (part == chosen)
    if contact == "few":
        few = _near(V, points[chosen])
        cut &= (held & ~np.isin(cells, few)).any(axis=1)  # stays if it touches these points only
    return np.where(cut, part.max() + 1, part).astype(np.int32)


def _near(V: dolfinx.fem.FunctionSpace, points: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """Return the first of some points and those nearest to it."""
    X = V.tabulate_dof_coordinates()[points]
    order = np.argsort(np.linalg.norm(X - X[:1], axis=1), kind="stable")
    return points[order[:POINTS]]
