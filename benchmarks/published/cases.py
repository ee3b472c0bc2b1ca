# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The cases: bodies of Q2–P1disc hexahedra, how they are loaded, and what is read off them.

Land et al., *Verification of cardiac mechanics software*, Proc. R. Soc. A 471 (2015) 20150641;
Gasser, Ogden, Holzapfel, J. R. Soc. Interface 3 (2006) 15-35. Millimetres and kPa.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl
from ufl.core.expr import Expr

from benchmarks.published.ellipsoid import create_ellipsoid, ellipsoid_fibre
from dolfinx_feti import NonlinearProblem, kinematics, loads, materials
from dolfinx_feti.wall import facets

__all__ = ["CASES", "Body", "Case"]

QUADRATURE = 4  # degree

Facets = npt.NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class Body:
    """A body: its unknowns, residuals (tested with v and q), and how it is held and loaded."""

    u: dolfinx.fem.Function
    p: dolfinx.fem.Function
    residuals: tuple[ufl.Form, ufl.Form]
    held: Facets
    problem: NonlinearProblem
    set_load: Callable[[float], None]  # a share of the load
    measure: Callable[[dolfinx.fem.Function], float]  # of a displacement in the space of u


@dataclass(frozen=True, slots=True)
class Case:
    """What is published, between which numbers ours holds, and who builds the body on mesh n."""

    name: str
    source: str
    quantity: str
    published: str
    low: float
    high: float
    first: float  # load step, as a share of the load
    create: Callable[[MPI.Comm, int], Body]


def _beam(comm: MPI.Comm, n: int) -> Body:
    """Build the beam, bent by 4 Pa from below, clamped at x = 0."""
    corners = [np.zeros(3), np.array([10.0, 1.0, 1.0])]
    kind = dolfinx.mesh.CellType.hexahedron
    mesh = dolfinx.mesh.create_box(comm, corners, [10 * n, n, n], cell_type=kind)
    clamped, below = (
        np.sort(dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x, k=k: np.isclose(x[k], 0)))
        for k in (0, 2)
    )
    e_x = ufl.as_vector([1.0, 0.0, 0.0])
    heart = {"c": 2.0, "b_f": 8.0, "b_t": 2.0, "b_fs": 4.0}
    return _body(
        mesh,
        lambda C, J, _share: materials.guccione(C, e_x, **heart, J=J),
        held=clamped,
        loaded=below,
        pressure=0.004,
        kappa=1000.0,
        point=(10.0, 0.5, 1.0),
    )


def _inflated(comm: MPI.Comm, n: int) -> Body:
    """Build the ellipsoid of an isotropic material under 10 kPa, its base clamped."""
    wall = create_ellipsoid(comm, n)
    e_x = ufl.as_vector([1.0, 0.0, 0.0])
    isotropic = {"c": 10.0, "b_f": 1.0, "b_t": 1.0, "b_fs": 1.0}
    return _body(
        wall.mesh,
        lambda C, J, _share: materials.guccione(C, e_x, **isotropic, J=J),
        held=facets(wall, "base"),
        loaded=facets(wall, "lumen"),
        pressure=10.0,
        kappa=1e5,
        point=(0.0, 0.0, -17.0),
    )


def _contracted(comm: MPI.Comm, n: int) -> Body:
    """Build the ellipsoid whose fibres contract with 60 kPa against 15 kPa inside."""
    wall = create_ellipsoid(comm, n)
    f = ellipsoid_fibre(wall.mesh)
    heart = {"c": 2.0, "b_f": 8.0, "b_t": 2.0, "b_fs": 4.0}
    return _body(
        wall.mesh,
        lambda C, J, share: (
            materials.guccione(C, f, **heart, J=J)
            + materials.active_tension(C, f, tension=60.0 * share)
        ),
        held=facets(wall, "base"),
        loaded=facets(wall, "lumen"),
        pressure=15.0,
        kappa=1e5,
        point=(0.0, 0.0, -17.0),
    )


def _body(
    mesh: dolfinx.mesh.Mesh,
    energy: Callable[[Expr, Expr, Expr], Expr],
    *,
    held: Facets,
    loaded: Facets,
    pressure: float,
    kappa: float,
    point: Sequence[float],
) -> Body:
    """Build a clamped body under a pressure; z of a point [mm] is measured."""
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    Q = dolfinx.fem.functionspace(mesh, ("DPC", 1))
    u, p = dolfinx.fem.Function(V), dolfinx.fem.Function(Q)
    v, q, du = ufl.TestFunction(V), ufl.TestFunction(Q), ufl.TrialFunction(V)
    metadata = {"quadrature_degree": QUADRATURE}
    tags = dolfinx.mesh.meshtags(mesh, 2, loaded, np.ones(len(loaded), dtype=np.int32))
    ds = ufl.Measure("ds", mesh, subdomain_data=tags, metadata=metadata)(1)
    share = dolfinx.fem.Constant(mesh, 0.0)
    F = kinematics.deformation_gradient(u)
    C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
    psi = energy(C, J, share)
    psi += materials.perturbed_lagrangian(J, p, dolfinx.fem.Constant(mesh, kappa))
    stored = psi * ufl.dx(metadata=metadata)
    internal = ufl.derivative(stored, u, v)
    residuals = (
        internal + loads.follower_pressure(pressure * share, u, v, ds),
        ufl.derivative(stored, p, q),
    )
    clamped = dolfinx.fem.locate_dofs_topological(V, 2, held)
    bcs = [dolfinx.fem.dirichletbc(np.zeros(3), clamped, V)]
    K = ufl.derivative(internal, u, du)
    K += loads.follower_pressure_tangent(pressure * share, u, v, du, ds, bcs=bcs)
    problem = NonlinearProblem(residuals, u, bcs=bcs, J=K, condense=p, quadrature_degree=QUADRATURE)

    def measure(displacement: dolfinx.fem.Function) -> float:
        x = V.tabulate_dof_coordinates()
        here = np.linalg.norm(x - point, axis=1) < 1e-6
        z = (x + displacement.x.array.reshape(-1, 3))[here, 2]
        return float(mesh.comm.allreduce(z.max(initial=-np.inf), op=MPI.MAX))

    def set_load(value: float) -> None:
        share.value = value

    return Body(u, p, residuals, held, problem, set_load, measure)


LAND = "Land et al. 2015, problem"

CASES = {
    "land-1": Case(
        "beam", f"{LAND} 1", "z of (10, 0.5, 1) [mm]", "4.0 to 4.2", 4.0, 4.2, 0.25, _beam
    ),
    "land-2": Case(
        "inflated ellipsoid", f"{LAND} 2", "z of the apex inside [mm]", "−26.6, from a plot",
        -26.6 * 1.005, -26.6 * 0.995, 0.1, _inflated,
    ),
    "land-3": Case(
        "contracted ellipsoid", f"{LAND} 3", "z of the apex inside [mm]", "about −14, from a plot",
        -15.0, -13.0, 0.05, _contracted,
    ),
}  # fmt: skip
