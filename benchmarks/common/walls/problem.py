# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A two-layer wall with fibres and a condensed pressure, as in the paper's load stepping."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl
from ufl.core.expr import Expr

from benchmarks.common.bodies import Body, Support, create_body
from benchmarks.common.records import Record
from dolfinx_feti import kinematics, loads, materials
from dolfinx_feti.meshes.tube import INNER_RADIUS, MEDIA
from dolfinx_feti.meshes.walls import create_tube_wall, open_wall
from dolfinx_feti.runtime.arrays import Array, Integers
from dolfinx_feti.wall import Wall, facets, openings
from dolfinx_feti.wall.fibres import ANGLES, fibre_families, fibre_frame

INTERFACE = INNER_RADIUS + MEDIA  # mm, between the layers of the tube

#: Length of a clamped tube [mm].
LENGTH = 3.0
#: Displacement dofs of this tube over the squared number of elements along its axis, by degree.
DOFS_ALONG = {1: 18.0, 2: 125.0}

#: Length of the elements' edges of a vessel whose number of dofs is known [mm].
SIZE = 2.0
#: Displacement dofs of this vessel, by degree.
DOFS = {1: 11_000, 2: 71_430}

#: |J_τ − 1| above which an element counts into ``share_J``.
NOTICEABLE = 0.01


def create_wall_problem(
    wall: Wall,
    *,
    subdomains: int | Integers | None,
    petsc_options: dict[str, object],
    c: float | None = None,
    prefix: str = "wall_",
    fibres: tuple[Expr, Expr] | None = None,
    volume_tolerance: float | None = None,
    supports: Sequence[Support] | None = None,
    **further: object,
) -> Body:
    """Build the torn problem of a wall at rest, with a pressure in its lumen. Collective.

    Args:
        wall: Mesh and tags.
        subdomains: Their number, or a part for each owned cell; None for the default.
        petsc_options: Options without prefix.
        c: Stiffness of the matrix material [kPa]; the paper's if None.
        prefix: Prefix of PETSc's options.
        fibres: Both families, unit vectors; from Laplace problems if None.
        volume_tolerance: Bound of |mean J − 1| of each cell, met by multipliers in place of a
            large κ; None without.
        supports: Components and facets with u = 0; all components on all openings if None.
        further: Further arguments of ``create_body``; ``degree`` and ``kappa`` [kPa] among them.
    """
    artery = materials.ArteryParameters()
    a1, a2 = fibres or fibre_families(wall, fibre_frame(wall))
    parameters = {"c": c or artery.c, "k1": artery.k1, "k2": artery.k2}
    if supports is None:
        supports = [(None, np.concatenate([facets(wall, name) for name in openings(wall)]))]
    defaults = {"pressures": ("DG", 0), "tangent": "symmetric", "use_pressure_potential": True}
    body = create_body(
        wall.mesh,
        lambda C, J, _share: materials.holzapfel_gasser_ogden(C, a1, a2, **parameters, J=J),
        supports=supports,
        loaded=facets(wall, "lumen"),
        pressure=1.0,  # kPa: the load factor is the pressure
        settings={
            "subdomains": subdomains,
            "petsc_options": petsc_options,
            "petsc_options_prefix": prefix,
            "volume_tolerance": volume_tolerance,
        },
        **(defaults | further),
    )
    return replace(body, unit=loads.mmhg(1.0))


def create_clamped(
    comm: MPI.Comm, geometry: str, *, dofs: int, folder: Path, degree: int, **settings: object
) -> Body:
    """Build a tube, three elements thick, or vessel, two, clamped at its openings. Collective.

    Args:
        comm: Communicator.
        geometry: ``tube`` or ``vessel``, which is also the prefix of PETSc's options.
        dofs: Approximate number of displacement dofs; 50 000 at least for the vessel.
        folder: Where the mesh of the vessel is kept.
        degree: Degree of the displacement.
        settings: Arguments of :func:`create_wall_problem`.
    """
    if geometry == "tube":
        along = max(2, round(np.sqrt(dofs / DOFS_ALONG[degree])))
        wall = create_tube_wall(
            comm, length=LENGTH, through=(2, 1), around=3 * along // 2, along=along
        )
        settings["fibres"] = tube_fibres(wall.mesh)
    else:
        size = SIZE * (DOFS[degree] / dofs) ** 0.5  # it is a surface
        wall, _ = open_wall("vessel", comm, size=size, folder=folder)
    return create_wall_problem(wall, degree=degree, prefix=f"{geometry}_", **settings)


def tube_fibres(mesh: dolfinx.mesh.Mesh) -> tuple[dolfinx.fem.Function, dolfinx.fem.Function]:
    """Return the two families of helices of a tube, cos α e_θ ± sin α e_z, in each cell."""
    space = dolfinx.fem.functionspace(mesh, ("DG", 0, (3,)))
    families = dolfinx.fem.Function(space), dolfinx.fem.Function(space)

    def helix(x: Array, sign: float) -> Array:
        r = np.hypot(x[0], x[1])
        α = np.deg2rad(np.where(r < INTERFACE, ANGLES["media"], ANGLES["adventitia"]))
        return np.array([-x[1] / r * np.cos(α), x[0] / r * np.cos(α), sign * np.sin(α)])

    for family, sign in zip(families, (1.0, -1.0), strict=True):
        family.interpolate(lambda x, sign=sign: helix(x, sign))
    return families


def volume_ratios(u: dolfinx.fem.Function) -> Array:
    """Return J_τ, the mean of det F over τ, of the owned cells τ, (n_cells,). Collective.

    A pressure that is constant in each cell keeps J_τ near one. With P2, det F still varies inside
    each cell.
    """
    mesh = u.function_space.mesh
    q = ufl.TestFunction(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    cubic = 3 * (u.function_space.ufl_element().embedded_superdegree - 1)
    dx = ufl.dx(metadata={"quadrature_degree": cubic})
    J = kinematics.jacobian(kinematics.deformation_gradient(u))
    one = dolfinx.fem.Constant(mesh, 1.0)
    deformed, rest = (dolfinx.fem.assemble_vector(dolfinx.fem.form(f * q * dx)) for f in (J, one))
    n = mesh.topology.index_map(mesh.topology.dim).size_local
    return deformed.array[:n] / rest.array[:n]


def summarise(J: Array, comm: MPI.Comm) -> Record:
    """Return least, mean and greatest J_τ, the mean of |J_τ − 1|, and the share above NOTICEABLE.

    Collective.
    """
    off = np.abs(J - 1.0)
    sums = [len(J), J.sum(), off.sum(), np.count_nonzero(off > NOTICEABLE)]
    count, total, deviation, noticeable = comm.allreduce(np.array(sums, dtype=float)).tolist()
    return {
        "min_J": comm.allreduce(float(J.min(initial=np.inf)), op=MPI.MIN),
        "mean_J": total / count,
        "max_J": comm.allreduce(float(J.max(initial=-np.inf)), op=MPI.MAX),
        "mean_deviation_J": deviation / count,
        "share_J": noticeable / count,
    }
