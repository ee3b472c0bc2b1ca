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

POISSON = 0.3
SHEAR_MODULUS = 1.0  # kPa

#: Width over length of a plate.
PLATE_WIDTH = 0.6

#: Radius of an inclusion; there are three along each edge of the unit cube.
INCLUSION_RADIUS = 0.12
INCLUSIONS_PER_EDGE = 3

#: A component of the displacement, or all of them (None), that is zero, and the facets where it is.
Held = tuple[int | None, Indices]


@dataclass(frozen=True, slots=True)
class Solid:
    """Displacement u [mm], pressure p [kPa], Dirichlet conditions, and stored energy [mN mm]."""

    u: dolfinx.fem.Function
    p: dolfinx.fem.Function
    bcs: list[dolfinx.fem.DirichletBC]
    energy: ufl.Form
    stress: Expr  # Cauchy's σ [kPa]


@dataclass(frozen=True, slots=True)
class Body:
    """A body: its unknowns, residuals (tested with v and q), supports, problem and load."""

    u: dolfinx.fem.Function
    p: dolfinx.fem.Function
    residuals: tuple[ufl.Form, ufl.Form]
    held: Sequence[Held]
    problem: NonlinearProblem
    load: dolfinx.fem.Constant  # share of the load that create_body was given
    stress: Expr  # Cauchy's σ [kPa]
    measure: Callable[[], dict[str, float]]  # of the state in u and p; collective
    unit: float = 1.0  # share of the load for a value of 1 in set_load and inflate

    @property
    def dofs(self) -> int:
        """Displacement dofs."""
        dofmap = self.u.function_space.dofmap
        return dofmap.index_map.size_global * dofmap.index_map_bs

    def set_load(self, value: float) -> None:
        """Set the load, in its unit."""
        self.load.value = value * self.unit

    def inflate(self, to: Sequence[float], steps: Steps, **settings: object) -> list[LoadStep]:
        """Follow the load to each of the values ``to``, in units; see ``follow_load``."""
        state = [self.u, self.p]
        return follow_load(self.problem, self.set_load, to, steps, state=state, **settings)


