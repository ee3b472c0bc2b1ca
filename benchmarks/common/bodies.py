# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Bodies of a given energy, how they are held and loaded, and unit cubes of a given size.

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

#: Length over thickness of the plates.
PLATES = {"plate-20": 20.0, "plate-100": 100.0, "plate-1000": 1000.0}

#: Width over length of the plates.
PLATE_WIDTH = 0.6

#: Stiffness of the inclusions over that of the rest, by the body.
INCLUSIONS = {"inclusions-1e4": 1e4, "inclusions-1e8": 1e8}

#: Radius of an inclusion; there are three along each edge of the unit cube.
INCLUSION_RADIUS = 0.12
INCLUSIONS_PER_EDGE = 3

#: A component of the displacement, or all of them, that is zero on a surface.
Held = tuple[int | None, Indices]


@dataclass(frozen=True, slots=True)
class Solid:
    """Displacement u [mm], pressure p [kPa], where u is held, and the stored energy [mN mm]."""

    u: dolfinx.fem.Function
    p: dolfinx.fem.Function
    bcs: list[dolfinx.fem.DirichletBC]
    energy: ufl.Form
    stress: Expr  # Cauchy's σ [kPa]


@dataclass(frozen=True, slots=True)
class Body:
    """A body: its unknowns, residuals (tested with v and q), and how it is held and loaded."""

    u: dolfinx.fem.Function
    p: dolfinx.fem.Function
    residuals: tuple[ufl.Form, ufl.Form]
    held: Sequence[Held]
    problem: NonlinearProblem
    load: dolfinx.fem.Constant
    stress: Expr  # Cauchy's σ [kPa]
    measure: Callable[[], dict[str, float]]  # of the state in u and p; collective
    unit: float = 1.0  # of the load

    @property
    def dofs(self) -> int:
        """Displacement dofs."""
        dofmap = self.u.function_space.dofmap
        return dofmap.index_map.size_global * dofmap.index_map_bs

    def set_load(self, value: float) -> None:
        """Set the load, in its unit."""
        self.load.value = value * self.unit

    def inflate(self, to: Sequence[float], steps: Steps, **settings: object) -> list[LoadStep]:
        """Follow the load from equilibrium to equilibrium, see ``follow_load``."""
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
    """Build a body without loads of Ψ(C, J) [kPa] and κ [kPa].

    Each component of u has an element, or else P_k or Q_k; the quadrature is of degree 2 k. G is
    the part of the deformation without energy, det G = 1.
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
    tangent: loads.Kind = "auto",
    lumen: bool = False,
    axis: tuple[float, float, float] | None = None,
    settings: Mapping[str, object] | None = None,
    **solid: object,
) -> Body:
    """Build a body whose energy is made of C, J and the share of the load [kPa].

    On the loaded facets acts a pressure that follows the surface, or a force per reference area
    [kPa]; ``measure`` reads off u what is compared. ``tangent`` is what is taken of the
    pressure's derivative. With ``lumen`` Newton's method knows the potential of the pressure, which
    keeps it on the way down, in a lumen whose ends slide along an axis; of a force per area it
    always does. A penalty ½ grip ‖∂u/∂X‖² [kPa mm] keeps the loaded surface flat, as a grip that
    moves with the force does. ``settings`` are further arguments of the problem, ``solid`` those of
    :func:`create_solid`.
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
    comm: MPI.Comm, faces: int, *, dofs: int, kappa: float, degree: int = 2, **settings: object
) -> Body:
    """Build a cube with P_k–P0, clamped at x = 0 or on all faces but x = 1, with a load there.

    Clamped on one, it bears a pressure, else the dead load t (e_x + e_y), which adds nothing to the
    tangent. PETSc options have the prefix ``body_``; the settings are those of the problem.
    """
    mesh = _unit_mesh(comm, dofs, degree, 3)
    places = [(0, 0.0), (1, 0.0), (1, 1.0), (2, 0.0), (2, 1.0)]
    return create_body(
        mesh,
        lambda C, J, _share: materials.neo_hookean(C, c=SHEAR_MODULUS, J=J),
        kappa=kappa,
        held=[(None, plane(mesh, *place)) for place in places[:faces]],
        loaded=plane(mesh, 0, 1.0),
        load=1.0 if faces == 1 else (1.0, 1.0, 0.0),
        degree=degree,
        pressures=("DG", 0),
        tangent="symmetric",
        settings={"petsc_options_prefix": "body_", **settings},
    )


