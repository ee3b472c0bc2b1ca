# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A body of Q2–P1disc hexahedra: its unknowns, how it is held and loaded, and what is read off it.

Its energy is Ψ(C, J) + p (J − 1) − p²/(2κ) per unit reference volume. Millimetres and kPa.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti import NonlinearProblem, kinematics, loads, materials

__all__ = ["Body", "Facets", "Held", "create_block", "create_body", "displacement", "plane"]

QUADRATURE = 4  # degree

Facets = npt.NDArray[np.int32]
#: A component of the displacement, or all of them, that is zero on a surface.
Held = tuple[int | None, Facets]


@dataclass(frozen=True, slots=True)
class Body:
    """A body: its unknowns, residuals (tested with v and q), and how it is held and loaded."""

    u: dolfinx.fem.Function
    p: dolfinx.fem.Function
    residuals: tuple[ufl.Form, ufl.Form]
    held: Sequence[Held]
    problem: NonlinearProblem
    set_load: Callable[[float], None]  # a share of the load
    measure: Callable[[], dict[str, float]]  # of the state in u and p; collective


def create_body(
    mesh: dolfinx.mesh.Mesh,
    energy: Callable[[Expr, Expr, Expr], Expr],
    *,
    kappa: float,
    held: Sequence[Held],
    loaded: Facets,
    load: float | Sequence[float],
    measure: Callable[[dolfinx.fem.Function], dict[str, float]],
    grip: float = 0.0,
) -> Body:
    """Build a body.

    Args:
        mesh: Hexahedra.
        energy: Makes Ψ of C, J and the share of the load [kPa].
        kappa: κ [kPa].
        held: Where it is held.
        loaded: The facets that the load acts on.
        load: A pressure that follows the surface, or a force per reference area [kPa].
        measure: Reads off u.
        grip: Penalty ½ grip ‖∂u/∂X‖² on the loaded surface [kPa mm], which keeps a clamped end
            flat, as a grip that moves with the force does.
    """
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
    F_u = ufl.derivative(stored, u, v)
    if grip:
        N = ufl.FacetNormal(mesh)
        along = ufl.grad(u) - ufl.outer(ufl.grad(u) * N, N)
        F_u += ufl.derivative(grip / 2 * ufl.inner(along, along) * ds, u, v)
    K = ufl.derivative(F_u, u, du)
    bcs = [_hold(V, component, facets) for component, facets in held]
    if isinstance(load, float):
        F_u += loads.follower_pressure(load * share, u, v, ds)
        K += loads.follower_pressure_tangent(load * share, u, v, du, ds, bcs=bcs)
    else:
        F_u -= share * ufl.dot(ufl.as_vector(load), v) * ds
    residuals = (F_u, ufl.derivative(stored, p, q))
    problem = NonlinearProblem(residuals, u, bcs=bcs, J=K, condense=p, quadrature_degree=QUADRATURE)

    def set_load(value: float) -> None:
        share.value = value

    return Body(u, p, residuals, held, problem, set_load, lambda: measure(u))


def create_block(
    comm: MPI.Comm, lengths: Sequence[float], cells: Sequence[int]
) -> dolfinx.mesh.Mesh:
    """Mesh a block from the origin with hexahedra."""
    corners = [np.zeros(3), np.array(lengths)]
    kind = dolfinx.mesh.CellType.hexahedron
    return dolfinx.mesh.create_box(comm, corners, list(cells), cell_type=kind)


def plane(mesh: dolfinx.mesh.Mesh, axis: int, x: float) -> Facets:
    """Return the facets of the boundary in a plane normal to an axis."""
    return np.sort(dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda y: np.isclose(y[axis], x)))


def displacement(u: dolfinx.fem.Function, point: Sequence[float]) -> npt.NDArray[np.float64]:
    """Return the displacement of the node at a place [mm]. Collective."""
    V = u.function_space
    here = np.linalg.norm(V.tabulate_dof_coordinates() - point, axis=1) < 1e-6
    found = V.mesh.comm.allgather(u.x.array.reshape(-1, 3)[here])
    return np.concatenate(found)[0]


def _hold(V: dolfinx.fem.FunctionSpace, component: int | None, facets: Facets) -> Any:
    """Return the condition that a displacement, or a component of it, is zero."""
    if component is None:
        return dolfinx.fem.dirichletbc(
            np.zeros(3), dolfinx.fem.locate_dofs_topological(V, 2, facets), V
        )
    part = V.sub(component)
    return dolfinx.fem.dirichletbc(0.0, dolfinx.fem.locate_dofs_topological(part, 2, facets), part)
