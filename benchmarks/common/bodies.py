# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Simple bodies with about a given number of dofs: cubes, a square, blocks that keep their volume.

``subdomains`` is their number over all processes, None for the package's rule; ``options`` are
PETSc options of the problem. All functions are collective.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl

from dolfinx_feti import LinearProblem, NonlinearProblem, kinematics, loads, materials

__all__ = [
    "LoadedBody",
    "create_clamped_block",
    "create_cube",
    "create_heated_cube",
    "create_pillar",
]

POISSON = 0.3
SHEAR_MODULUS = 1.0  # kPa

#: Faces of a square or cube, as coordinate and its value: all of a cube's but x = 1.
ONE_FACE = ((0, 0.0),)
FIVE_FACES = ((0, 0.0), (1, 0.0), (1, 1.0), (2, 0.0), (2, 1.0))

Options = dict[str, object]


@dataclass(frozen=True, slots=True)
class LoadedBody:
    """A body: its problem, and of a nearly incompressible one u [mm], p [kPa], the load [kPa]."""

    problem: LinearProblem | NonlinearProblem
    u: dolfinx.fem.Function
    p: dolfinx.fem.Function | None = None
    load: dolfinx.fem.Constant | None = None


def create_cube(
    comm: MPI.Comm, *, dofs: int, degree: int, subdomains: int, options: Options, dim: int = 3
) -> LoadedBody:
    """Build a unit cube, or square, of a compressible material, clamped at x = 0, in its weight."""
    mesh = _unit_mesh(comm, dofs, degree, dim)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    strain = ufl.sym(ufl.grad(u))
    lmbda = 2 * SHEAR_MODULUS * POISSON / (1 - 2 * POISSON)
    stress = 2 * SHEAR_MODULUS * strain + lmbda * ufl.tr(strain) * ufl.Identity(dim)
    weight = dolfinx.fem.Constant(mesh, np.eye(dim)[-1])
    a, L = ufl.inner(stress, ufl.grad(v)) * ufl.dx, ufl.inner(weight, v) * ufl.dx
    return _linear(a, L, _clamp(V), subdomains, options)


def create_heated_cube(
    comm: MPI.Comm, *, dofs: int, degree: int, subdomains: int | None, options: Options
) -> LoadedBody:
    """Build Poisson's equation on the unit cube, heated inside and cooled at x = 0."""
    mesh = _unit_mesh(comm, 3 * dofs, degree, 3)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    facets = _facets(mesh, ONE_FACE)
    cold = dolfinx.fem.dirichletbc(0.0, dolfinx.fem.locate_dofs_topological(V, 2, facets), V)
    a, L = (
        ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        dolfinx.fem.Constant(mesh, 1.0) * v * ufl.dx,
    )
    return _linear(a, L, cold, subdomains, options)


def create_pillar(
    comm: MPI.Comm,
    *,
    dofs: int,
    kappa: float,
    subdomains: int | None,
    options: Options,
    degree: int = 2,
) -> LoadedBody:
    """Build a neo-Hookean unit cube, P_k–P0, clamped at x = 0, with a pressure on x = 1."""
    mesh, u, p, energy = _neo_hookean(comm, dofs, degree, kappa)
    v, q = ufl.TestFunction(u.function_space), ufl.TestFunction(p.function_space)
    du = ufl.TrialFunction(u.function_space)
    pressure = dolfinx.fem.Constant(mesh, 0.0)
    ds = _loaded_face(mesh)
    F_u = ufl.derivative(energy, u, v) + loads.follower_pressure(pressure, u, v, ds)
    K = ufl.derivative(ufl.derivative(energy, u, v), u, du)
    K += loads.follower_pressure_tangent(pressure, u, v, du, ds, "symmetric")
    problem = NonlinearProblem(
        [F_u, ufl.derivative(energy, p, q)],
        u,
        bcs=[_clamp(u.function_space)],
        J=K,
        condense=p,
        subdomains=subdomains,
        petsc_options_prefix="body_",
        petsc_options=options,
        quadrature_degree=4,
    )
    return LoadedBody(problem, u, p, pressure)


