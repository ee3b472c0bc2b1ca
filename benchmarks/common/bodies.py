# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Bodies of a given energy with supports and loads; linear bodies; meshes of a given size.

The energy of a :class:`Body` is Ψ(C, J) + p (J − 1) − p²/(2κ) per unit reference volume.
Millimetres and kPa. All functions are collective.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

import basix.ufl
import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti import LinearProblem, NonlinearProblem, kinematics, loads, materials
from dolfinx_feti.loading import LoadStep, Steps, follow_load
from dolfinx_feti.mechanics.residual_stress import elastic_part
from dolfinx_feti.runtime.arrays import Array, Indices
from dolfinx_feti.runtime.scotch import repeatable_partitions

#: Poisson's ratio of the compressible bodies, and shear modulus of all bodies but walls [kPa].
POISSON = 0.3
SHEAR_MODULUS = 1.0

#: Width over length of a plate.
PLATE_WIDTH = 0.6

#: Radius of an inclusion; there are three along each edge of the unit cube.
INCLUSION_RADIUS = 0.12
INCLUSIONS_PER_EDGE = 3

#: A component of the displacement, or None for all of them, and the facets where it is zero.
Support = tuple[int | None, Indices]


@dataclass(frozen=True, slots=True)
class Solid:
    """A body without loads.

    Attributes:
        u: Displacement [mm].
        p: Pressure [kPa].
        bcs: Dirichlet conditions.
        energy: Stored energy [mN mm].
        stress: Cauchy stress σ [kPa], (3, 3).
    """

    u: dolfinx.fem.Function
    p: dolfinx.fem.Function
    bcs: list[dolfinx.fem.DirichletBC]
    energy: ufl.Form
    stress: Expr


@dataclass(frozen=True, slots=True)
class Body:
    """A loaded body and its problem.

    Attributes:
        u: Displacement [mm].
        p: Pressure field [kPa].
        residuals: r_u and r_p, tested with v and q.
        supports: Components that are zero, and their facets.
        problem: The problem, with condensed p.
        load_factor: Factor of the pressure or force that :func:`create_body` was given.
        stress: Cauchy stress σ [kPa], (3, 3).
        measure: Returns the compared quantities of the present u and p by name. Collective.
        unit: Load factor for a value of 1 in :meth:`set_load` and :meth:`inflate`.
    """

    u: dolfinx.fem.Function
    p: dolfinx.fem.Function
    residuals: tuple[ufl.Form, ufl.Form]
    supports: Sequence[Support]
    problem: NonlinearProblem
    load_factor: dolfinx.fem.Constant
    stress: Expr
    measure: Callable[[], dict[str, float]]
    unit: float = 1.0

    @property
    def dofs(self) -> int:
        """Number of displacement dofs."""
        dofmap = self.u.function_space.dofmap
        return dofmap.index_map.size_global * dofmap.index_map_bs

    def set_load(self, value: float) -> None:
        """Set the load, in its unit: for walls mmHg."""
        self.load_factor.value = value * self.unit

    def inflate(self, targets: Sequence[float], steps: Steps, **settings: object) -> list[LoadStep]:
        """Follow the load to each of the targets; see ``follow_load``. Collective.

        Args:
            targets: Loads that are met exactly, in the body's unit.
            steps: Increments, in the same unit, and tolerances.
            settings: Further arguments of ``follow_load``.

        Returns:
            The accepted load steps.
        """
        state = [self.u, self.p]
        return follow_load(self.problem, self.set_load, targets, steps, state=state, **settings)


