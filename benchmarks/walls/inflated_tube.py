# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The two-layer tube in plane strain, whole or a quarter of it, and how far it is from the truth.

Its supports (:mod:`benchmarks.walls.supports`) let it slide in the planes of its ends, so that it
remains a tube, and :mod:`benchmarks.walls.oracle` knows its radius, volume and stress.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix
import dolfinx
import ufl

from benchmarks.walls.oracle import Tube
from benchmarks.walls.problem import WallProblem, create_wall_problem
from benchmarks.walls.supports import slide
from benchmarks.walls.tube import INTERFACE, tube_fibres
from dolfinx_feti import kinematics
from dolfinx_feti._compat import geometry_dofmap
from dolfinx_feti.wall import Wall
from meshes.tube import ADVENTITIA, INNER_RADIUS, count_around
from meshes.walls import create_tube_wall

__all__ = ["TANGENTS", "InflatedTube", "create_inflated_tube", "create_slice"]

Array = npt.NDArray[np.float64]

TANGENTS = ("symmetric", "full", "none")
OUTER_RADIUS = INTERFACE + ADVENTITIA


@dataclass(frozen=True, slots=True)
class InflatedTube(WallProblem):
    """The problem of a tube, and what is compared.

    Attributes:
        samples: σ_rr, σ_θθ [kPa], J, and x, y [mm] in the reference, of each owned cell at the
            quadrature points.
        weights: Volume [mm³] that each of these points stands for, (cells, points).
    """

    samples: dolfinx.fem.Expression
    weights: Array

    def compare(self, truth: Tube) -> dict[str, float]:
        """Hold radius, thickness, volume and stress against the truth.

        Args:
            truth: The tube under the same pressure, with the same parameters.

        Returns:
            Displacements and thickness [mm]; least, greatest and mean J; of the stresses the error
            in the L2 norm over the wall, relative to that of the truth.

        Note:
            Collective.
        """
        inner, outer = (self._radial(radius) for radius in (INNER_RADIUS, OUTER_RADIUS))
        comm = self.u.function_space.mesh.comm
        rr, tt, J, x, y = np.moveaxis(self._values(), -1, 0)
        exact = _stresses(truth, np.hypot(x, y))

        def integral(values: Array) -> float:
            return comm.allreduce(float((self.weights * values).sum()))

        def error(values: Array, exact: Array) -> float:
            return float(np.sqrt(integral((values - exact) ** 2) / integral(exact**2)))

        return {
            "u_r_inner": float(inner.mean()),
            "u_r_inner_exact": float(truth.inner_displacement),
            "u_r_inner_error": float(np.abs(inner / truth.inner_displacement - 1.0).max()),
            "thickness": float(OUTER_RADIUS - INNER_RADIUS + outer.mean() - inner.mean()),
            "thickness_exact": float(truth.thickness),
            "min_J": comm.allreduce(float(J.min(initial=np.inf)), op=MPI.MIN),
            "max_J": comm.allreduce(float(J.max(initial=-np.inf)), op=MPI.MAX),
            "mean_J": integral(J) / integral(np.ones_like(J)),
            "mean_J_exact": float(truth.mean_jacobian),
            "stress_rr_error": error(rr, exact[0]),
            "stress_tt_error": error(tt, exact[1]),
        }

    def _radial(self, radius: float) -> Array:
        """Return u_r at the nodes at a radius, none of them on a chord; on all processes."""
        V = self.u.function_space
        n = V.dofmap.index_map.size_local
        x, u = V.tabulate_dof_coordinates()[:n], self.u.x.array.reshape(-1, 3)[:n]
        r = np.hypot(x[:, 0], x[:, 1])
        outwards = np.einsum("ij,ij->i", x[:, :2], u[:, :2]) / r
        parts = V.mesh.comm.allgather(outwards[np.isclose(r, radius, rtol=1e-9)])
        return np.concatenate(parts)

    def _values(self) -> Array:
        """Evaluate the samples, (cells, points, 5)."""
        owned = np.arange(len(self.weights), dtype=np.int32)
        values = self.samples.eval(self.u.function_space.mesh, owned)
        return np.asarray(values).reshape(*self.weights.shape, 5)


def create_slice(comm: MPI.Comm, *, size: float, quarter: bool) -> Wall:
    """Mesh a tube, as long as its elements; the whole one has the elements of four quarters.

    Args:
        comm: Communicator of the mesh.
        size: Length of the elements' edges [mm].
        quarter: Only a quarter.

    Note:
        Collective.
    """
    around = count_around(size, quarter=True) * (1 if quarter else 4)
    return create_tube_wall(comm, length=size, size=size, quarter=quarter, around=around)


def create_inflated_tube(
    wall: Wall,
    *,
    degree: int,
    c: float,
    kappa: float,
    subdomains: int,
    tangent: str = "symmetric",
    options: dict[str, object] | None = None,
) -> InflatedTube:
    """Build the tube.

    Args:
        wall: Made by :func:`create_slice`.
        degree: Degree of the displacements.
        c: Stiffness of the matrix material [kPa].
        kappa: κ [kPa].
        subdomains: Number of subdomains.
        tangent: Of the follower pressure; one of ``TANGENTS``.
        options: PETSc options of the problem, prefix ``tube_``.
    """
    mesh = wall.mesh
    body = create_wall_problem(
        wall,
        degree=degree,
        c=c,
        kappa=kappa,
        subdomains=subdomains,
        options=options or {},
        prefix="tube_",
        fibres=tube_fibres(mesh),
        hold=slide,
        tangent=tangent,
        axis=(0.0, 0.0, 1.0),
    )
    x = ufl.SpatialCoordinate(mesh)
    e_r = ufl.as_vector([x[0], x[1], 0.0]) / ufl.sqrt(x[0] ** 2 + x[1] ** 2)
    e_t = ufl.as_vector([-e_r[1], e_r[0], 0.0])
    rr, tt = (ufl.dot(e, body.stress * e) for e in (e_r, e_t))
    J = kinematics.jacobian(kinematics.deformation_gradient(body.u))
    points, weights = basix.make_quadrature(basix.CellType.tetrahedron, 2 * degree)
    samples = dolfinx.fem.Expression(ufl.as_vector([rr, tt, J, x[0], x[1]]), points)
    known = {field.name: getattr(body, field.name) for field in fields(body)}
    return InflatedTube(**known, samples=samples, weights=_volumes(mesh)[:, None] * 6.0 * weights)


def _volumes(mesh: dolfinx.mesh.Mesh) -> Array:
    """Return the volumes of the owned cells [mm³]."""
    n = mesh.topology.index_map(3).size_local
    a, b, c, d = np.moveaxis(mesh.geometry.x[geometry_dofmap(mesh)[:n]], 1, 0)
    return np.abs(np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a))) / 6.0


def _stresses(truth: Tube, r: Array) -> tuple[Array, Array]:
    """Return the true σ_rr and σ_θθ at reference radii, from tables of each layer."""
    rr, tt = np.zeros_like(r), np.zeros_like(r)
    for layer in truth.wall.layers:
        table = np.linspace(layer.inner, layer.outer, 60)
        table[0] += 1e-9  # at an interface the oracle takes the inner layer
        values = np.array([truth.stress(R) for R in table])
        here = (r > layer.inner) | (layer.inner == INNER_RADIUS)
        rr[here], tt[here] = (np.interp(r[here], table, column) for column in values.T)
    return rr, tt