def create_clamped_block(
    comm: MPI.Comm,
    *,
    dofs: int,
    kappa: float,
    subdomains: int | None,
    options: Options,
    degree: int = 2,
) -> LoadedBody:
    """Build a neo-Hookean unit cube, P_k–P0, clamped on five faces; options prefix ``block_``.

    A dead load t (e_x + e_y), which adds nothing to the tangent, waits for its size t on the sixth
    face, x = 1.
    """
    mesh, u, p, energy = _neo_hookean(comm, dofs, degree, kappa)
    load = dolfinx.fem.Constant(mesh, 0.0)
    problem = NonlinearProblem(
        energy - load * (u[0] + u[1]) * _loaded_face(mesh),
        u,
        bcs=[_clamp(u.function_space, FIVE_FACES)],
        condense=p,
        subdomains=subdomains,
        petsc_options_prefix="block_",
        petsc_options=options,
        quadrature_degree=4,
    )
    return LoadedBody(problem, u, p, load)


def _linear(
    a: ufl.Form, L: ufl.Form, bc: dolfinx.fem.DirichletBC, subdomains: int | None, options: Options
) -> LoadedBody:
    problem = LinearProblem(
        a, L, bcs=[bc], subdomains=subdomains, petsc_options_prefix="body_", petsc_options=options
    )
    return LoadedBody(problem, problem.u)


def _neo_hookean(
    comm: MPI.Comm, dofs: int, degree: int, kappa: float
) -> tuple[dolfinx.mesh.Mesh, dolfinx.fem.Function, dolfinx.fem.Function, ufl.Form]:
    """Return a mesh, u in P_k, p in P0 and the energy of a nearly incompressible material."""
    mesh = _unit_mesh(comm, dofs, degree, 3)
    u = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (3,))))
    p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    F = kinematics.deformation_gradient(u)
    C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
    psi = materials.neo_hookean(C, c=SHEAR_MODULUS, J=J)
    psi += materials.perturbed_lagrangian(J, p, dolfinx.fem.Constant(mesh, kappa))
    return mesh, u, p, psi * ufl.dx


def _unit_mesh(comm: MPI.Comm, dofs: int, degree: int, dim: int) -> dolfinx.mesh.Mesh:
    """Mesh a square or cube with n cells along an edge, for dim (n degree + 1)^dim dofs."""
    n = max(1, round(((dofs / dim) ** (1 / dim) - 1) / degree))
    create = {2: dolfinx.mesh.create_unit_square, 3: dolfinx.mesh.create_unit_cube}[dim]
    return create(comm, *[n] * dim)


def _loaded_face(mesh: dolfinx.mesh.Mesh) -> ufl.Measure:
    """Return the measure of the face x = 1."""
    facets = _facets(mesh, ((0, 1.0),))
    tags = dolfinx.mesh.meshtags(mesh, 2, facets, np.ones(len(facets), dtype=np.int32))
    return ufl.Measure("ds", mesh, subdomain_data=tags)(1)


def _clamp(
    V: dolfinx.fem.FunctionSpace, faces: Sequence[tuple[int, float]] = ONE_FACE
) -> dolfinx.fem.DirichletBC:
    dim = V.mesh.geometry.dim
    dofs = dolfinx.fem.locate_dofs_topological(V, dim - 1, _facets(V.mesh, faces))
    return dolfinx.fem.dirichletbc(np.zeros(dim), dofs, V)


def _facets(mesh: dolfinx.mesh.Mesh, faces: Sequence[tuple[int, float]]) -> npt.NDArray[np.int32]:
    """Return the facets of the boundary on which one of the coordinates has its value, sorted."""
    d = mesh.topology.dim - 1
    facets = [
        dolfinx.mesh.locate_entities_boundary(mesh, d, partial(_on_face, i, value))
        for i, value in faces
    ]
    return np.unique(np.concatenate(facets))


def _on_face(i: int, value: float, x: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
    return np.isclose(x[i], value)