def create_linear(
    comm: MPI.Comm, kind: str, *, dofs: int, degree: int, **settings: object
) -> LinearProblem:
    """Build a compressible body in its weight, or Poisson's equation on a cube, ``heat``.

    A unit ``cube`` or ``square``; a unit cube with stiff :data:`INCLUSIONS`; one of the
    :data:`PLATES`, 1 × 0.6, of one layer of hexahedra. u = 0 at x = 0, and at x = 1 in a plate.
    PETSc options have the prefix ``body_``; the settings are those of the problem.
    """
    dim = 2 if kind == "square" else 3
    elastic = kind != "heat"
    if kind in PLATES:
        mesh = _plate_mesh(comm, dofs, degree, PLATES[kind])
    else:
        mesh = _unit_mesh(comm, dofs, degree, dim, elastic)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (dim,) if elastic else ()))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    strain = ufl.sym(ufl.grad(u)) if elastic else ufl.grad(u)
    stress = strain
    if elastic:
        mu = _modulus(mesh, INCLUSIONS[kind]) if kind in INCLUSIONS else SHEAR_MODULUS
        lmbda = 2 * mu * POISSON / (1 - 2 * POISSON)
        stress = 2 * mu * strain + lmbda * ufl.tr(strain) * ufl.Identity(dim)
    weight = dolfinx.fem.Constant(mesh, np.eye(dim)[-1] if elastic else np.array(1.0))
    ends = (0.0, 1.0) if kind in PLATES else (0.0,)
    return LinearProblem(
        ufl.inner(stress, ufl.grad(v)) * ufl.dx,
        ufl.inner(weight, v) * ufl.dx,
        bcs=[hold(V, None, plane(mesh, 0, x)) for x in ends],
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
    """Return the condition that a function, or a component of it, is zero on facets."""
    part = V if component is None else V.sub(component)
    dofs = dolfinx.fem.locate_dofs_topological(part, V.mesh.topology.dim - 1, facets)
    zero = np.zeros(V.value_shape if component is None else ())
    return dolfinx.fem.dirichletbc(zero, dofs, part)


def _plate_mesh(comm: MPI.Comm, dofs: int, degree: int, slenderness: float) -> dolfinx.mesh.Mesh:
    """Mesh a plate of length 1 with n cells along it, for n² 0.6 degree² (degree + 1) nodes."""
    n = max(2, round((dofs / (3 * PLATE_WIDTH * degree**2 * (degree + 1))) ** 0.5))
    lengths = (1.0, PLATE_WIDTH, 1.0 / slenderness)
    return create_block(comm, lengths, (n, max(1, round(PLATE_WIDTH * n)), 1))


def _modulus(mesh: dolfinx.mesh.Mesh, inclusions: float) -> dolfinx.fem.Function:
    """Return the shear modulus of each cell [kPa], for a ratio of inclusions to the rest."""
    mu = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    x = mu.function_space.tabulate_dof_coordinates()[: len(mu.x.array)]
    centre = (np.floor(INCLUSIONS_PER_EDGE * x) + 0.5) / INCLUSIONS_PER_EDGE
    is_stiff = np.linalg.norm(x - centre, axis=1) < INCLUSION_RADIUS
    mu.x.array[:] = np.where(is_stiff, inclusions * SHEAR_MODULUS, SHEAR_MODULUS)
    return mu


def _unit_mesh(
    comm: MPI.Comm, dofs: int, degree: int, dim: int, elastic: bool = True
) -> dolfinx.mesh.Mesh:
    """Mesh a square or cube with n cells along an edge, for (n degree + 1)^dim nodes."""
    n = max(1, round(((dofs / (dim if elastic else 1)) ** (1 / dim) - 1) / degree))
    create = {2: dolfinx.mesh.create_unit_square, 3: dolfinx.mesh.create_unit_cube}[dim]
    with repeatable_partitions():
        return create(comm, *[n] * dim)
