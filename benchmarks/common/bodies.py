# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Simple bodies: a compressible cube or square, a nearly incompressible block, a heated cube."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl

from dolfinx_feti import LinearProblem, NonlinearProblem, kinematics, loads, materials

__all__ = ["create_block", "create_cube", "create_heated_cube", "create_square"]

POISSON = 0.3
SHEAR_MODULUS = 1.0  # kPa
KAPPA = 1000.0  # kPa
PREFIX = "body_"


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
    n = _cells(dofs, degree, dim=3)
    mesh = dolfinx.mesh.create_unit_cube(comm, n, n, n)
    return _elasticity(mesh, degree, subdomains, options)


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
    n = _cells(dofs, 2, dim=3)
    mesh = dolfinx.mesh.create_unit_cube(comm, n, n, n)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    Q = dolfinx.fem.functionspace(mesh, ("DG", 0))
    u, p = dolfinx.fem.Function(V), dolfinx.fem.Function(Q)
    v, q, du = ufl.TestFunction(V), ufl.TestFunction(Q), ufl.TrialFunction(V)
    F = kinematics.deformation_gradient(u)
    C, J = kinematics.right_cauchy_green(F), kinematics.jacobian(F)
    energy = materials.neo_hookean(C, c=SHEAR_MODULUS, J=J)
    energy = (energy + materials.perturbed_lagrangian(J, p, KAPPA)) * ufl.dx
    face = np.sort(dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[0], 1.0)))
    tags = dolfinx.mesh.meshtags(mesh, 2, face, np.ones(len(face), dtype=np.int32))
    ds = ufl.Measure("ds", mesh, subdomain_data=tags)(1)
    pressure = dolfinx.fem.Constant(mesh, loads.mmhg(1.0))
    F_u = ufl.derivative(energy, u, v) + loads.follower_pressure(pressure, u, v, ds)
    K = ufl.derivative(ufl.derivative(energy, u, v), u, du)
    K += loads.follower_pressure_tangent(pressure, u, v, du, ds, "symmetric")
    return NonlinearProblem(
        [F_u, ufl.derivative(energy, p, q)],
        u,
        bcs=[_clamp(V)],
        J=K,
        condense=p,
        subdomains=subdomains,
        petsc_options_prefix=PREFIX,
        petsc_options=options,
        quadrature_degree=4,
    )


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


def _clamp(V: dolfinx.fem.FunctionSpace) -> dolfinx.fem.DirichletBC:
    mesh = V.mesh
    facets = dolfinx.mesh.locate_entities_boundary(
        mesh, mesh.topology.dim - 1, lambda x: np.isclose(x[0], 0.0)
    )
    dofs = dolfinx.fem.locate_dofs_topological(V, mesh.topology.dim - 1, facets)
    return dolfinx.fem.dirichletbc(np.zeros(mesh.geometry.dim), dofs, V)


def _cells(dofs: int, degree: int, *, dim: int) -> int:
    """Return the cells along an edge for about so many dofs, dim (n degree + 1)^dim."""
    return max(1, round(((dofs / dim) ** (1 / dim) - 1) / degree))
