# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Problems as a dolfinx user writes them, and their solution by a direct solver."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from collective import lu_solve, norm

import basix.ufl
import dolfinx
import dolfinx.fem.petsc
import ufl

from dolfinx_feti import LinearProblem
from dolfinx_feti.fem.elements import quadratic_with_bubbles

Array = npt.NDArray[np.float64]
Marker = Callable[[Array], npt.NDArray[np.bool_]]
Cell = dolfinx.mesh.CellType


@dataclass(frozen=True, slots=True)
class Problem:
    """Forms and boundary conditions."""

    V: dolfinx.fem.FunctionSpace
    a: ufl.Form
    L: ufl.Form
    bcs: list[dolfinx.fem.DirichletBC]

    @property
    def cells(self) -> int:
        """Number of cells that this process owns."""
        topology = self.V.mesh.topology
        return topology.index_map(topology.dim).size_local

    def solve_directly(self) -> Array:
        """Solve with MUMPS's LU; return the owned values."""
        a = dolfinx.fem.form(self.a)
        L = dolfinx.fem.form(self.L)
        A = dolfinx.fem.petsc.assemble_matrix(a, bcs=self.bcs)
        A.assemble()
        b = dolfinx.fem.petsc.assemble_vector(L)
        dolfinx.fem.petsc.apply_lifting(b, [a], [self.bcs])
        b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        dolfinx.fem.petsc.set_bc(b, self.bcs)
        values = lu_solve(A, b)
        A.destroy()
        b.destroy()
        return values


def torn(
    problem: Problem, subdomains: object = 4, prefix: str | None = None, **options: object
) -> LinearProblem:
    """Create the FETI problem; ``options`` are PETSc options without prefix."""
    return LinearProblem(
        problem.a,
        problem.L,
        bcs=problem.bcs,
        subdomains=subdomains,
        petsc_options_prefix=prefix,
        petsc_options=options,
    )


def owned(u: dolfinx.fem.Function) -> Array:
    """Return the owned values of a function."""
    V = u.function_space
    return u.x.array[: V.dofmap.index_map.size_local * V.dofmap.index_map_bs].copy()


def cube(
    dim: int, n: int, cell: Cell | None = None, comm: MPI.Comm = MPI.COMM_WORLD
) -> dolfinx.mesh.Mesh:
    """Mesh the unit square or cube with n cells (cut into simplices) along an edge."""
    if dim == 2:
        return dolfinx.mesh.create_unit_square(comm, n, n, cell or Cell.triangle)
    return dolfinx.mesh.create_unit_cube(comm, n, n, n, cell or Cell.tetrahedron)


def without(mesh: dolfinx.mesh.Mesh, where: Marker) -> dolfinx.mesh.Mesh:
    """Return the submesh of the cells that are not marked."""
    dim = mesh.topology.dim
    cells = mesh.topology.index_map(mesh.topology.dim)
    every = np.arange(cells.size_local + cells.num_ghosts)
    kept = np.setdiff1d(every, dolfinx.mesh.locate_entities(mesh, dim, where))
    return dolfinx.mesh.create_submesh(mesh, dim, kept.astype(np.int32))[0]


def dirichlet(
    V: dolfinx.fem.FunctionSpace,
    where: Marker,
    value: Callable[[Array], Array] | None = None,
    component: int | None = None,
) -> dolfinx.fem.DirichletBC:
    """Return the condition that prescribes u, or a component of it, on a part of the boundary.

    Args:
        V: Function space.
        where: Marks points of the boundary.
        value: Prescribed values at points, as ``interpolate`` takes them; zero if not given.
        component: The component that is prescribed; all if not given.
    """
    mesh = V.mesh
    facets = dolfinx.mesh.locate_entities_boundary(mesh, mesh.topology.dim - 1, where)
    part = V if component is None else V.sub(component)
    collapsed = V if component is None else part.collapse()[0]
    g = dolfinx.fem.Function(collapsed)
    if value is not None:
        g.interpolate(value)
    if component is None:
        dofs = dolfinx.fem.locate_dofs_topological(V, mesh.topology.dim - 1, facets)
        return dolfinx.fem.dirichletbc(g, dofs)
    dofs = dolfinx.fem.locate_dofs_topological((part, collapsed), mesh.topology.dim - 1, facets)
    return dolfinx.fem.dirichletbc(g, dofs, part)


def tagged(mesh: dolfinx.mesh.Mesh, *surfaces: Marker) -> ufl.Measure:
    """Return a measure ds of the boundary; ``ds(i + 1)`` is the part that the i-th marker marks."""
    dim = mesh.topology.dim - 1
    found = [dolfinx.mesh.locate_entities_boundary(mesh, dim, where) for where in surfaces]
    facets = np.concatenate(found)
    values = np.repeat(np.arange(1, len(found) + 1, dtype=np.int32), [len(f) for f in found])
    order = np.argsort(facets)
    tags = dolfinx.mesh.meshtags(mesh, dim, facets[order], values[order])
    return ufl.Measure("ds", mesh, subdomain_data=tags)