def create_solid(
    mesh: dolfinx.mesh.Mesh,
    energy: Callable[[Expr, Expr], Expr],
    *,
    kappa: float,
    supports: Sequence[Support],
    degree: int = 2,
    element: basix.ufl._ElementBase | None = None,
    pressures: tuple[str, int] = ("DPC", 1),
    G: Expr | None = None,
) -> Solid:
    """Build a body without loads.

    Args:
        mesh: Mesh of the body.
        energy: Ψ(C, J) [kPa].
        kappa: κ [kPa].
        supports: Components of u, or all of them (None), that are zero, and their facets.
        degree: k of P_k or Q_k; the quadrature has the degree 2 k.
        element: Element of each component of u, in place of P_k or Q_k.
        pressures: Family and degree of the pressure.
        G: Part of the deformation without energy, det G = 1; I if not given.
    """
    element = element or basix.ufl.element("Lagrange", mesh.basix_cell(), degree)
    V = dolfinx.fem.functionspace(mesh, basix.ufl.blocked_element(element, shape=(3,)))
    u = dolfinx.fem.Function(V, name="u")
    p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, pressures), name="p")
    F = kinematics.deformation_gradient(u)
    E = F if G is None else elastic_part(F, G)
    C = kinematics.right_cauchy_green(E)
    J = kinematics.jacobian(E)
    psi = energy(C, J) + materials.perturbed_lagrangian(J, p, dolfinx.fem.Constant(mesh, kappa))
    stored = psi * ufl.dx(metadata={"quadrature_degree": 2 * degree})
    bcs = [create_zero_bc(V, component, facets) for component, facets in supports]
    return Solid(u, p, bcs, stored, kinematics.cauchy_stress(psi, F))


def create_body(
    mesh: dolfinx.mesh.Mesh,
    energy: Callable[[Expr, Expr, Expr], Expr],
    *,
    supports: Sequence[Support],
    loaded: Indices,
    pressure: float | None = None,
    force: Sequence[float] | None = None,
    measure: Callable[[dolfinx.fem.Function], dict[str, float]] = lambda _u: {},
    flatness_penalty: float = 0.0,
    degree: int = 2,
    tangent: loads.TangentKind = "auto",
    use_pressure_potential: bool = False,
    axis: tuple[float, float, float] | None = None,
    settings: Mapping[str, object] | None = None,
    **solid_settings: object,
) -> Body:
    """Build a body under a pressure, a force, or both, whose load factor is zero at first.

    Args:
        mesh: Mesh of the body.
        energy: Ψ(C, J, load factor) [kPa].
        supports: Components of u, or all of them (None), that are zero, and their facets.
        loaded: Facets under the load, sorted.
        pressure: Pressure on the deformed surface at the load factor 1 [kPa].
        force: Force per reference area at the load factor 1, (3,) [kPa].
        measure: Returns the compared quantities of u by name.
        flatness_penalty: Factor a of a penalty ½ a ‖∂u/∂X‖² [kPa mm] along the loaded surface,
            which keeps it flat.
        degree: Degree of the displacement; the quadrature has twice that degree.
        tangent: Which part of the pressure's derivative the tangent has.
        use_pressure_potential: Whether the line search uses the potential of the pressure, which
            there is in a lumen whose ends slide along the axis. That of a force is always used.
        axis: Axis of the lumen.
        settings: Further arguments of the problem.
        solid_settings: Further arguments of :func:`create_solid`; ``kappa`` is required.
    """
    load_factor = dolfinx.fem.Constant(mesh, 0.0)
    solid = create_solid(
        mesh,
        lambda C, J: energy(C, J, load_factor),
        supports=supports,
        degree=degree,
        **solid_settings,
    )
    u = solid.u
    p = solid.p
    v = ufl.TestFunction(u.function_space)
    q = ufl.TestFunction(p.function_space)
    du = ufl.TrialFunction(u.function_space)
    tags = dolfinx.mesh.meshtags(mesh, 2, loaded, np.ones(len(loaded), dtype=np.int32))
    metadata = {"quadrature_degree": 2 * degree}
    ds = ufl.Measure("ds", mesh, subdomain_data=tags, metadata=metadata)(1)
    potential = solid.energy
    if flatness_penalty:
        N = ufl.FacetNormal(mesh)
        along_surface = ufl.grad(u) - ufl.outer(ufl.grad(u) * N, N)
        potential += flatness_penalty / 2 * ufl.inner(along_surface, along_surface) * ds
    if force is not None:
        potential -= load_factor * ufl.dot(ufl.as_vector(force), u) * ds
    F_u = ufl.derivative(potential, u, v)
    F_p = ufl.derivative(potential, p, q)
    K = ufl.derivative(F_u, u, du)
    if pressure is not None:
        present = pressure * load_factor
        F_u += loads.follower_pressure(present, u, v, ds)
        K += loads.follower_pressure_tangent(present, u, v, du, ds, tangent, bcs=solid.bcs)
        if use_pressure_potential:
            potential += loads.pressure_potential(present, u, ds, axis=axis)
    has_potential = pressure is None or use_pressure_potential
    problem = NonlinearProblem(
        (F_u, F_p),
        u,
        bcs=solid.bcs,
        J=K,
        condense=p,
        energy=potential if has_potential else None,
        quadrature_degree=2 * degree,
        **(settings or {}),
    )
    return Body(
        u=u,
        p=p,
        residuals=(F_u, F_p),
        supports=supports,
        problem=problem,
        load_factor=load_factor,
        stress=solid.stress,
        measure=lambda: measure(u),
    )


