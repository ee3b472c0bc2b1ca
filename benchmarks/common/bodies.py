# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Simple bodies: a compressible cube or square, nearly incompressible blocks, a heated cube."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl

from dolfinx_feti import LinearProblem, NonlinearProblem, kinematics, loads, materials

__all__ = [
    "LoadedBody",
    "create_block",
    "create_clamped_block",
    "create_cube",
    "create_heated_cube",
    "create_square",
]

POISSON = 0.3
SHEAR_MODULUS = 1.0  # kPa
KAPPA = 1000.0  # kPa
PREFIX = "body_"

#: Faces of a square or cube, as coordinate and its value: all of a cube's but the loaded one.
ONE_FACE = ((0, 0.0),)
FIVE_FACES = ((0, 0.0), (1, 0.0), (1, 1.0), (2, 0.0), (2, 1.0))


@dataclass(frozen=True, slots=True)
class LoadedBody:
    """A nearly incompressible body, its unknowns, and what loads it.

    Attributes:
        problem: The FETI problem.
        u: Displacement [mm].
        p: Pressure of the element-wise volume constraint [kPa].
        load: Pressure or traction [kPa].
    """

    problem: NonlinearProblem
    u: dolfinx.fem.Function
    p: dolfinx.fem.Function
    load: dolfinx.fem.Constant


def create_cube(
    comm: MPI.Comm, *, dofs: int, degree: int, subdomains: int | None, options: dict[str, object]
) -> LinearProblem:
    """Build a unit cube of a compressible material, clamped at x = 0, under its own weight.

    Args:
        comm: Communicator of the mesh.
        dofs: Approximate number.
        degree: Of the displacements.
        subdomains: Number of subdomains; None for the package's rule.
        options: PETSc options of the problem.

    Note:
        Collective.
    """
    return _elasticity(_cube_mesh(comm, dofs, degree=degree), degree, subdomains, options)


def create_square(
    comm: MPI.Comm, *, dofs: int, degree: int, subdomains: int | None, options: dict[str, object]
) -> LinearProblem:
    """Build a unit square of a compressible material; see :func:`create_cube`.

    Note:
        Collective.
    """
    n = _cells(dofs, degree, dim=2)
    return _elasticity(dolfinx.mesh.create_unit_square(comm, n, n), degree, subdomains, options)


def create_block(
    comm: MPI.Comm, *, dofs: int, subdomains: int | None, options: dict[str, object]
) -> NonlinearProblem:
    """Build a unit cube of a nearly incompressible material, P2–P0, clamped at x = 0.

    A pressure of 1 mmHg waits on the face x = 1; the first Newton step is from rest.

    Args:
        comm: Communicator of the mesh.
        dofs: Approximate number.
        subdomains: Number of subdomains; None for the package's rule.
        options: PETSc options of the problem.

    Note:
        Collective.
    """
    mesh = _cube_mesh(comm, dofs, degree=2)
    u, p, energy = _neo_hookean(mesh, KAPPA)
    v, q = ufl.TestFunction(u.function_space), ufl.TestFunction(p.function_space)
    du = ufl.TrialFunction(u.function_space)
    pressure = dolfinx.fem.Constant(mesh, loads.mmhg(1.0))
    ds = _loaded_face(mesh)
    F_u = ufl.derivative(energy, u, v) + loads.follower_pressure(pressure, u, v, ds)
    K = ufl.derivative(ufl.derivative(energy, u, v), u, du)
    K += loads.follower_pressure_tangent(pressure, u, v, du, ds, "symmetric")
    return NonlinearProblem(
        [F_u, ufl.derivative(energy, p, q)],
        u,
        bcs=[_clamp(u.function_space)],
        J=K,
        condense=p,
        subdomains=subdomains,
        petsc_options_prefix=PREFIX,
        petsc_options=options,
        quadrature_degree=4,
    )


def create_clamped_block(
    comm: MPI.Comm,
    *,
    dofs: int,
    kappa: float,
    subdomains: int | None,
    options: dict[str, object],
) -> LoadedBody:
    """Build a unit cube of a nearly incompressible material, P2–P0, clamped on five faces.

    A dead load t (e_x + e_y), which adds nothing to the tangent, waits for its size t on the sixth
    face, x = 1.

    Args:
        comm: Communicator of the mesh.
        dofs: Approximate number.
        kappa: κ [kPa]; the shear modulus is 1 kPa.
        subdomains: Number of subdomains; None for the package's rule.
        options: PETSc options of the problem, prefix ``block_``.

    Note:
        Collective.
    """
    mesh = _cube_mesh(comm, dofs, degree=2)
    u, p, energy = _neo_hookean(mesh, kappa)
    load = dolfinx.fem.Constant(mesh, 0.0)
    energy -= load * (u[0] + u[1]) * _loaded_face(mesh)
    problem = NonlinearProblem(
        energy,
        u,
        bcs=[_clamp(u.function_space, FIVE_FACES)],
        condense=p,
        subdomains=subdomains,
        petsc_options_prefix="block_",
        petsc_options=options,
        quadrature_degree=4,
    )
    return LoadedBody(problem, u, p, load)