def create_solid(
    mesh: dolfinx.mesh.Mesh,
    energy: Callable[[Expr, Expr], Expr],
    *,
    kappa: float,
    held: Sequence[Held],
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
        held: Components of u, or all of them (None), that are zero, and their facets.
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
    bcs = [hold(V, component, facets) for component, facets in held]
    return Solid(u, p, bcs, stored, kinematics.cauchy_stress(psi, F))


def create_body(
    mesh: dolfinx.mesh.Mesh,
    energy: Callable[[Expr, Expr, Expr], Expr],
    *,
    held: Sequence[Held],
    loaded: Indices,
    load: float | Sequence[float] = 1.0,
    measure: Callable[[dolfinx.fem.Function], dict[str, float]] = lambda _u: {},
    grip: float = 0.0,
    degree: int = 2,
    tangent: loads.TangentKind = "auto",
    lumen: bool = False,
    axis: tuple[float, float, float] | None = None,
    settings: Mapping[str, object] | None = None,
    **solid: object,
) -> Body:
    """Build a body whose energy is made of C, J and the share of the load [kPa].

    Args:
        mesh: Mesh of the body.
        energy: Ψ(C, J, share of the load) [kPa].
        held: Components of u, or all of them (None), that are zero, and their facets.
        loaded: Facets under the load, sorted.
        load: A pressure that follows the surface, which has to be a float, or a force per
            reference area, (3,) [kPa]. Both are multiplied by the share of the load.
        measure: Returns from u the quantities that are compared.
        grip: Factor of a penalty ½ grip ‖∂u/∂X‖² [kPa mm] that keeps the loaded surface flat.
        degree: Of the displacement; the quadrature has twice that degree.
        tangent: Which part of the pressure's derivative the tangent has.
        lumen: Whether the line search uses the potential of the pressure in a lumen whose ends
            slide along the axis. That of a force per area is always used.
        axis: Axis of the lumen.
        settings: Further arguments of the problem.
        solid: Further arguments of :func:`create_solid`.
    """
    share = dolfinx.fem.Constant(mesh, 0.0)
    made = create_solid(mesh, lambda C, J: energy(C, J, share), held=held, degree=degree, **solid)
    u = made.u
    p = made.p
    bcs = made.bcs
    potential = made.energy
    v = ufl.TestFunction(u.function_space)
    q = ufl.TestFunction(p.function_space)
    du = ufl.TrialFunction(u.function_space)
    metadata = {"quadrature_degree": 2 * degree}
    tags = dolfinx.mesh.meshtags(mesh, 2, loaded, np.ones(len(loaded), dtype=np.int32))
    ds = ufl.Measure("ds", mesh, subdomain_data=tags, metadata=metadata)(1)
    if grip:
        N = ufl.FacetNormal(mesh)
        along = ufl.grad(u) - ufl.outer(ufl.grad(u) * N, N)
        potential += grip / 2 * ufl.inner(along, along) * ds
    follows = isinstance(load, float)
    if not follows:
        potential -= share * ufl.dot(ufl.as_vector(load), u) * ds
    F_u = ufl.derivative(potential, u, v)
    K = ufl.derivative(F_u, u, du)
    residual_p = ufl.derivative(potential, p, q)
    if follows:
        F_u += loads.follower_pressure(load * share, u, v, ds)
        K += loads.follower_pressure_tangent(load * share, u, v, du, ds, tangent, bcs=bcs)
    if lumen:
        potential += loads.pressure_potential(load * share, u, ds, axis=axis)
    problem = NonlinearProblem(
        (F_u, residual_p),
        u,
        bcs=bcs,
        J=K,
        condense=p,
        energy=potential if lumen or not follows else None,
        quadrature_degree=2 * degree,
        **(settings or {}),
    )
    return Body(u, p, (F_u, residual_p), held, problem, share, made.stress, lambda: measure(u))


def create_neo_hookean(
    mesh: dolfinx.mesh.Mesh,
    *,
    kappa: float,
    held: Sequence[Indices],
    load: float | Sequence[float],
    degree: int = 2,
    **settings: object,
) -> Body:
    """Build a neo-Hookean unit cube with P_k–P0 and a load on its face x = 1.

    Args:
        mesh: Mesh of the unit cube.
        kappa: κ [kPa].
        held: Facets of each clamped face.
        load: A pressure, or a dead load (3,), at the share 1 of the load [kPa].
        degree: Of the displacement.
        settings: Further arguments of the problem; PETSc options have the prefix ``body_``.
    """
    return create_body(
        mesh,
        lambda C, J, _share: materials.neo_hookean(C, c=SHEAR_MODULUS, J=J),
        kappa=kappa,
        held=[(None, facets) for facets in held],
        loaded=plane(mesh, 0, 1.0),
        load=load,
        degree=degree,
        pressures=("DG", 0),
        tangent="symmetric",
        settings={"petsc_options_prefix": "body_", **settings},
    )


def create_elastic(
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
        degree: Of the displacement.
        shear_modulus: μ [kPa]; Poisson's ratio is 0.3.
        clamped: Places x of the planes with u = 0.
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
        bcs=[hold(V, None, plane(mesh, 0, x)) for x in clamped],
        petsc_options_prefix="body_",
        **settings,
    )


def create_heat(mesh: dolfinx.mesh.Mesh, *, degree: int, **settings: object) -> LinearProblem:
    """Build Poisson's equation with a unit source and u = 0 at x = 0; see create_elastic."""
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    source = dolfinx.fem.Constant(mesh, 1.0)
    return LinearProblem(
        ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        ufl.inner(source, v) * ufl.dx,
        bcs=[hold(V, None, plane(mesh, 0, 0.0))],
        petsc_options_prefix="body_",
        **settings,
    )


def create_block(
    comm: MPI.Comm, lengths: Sequence[float], cells: Sequence[int]
) -> dolfinx.mesh.Mesh:
    """Mesh a block from the origin with hexahedra."""
    corners = [np.zeros(3), np.array(lengths)]
    kind = dolfinx.mesh.CellType.hexahedron
    with repeatable_partitions():
        return dolfinx.mesh.create_box(comm, corners, list(cells), cell_type=kind)


def plane(mesh: dolfinx.mesh.Mesh, axis: int, x: float) -> Indices:
    """Return the facets of the boundary in a plane normal to an axis."""
    d = mesh.topology.dim - 1
    return np.sort(dolfinx.mesh.locate_entities_boundary(mesh, d, lambda y: np.isclose(y[axis], x)))


def displacement(u: dolfinx.fem.Function, point: Sequence[float]) -> Array:
    """Return the displacement of the node at a place [mm]."""
    V = u.function_space
    here = np.linalg.norm(V.tabulate_dof_coordinates() - point, axis=1) < 1e-6
    found = V.mesh.comm.allgather(u.x.array.reshape(-1, 3)[here])
    return np.concatenate(found)[0]


def hold(
    V: dolfinx.fem.FunctionSpace, component: int | None, facets: Indices
) -> dolfinx.fem.DirichletBC:
    """Return the condition that a function of V, or one of its components, is zero on facets."""
    part = V if component is None else V.sub(component)
    dofs = dolfinx.fem.locate_dofs_topological(part, V.mesh.topology.dim - 1, facets)
    zero = np.zeros(V.value_shape if component is None else ())
    return dolfinx.fem.dirichletbc(zero, dofs, part)


def create_plate(
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
    return create_block(comm, lengths, (n, max(1, round(PLATE_WIDTH * n)), 1))


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