def create_neo_hookean_cube(
    mesh: dolfinx.mesh.Mesh,
    *,
    kappa: float,
    clamped: Sequence[Indices],
    degree: int = 2,
    pressure: float | None = None,
    force: Sequence[float] | None = None,
    **settings: object,
) -> Body:
    """Build a neo-Hookean unit cube with P_k–P0 and a load on its face x = 1.

    Args:
        mesh: Mesh of the unit cube.
        kappa: κ [kPa].
        clamped: Facets of each clamped face.
        degree: Degree of the displacement.
        pressure: Pressure at the load factor 1 [kPa].
        force: Dead load per reference area at the load factor 1, (3,) [kPa].
        settings: Further arguments of the problem; PETSc options have the prefix ``body_``.
    """
    return create_body(
        mesh,
        lambda C, J, _load_factor: materials.neo_hookean(C, c=SHEAR_MODULUS, J=J),
        kappa=kappa,
        supports=[(None, facets) for facets in clamped],
        loaded=facets_in_plane(mesh, 0, 1.0),
        pressure=pressure,
        force=force,
        degree=degree,
        pressures=("DG", 0),
        tangent="symmetric",
        settings={"petsc_options_prefix": "body_", **settings},
    )


def create_elastic_problem(
    mesh: dolfinx.mesh.Mesh,
    *,
    degree: int,
    shear_modulus: float | dolfinx.fem.Function = SHEAR_MODULUS,
    clamped: Sequence[float] = (0.0,),
    **settings: object,
) -> LinearProblem:
    """Build a compressible elastic body in its weight.

    Args:
        mesh: Mesh of the body.
        degree: Degree of the displacement.
        shear_modulus: μ [kPa]; Poisson's ratio is 0.3.
        clamped: Coordinates x of the planes with u = 0.
        settings: Further arguments of the problem; PETSc options have the prefix ``body_``.
    """
    dim = mesh.geometry.dim
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    strain = ufl.sym(ufl.grad(u))
    lmbda = 2 * shear_modulus * POISSON / (1 - 2 * POISSON)
    stress = 2 * shear_modulus * strain + lmbda * ufl.tr(strain) * ufl.Identity(dim)
    weight = dolfinx.fem.Constant(mesh, np.eye(dim)[-1])
    return LinearProblem(
        ufl.inner(stress, ufl.grad(v)) * ufl.dx,
        ufl.inner(weight, v) * ufl.dx,
        bcs=[create_zero_bc(V, None, facets_in_plane(mesh, 0, x)) for x in clamped],
        petsc_options_prefix="body_",
        **settings,
    )


def create_heat_problem(
    mesh: dolfinx.mesh.Mesh, *, degree: int, **settings: object
) -> LinearProblem:
    """Build Poisson's equation with a unit source and u = 0 at x = 0.

    Args:
        mesh: Mesh of the body.
        degree: Degree of the unknown.
        settings: Further arguments of the problem; PETSc options have the prefix ``body_``.
    """
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    source = dolfinx.fem.Constant(mesh, 1.0)
    return LinearProblem(
        ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        ufl.inner(source, v) * ufl.dx,
        bcs=[create_zero_bc(V, None, facets_in_plane(mesh, 0, 0.0))],
        petsc_options_prefix="body_",
        **settings,
    )