def create_heated_cube(
    comm: MPI.Comm, *, dofs: int, degree: int, subdomains: int | None, options: dict[str, object]
) -> LinearProblem:
    """Build Poisson's equation on the unit cube, heated inside and cooled at x = 0.

    Args:
        comm: Communicator of the mesh.
        dofs: Approximate number.
        degree: Of the temperature.
        subdomains: Number of subdomains; None for the package's rule.
        options: PETSc options of the problem.

    Note:
        Collective.
    """
    n = max(1, round((dofs ** (1 / 3) - 1) / degree))
    mesh = dolfinx.mesh.create_unit_cube(comm, n, n, n)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    facets = dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[0], 0.0))
    cold = dolfinx.fem.dirichletbc(0.0, dolfinx.fem.locate_dofs_topological(V, 2, facets), V)
    return LinearProblem(
        ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        dolfinx.fem.Constant(mesh, 1.0) * v * ufl.dx,
        bcs=[cold],
        subdomains=subdomains,
        petsc_options_prefix=PREFIX,
        petsc_options=options,
    )


def _elasticity(
    mesh: dolfinx.mesh.Mesh, degree: int, subdomains: int | None, options: dict[str, object]
) -> LinearProblem:
    dim = mesh.geometry.dim
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    strain = ufl.sym(ufl.grad(u))
    lmbda = 2 * SHEAR_MODULUS * POISSON / (1 - 2 * POISSON)
    stress = 2 * SHEAR_MODULUS * strain + lmbda * ufl.tr(strain) * ufl.Identity(dim)
    weight = dolfinx.fem.Constant(mesh, np.eye(dim)[-1])
    return LinearProblem(
        ufl.inner(stress, ufl.grad(v)) * ufl.dx,
        ufl.inner(weight, v) * ufl.dx,
        bcs=[_clamp(V)],
        subdomains=subdomains,
        petsc_options_prefix=PREFIX,
        petsc_options=options,
    )


def _cube_mesh(comm: MPI.Comm, dofs: int, *, degree: int) -> dolfinx.mesh.Mesh:
    n = _cells(dofs, degree, dim=3)
    return dolfinx.mesh.create_unit_cube(comm, n, n, n)


def _neo_hookean(
    mesh: dolfinx.mesh.Mesh, kappa: float
) -> tuple[dolfinx.fem.Function, dolfinx.fem.Function, ufl.Form]:
    """Return u in P2, p in P0 and the energy of a nearly incompressible material."""
    u = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,))))
    p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    F = kinematics.deformation_gradient(u)
    C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
    psi = materials.neo_hookean(C, c=SHEAR_MODULUS, J=J)
    psi += materials.perturbed_lagrangian(J, p, dolfinx.fem.Constant(mesh, kappa))
    return u, p, psi * ufl.dx


def _loaded_face(mesh: dolfinx.mesh.Mesh) -> ufl.Measure:
    """Return the measure of the face x = 1."""
    facets = np.sort(_facets(mesh, 0, 1.0))
    tags = dolfinx.mesh.meshtags(mesh, 2, facets, np.ones(len(facets), dtype=np.int32))
    return ufl.Measure("ds", mesh, subdomain_data=tags)(1)


def _clamp(
    V: dolfinx.fem.FunctionSpace, faces: Sequence[tuple[int, float]] = ONE_FACE
) -> dolfinx.fem.DirichletBC:
    mesh = V.mesh
    facets = np.unique(np.concatenate([_facets(mesh, i, value) for i, value in faces]))
    dofs = dolfinx.fem.locate_dofs_topological(V, mesh.topology.dim - 1, facets)
    return dolfinx.fem.dirichletbc(np.zeros(mesh.geometry.dim), dofs, V)


def _facets(mesh: dolfinx.mesh.Mesh, i: int, value: float) -> npt.NDArray[np.int32]:
    """Return the facets of the boundary on which the i-th coordinate has a value."""
    return dolfinx.mesh.locate_entities_boundary(
        mesh, mesh.topology.dim - 1, lambda x: np.isclose(x[i], value)
    )


def _cells(dofs: int, degree: int, *, dim: int) -> int:
    """Return the cells along an edge for about so many dofs, dim (n degree + 1)^dim."""
    return max(1, round(((dofs / dim) ** (1 / dim) - 1) / degree))