def left(x: Array) -> npt.NDArray[np.bool_]:
    """Mark x₀ = 0."""
    return np.isclose(x[0], 0.0)


def right(x: Array) -> npt.NDArray[np.bool_]:
    """Mark x₀ = 1."""
    return np.isclose(x[0], 1.0)


def everywhere(x: Array) -> npt.NDArray[np.bool_]:
    """Mark all of the boundary."""
    return np.full(x.shape[1], True)


def with_bubbles(mesh: dolfinx.mesh.Mesh, degree: int = 1) -> basix.ufl._ElementBase:
    """Return a Lagrange element on simplices with bubbles.

    Degree 1 has the bubble of the cell (MINI element). Degree 2 also has those of the faces, which
    makes five bubbles in a tetrahedron.
    """
    if degree == 2:
        return quadratic_with_bubbles(mesh.topology.cell_name())
    cell = mesh.basix_cell()
    dim = mesh.topology.dim
    lagrange = basix.ufl.element("Lagrange", cell, degree)
    return basix.ufl.enriched_element([lagrange, basix.ufl.element("Bubble", cell, dim + 1)])


def free_residual(F: ufl.Form, bcs: list[dolfinx.fem.DirichletBC]) -> tuple[float, float]:
    """Return the norms of a residual over the free dofs and over all, assembled by dolfinx."""
    r = dolfinx.fem.assemble_vector(dolfinx.fem.form(F))
    r.scatter_reverse(dolfinx.la.InsertMode.add)
    n = r.index_map.size_local * r.block_size
    whole = norm(r.array[:n])
    for bc in bcs:
        bc.set(r.array, None, 0.0)
    return norm(r.array[:n]), whole


def elasticity(
    mesh: dolfinx.mesh.Mesh,
    *,
    degree: int = 1,
    element: basix.ufl._ElementBase | None = None,
    nu: float = 0.3,
    stretched: bool = False,
    clamped: Marker | None = left,
) -> Problem:
    """Set up linear elasticity with a body force; Young's modulus is 210.

    Args:
        mesh: Mesh of the body.
        degree: Degree of the Lagrange element.
        element: Scalar element of each component, in place of the Lagrange element.
        nu: Poisson's ratio.
        stretched: Whether u is inhomogeneous on the clamped part, a component is prescribed on
            x₀ = 1, and the whole boundary has springs and a traction.
        clamped: Marks the clamped part of the boundary; None for no condition.
    """
    dim = mesh.geometry.dim
    scalar = element or basix.ufl.element("Lagrange", mesh.basix_cell(), degree)
    V = dolfinx.fem.functionspace(mesh, basix.ufl.blocked_element(scalar, shape=(dim,)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    mu = 210.0 / (2 * (1 + nu))
    lmbda = 210.0 * nu / ((1 + nu) * (1 - 2 * nu))
    eps = ufl.sym(ufl.grad(u))
    stress = 2 * mu * eps + lmbda * ufl.tr(eps) * ufl.Identity(dim)
    a = ufl.inner(stress, ufl.sym(ufl.grad(v))) * ufl.dx
    force = ufl.as_vector([1.0, -2.0, 3.0][:dim])
    L = ufl.inner(force, v) * ufl.dx
    bcs = []
    if clamped is not None:
        value = (
            (lambda x: np.stack([0.1 * x[1], x[0], 0.2 * x[1] - 0.1][:dim])) if stretched else None
        )
        bcs.append(dirichlet(V, clamped, value))
    if stretched:
        normal = ufl.FacetNormal(mesh)
        bcs.append(dirichlet(V, right, lambda x: 0.3 + x[1] ** 2, component=1))
        a += 7.0 * ufl.inner(u, v) * ufl.ds
        L += ufl.inner(2.0 * normal, v) * ufl.ds
    return Problem(V, a, L, bcs)


def poisson(
    mesh: dolfinx.mesh.Mesh,
    *,
    degree: int = 1,
    element: basix.ufl._ElementBase | None = None,
    stretched: bool = False,
    clamped: Marker | None = left,
) -> Problem:
    """Set up the Poisson equation; the arguments are those of :func:`elasticity`."""
    V = dolfinx.fem.functionspace(mesh, element or ("Lagrange", degree))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    x = ufl.SpatialCoordinate(mesh)
    a = (1.0 + x[0] ** 2) * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    L = ufl.inner(1.0 + x[1], v) * ufl.dx
    bcs = []
    if clamped is not None:
        bcs.append(dirichlet(V, clamped, (lambda x: x[1] - 0.3) if stretched else None))
    if stretched:
        a += 3.0 * ufl.inner(u, v) * ufl.ds
        L += ufl.inner(2.0, v) * ufl.ds
    return Problem(V, a, L, bcs)