def create_block_mesh(
    comm: MPI.Comm, lengths: Sequence[float], cells: Sequence[int]
) -> dolfinx.mesh.Mesh:
    """Mesh a block with hexahedra.

    Args:
        comm: Communicator.
        lengths: Lengths of the edges [mm], (3,); one corner is the origin.
        cells: Cells along each edge, (3,).
    """
    corners = [np.zeros(3), np.array(lengths)]
    kind = dolfinx.mesh.CellType.hexahedron
    with repeatable_partitions():
        return dolfinx.mesh.create_box(comm, corners, list(cells), cell_type=kind)


def facets_in_plane(mesh: dolfinx.mesh.Mesh, axis: int, coordinate: float) -> Indices:
    """Return the facets of the boundary in a plane normal to an axis, sorted."""
    facets = dolfinx.mesh.locate_entities_boundary(
        mesh, mesh.topology.dim - 1, lambda x: np.isclose(x[axis], coordinate)
    )
    return np.sort(facets)


def displacement_at(u: dolfinx.fem.Function, point: Sequence[float]) -> Array:
    """Return the displacement of the node at a point [mm], (3,), on all processes. Collective.

    Raises:
        ValueError: No node is there.
    """
    V = u.function_space
    is_node = np.linalg.norm(V.tabulate_dof_coordinates() - point, axis=1) < 1e-6
    of_processes = V.mesh.comm.allgather(u.x.array.reshape(-1, 3)[is_node])
    found = np.concatenate(of_processes)
    if len(found) == 0:
        raise ValueError(f"no node of the mesh is at {tuple(point)}")
    return found[0]


def create_zero_bc(
    V: dolfinx.fem.FunctionSpace, component: int | None, facets: Indices
) -> dolfinx.fem.DirichletBC:
    """Return the condition that a function of V, or one of its components, is zero on facets."""
    part = V if component is None else V.sub(component)
    dofs = dolfinx.fem.locate_dofs_topological(part, V.mesh.topology.dim - 1, facets)
    zero = np.zeros(V.value_shape if component is None else ())
    return dolfinx.fem.dirichletbc(zero, dofs, part)


def create_plate_mesh(
    comm: MPI.Comm, *, dofs: int, degree: int, slenderness: float
) -> dolfinx.mesh.Mesh:
    """Mesh a plate of one layer of hexahedra, 1 × 0.6 × 1/slenderness.

    With n cells along the plate there are some 0.6 n² degree² (degree + 1) nodes.

    Args:
        comm: Communicator.
        dofs: Approximate number of displacement dofs.
        degree: Degree of the displacement.
        slenderness: Length over thickness.
    """
    n = max(2, round((dofs / (3 * PLATE_WIDTH * degree**2 * (degree + 1))) ** 0.5))
    lengths = (1.0, PLATE_WIDTH, 1.0 / slenderness)
    return create_block_mesh(comm, lengths, (n, max(1, round(PLATE_WIDTH * n)), 1))


def create_unit_mesh(
    comm: MPI.Comm, *, dofs: int, degree: int, dim: int, components: int
) -> dolfinx.mesh.Mesh:
    """Mesh a square or cube with simplices.

    With n cells along an edge there are (n degree + 1)^dim nodes.

    Args:
        comm: Communicator.
        dofs: Approximate number of dofs.
        degree: Degree of the unknown.
        dim: 2 or 3.
        components: Dofs of a node.
    """
    n = max(1, round(((dofs / components) ** (1 / dim) - 1) / degree))
    create = {2: dolfinx.mesh.create_unit_square, 3: dolfinx.mesh.create_unit_cube}[dim]
    with repeatable_partitions():
        return create(comm, *[n] * dim)


def with_inclusions(mesh: dolfinx.mesh.Mesh, ratio: float) -> dolfinx.fem.Function:
    """Return the shear modulus of each cell [kPa], for a ratio of inclusions to the rest."""
    mu = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    x = mu.function_space.tabulate_dof_coordinates()[: len(mu.x.array)]
    centre = (np.floor(INCLUSIONS_PER_EDGE * x) + 0.5) / INCLUSIONS_PER_EDGE
    is_stiff = np.linalg.norm(x - centre, axis=1) < INCLUSION_RADIUS
    mu.x.array[:] = np.where(is_stiff, ratio * SHEAR_MODULUS, SHEAR_MODULUS)
    return mu
