# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Contact with rigid tools and closed forms: Hertz, a tube on a balloon, a ring between plates.

    python3 -m benchmarks.contact --json build/contact.json

Hertz: a rigid sphere of radius R enters an elastic half space by d,

.. math:: a = \Bigl(\frac{3 F R}{4 E^*}\Bigr)^{1/3}, \quad
          p_0 = \Bigl(\frac{6 F {E^*}^2}{π^3 R^2}\Bigr)^{1/3}, \quad
          d = \Bigl(\frac{9 F^2}{16 R {E^*}^2}\Bigr)^{1/3}, \qquad E^* = \frac{E}{1 - ν^2}.

Tube: an incompressible neo-Hookean tube in plane strain on a cylinder of radius a,

.. math:: p = μ \int_A^B \Bigl(\frac{r^2}{ρ^2} - \frac{ρ^2}{r^2}\Bigr) \frac{ρ}{r^2}
          \,\mathrm{d}ρ, \qquad r^2 = ρ^2 + a^2 - A^2.

Ring: closed between two plates, the work of the plates is the stored energy. Wall: a tube in three
dimensions widened by a balloon, compared with the same tube under pressure.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass

from mpi4py import MPI

import numpy as np
import scipy.integrate

import dolfinx
import ufl

from benchmarks.common.pages import Fields, section
from benchmarks.common.records import Record
from benchmarks.common.study import Arguments, Keep, Study
from dolfinx_feti import NonlinearProblem, materials
from dolfinx_feti.contact import Contact, cylinder, half_space, sphere
from dolfinx_feti.loading import LoadStep, Steps, follow_load
from dolfinx_feti.meshes.curved import create_curved_mesh
from dolfinx_feti.runtime.scotch import repeatable_partitions

#: Coordinates [mm]: (3, n) for a marker, (n, dim) for a map of a mesh.
Points = np.ndarray
#: Marks some of the points, (n,).
Marker = Callable[[Points], np.ndarray]


def hertz(comm: MPI.Comm, cells: int = 16) -> Record:
    """Press a rigid sphere into a half space, in ten steps. Collective.

    Args:
        comm: A communicator.
        cells: Cells along twice the radius of the contact.
    """
    a = 1.0  # radius of the contact at the end, by Hertz's theory [mm]
    R = 50.0  # of the sphere [mm]
    E = 1.0  # kPa
    ν = 0.3
    modulus = E / (1.0 - ν**2)  # E*
    line = _graded_coordinates(cells, 2.0 * a, ratio=1.25, far=800.0 * a)
    n = len(line) - 1
    far = line[-1]
    with repeatable_partitions():
        mesh = dolfinx.mesh.create_unit_square(comm, n, n, dolfinx.mesh.CellType.quadrilateral)
    i = np.rint(mesh.geometry.x[:, :2] * n).astype(int)
    mesh.geometry.x[:, 0] = line[i[:, 0]]
    mesh.geometry.x[:, 1] = -line[n - i[:, 1]]
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    u = dolfinx.fem.Function(V, name="u")
    r = ufl.SpatialCoordinate(mesh)[0]
    strain = ufl.sym(ufl.grad(u))
    hoop = u[0] / r
    μ = E / (2.0 * (1.0 + ν))
    λ = E * ν / ((1.0 + ν) * (1.0 - 2.0 * ν))
    density = λ / 2 * (ufl.tr(strain) + hoop) ** 2
    density += μ * (ufl.inner(strain, strain) + hoop**2)
    energy = 2 * ufl.pi * r * density * ufl.dx(metadata={"quadrature_degree": 4})
    bcs = [
        _zero_component(V, 0, lambda x: np.isclose(x[0], 0.0)),
        *(
            _zero_component(V, k, lambda x: np.isclose(x[1], -far) | np.isclose(x[0], far))
            for k in (0, 1)
        ),
    ]
    ds = _surface(mesh, lambda x: np.isclose(x[1], 0.0) & (x[0] < 6.0 * a))
    centre = dolfinx.fem.Constant(mesh, np.array([0.0, R]))
    contact = Contact(u, ds, sphere(R, centre), weight=2 * ufl.pi * r)
    problem = NonlinearProblem(energy, u, bcs=bcs, contacts=[contact], subdomains=4)
    depth = a**2 / R  # d
    newton_steps = 0
    for share in np.linspace(0.1, 1.0, 10):
        centre.value[1] = R - share * depth
        problem.solve()
        newton_steps += len(problem.history)
    force = -contact.force()[1]
    p = contact.pressure
    radius = ufl.SpatialCoordinate(p.function_space.mesh)[0]
    touching = ufl.conditional(ufl.gt(p, 0.0), 2 * ufl.pi * radius, 0.0)
    area = _integral(touching * ufl.dx(metadata={"quadrature_degree": 4}), comm)
    exact_radius = (3 * force * R / (4 * modulus)) ** (1 / 3)
    exact_pressure = (6 * force * modulus**2 / (np.pi**3 * R**2)) ** (1 / 3)
    return {
        "dofs": 2 * V.dofmap.index_map.size_global,
        "newton": newton_steps,
        "radius_error": np.sqrt(area / np.pi) / exact_radius - 1,
        "pressure_error": _largest(p, comm) / exact_pressure - 1,
        "force_error": force / (4 / 3 * modulus * np.sqrt(R) * depth**1.5) - 1,
    }


def tube(comm: MPI.Comm, cells: int = 3) -> Record:
    """Widen a thick tube in plane strain by a rigid cylinder. Collective.

    Args:
        comm: A communicator.
        cells: Cells through the thickness.
    """
    A = 1.0  # radii of the tube [mm]
    B = 1.5
    a = 1.4  # of the cylinder [mm]
    μ = 1.0  # kPa
    κ = 1e4  # kPa
    mesh = _ring_mesh(comm, (cells, 3 * cells), (A, B))
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    u = dolfinx.fem.Function(V, name="u")
    p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DPC", 1)), name="p")
    F, J = _plane_strain(u)
    density = materials.neo_hookean(F.T * F, c=μ, J=J) + p * (J - 1) - p**2 / (2 * κ)
    energy = density * ufl.dx(metadata={"quadrature_degree": 5})
    radius = dolfinx.fem.Constant(mesh, np.float64(A))
    contact = Contact(u, _surface(mesh, _at_radius(A)), sphere(radius))
    problem = NonlinearProblem(
        energy, u, bcs=_symmetry_conditions(V), condense=p, contacts=[contact], subdomains=4
    )

    def set_radius(value: float) -> None:
        radius.value = value

    steps = follow_load(problem, set_radius, [a], Steps(first=0.1, least=0.01), start=A)
    increase = a**2 - A**2  # r² − ρ²

    def integrand(ρ: float) -> float:
        r2 = ρ**2 + increase
        return μ * (r2 / ρ**2 - ρ**2 / r2) * ρ / r2

    exact_pressure, _ = scipy.integrate.quad(integrand, A, B)
    pressure = _mean(contact.true_pressure(), comm)
    x = V.tabulate_dof_coordinates()
    outer = np.flatnonzero(np.isclose(np.hypot(x[:, 0], x[:, 1]), B))
    radii = np.hypot(*(x[outer, :2] + u.x.array.reshape(-1, 2)[outer]).T)
    radius_error = float(np.abs(radii / np.sqrt(B**2 + increase) - 1.0).max(initial=0.0))
    return {
        "dofs": 2 * V.dofmap.index_map.size_global,
        "newton": _newton_steps(steps),
        "pressure_error": pressure / exact_pressure - 1.0,
        "outer_radius_error": comm.allreduce(radius_error, op=MPI.MAX),
    }


def ring(comm: MPI.Comm, cells: int = 24) -> Record:
    """Close a ring between two plates to 60 % of its height. Collective.

    Args:
        comm: A communicator.
        cells: Cells along a quarter of the ring.
    """
    A = 0.9  # radii [mm]
    B = 1.0
    μ = 1.0  # kPa
    closure = 0.4  # share of the height
    mesh = _ring_mesh(comm, (2, cells), (A, B))
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    u = dolfinx.fem.Function(V, name="u")
    F, J = _plane_strain(u)
    density = materials.neo_hookean(F.T * F, c=μ, J=J) + materials.volumetric(J, 10.0 * μ)
    energy = density * ufl.dx(metadata={"quadrature_degree": 5})
    height = dolfinx.fem.Constant(mesh, np.float64(B))
    plate = half_space((0, -1), offset=-height)
    contact = Contact(u, _surface(mesh, _at_radius(B)), plate)
    problem = NonlinearProblem(
        energy, u, bcs=_symmetry_conditions(V), contacts=[contact], subdomains=4
    )
    heights = [B]
    forces = [0.0]

    def set_height(value: float) -> None:
        height.value = value

    def on_step(step: LoadStep) -> None:
        heights.append(step.load)
        forces.append(float(contact.force()[1]))

    increments = Steps(first=0.02, least=1e-4, growth=1.2)
    lowest = (1.0 - closure) * B
    steps = follow_load(problem, set_height, [lowest], increments, start=B, on_step=on_step)
    work = float(np.trapezoid(forces, heights))
    stored_energy = _integral(energy, comm)
    return {
        "dofs": 2 * V.dofmap.index_map.size_global,
        "load_steps": len(steps),
        "newton": _newton_steps(steps),
        "energy_error": work / stored_energy - 1.0,
        "force": forces[-1] / (μ * B),
    }


def wall(comm: MPI.Comm, cells: int = 10) -> Record:
    """Widen a tube in three dimensions by a balloon, and by a similar pressure. Collective.

    Args:
        comm: A communicator.
        cells: Cells along a quarter of the tube.
    """
    A = 1.0  # radii of the tube [mm]
    B = 1.3
    length = 2.0  # mm
    a = 1.2  # radius of the balloon [mm]
    μ = 10.0  # kPa
    κ = 1000.0  # kPa
    iterations: dict[str, list[int]] = {}  # of each Newton step
    dofs = 0
    for kind in ("contact", "pressure"):
        mesh = _tube_mesh(comm, (2, cells, cells), (A, B, length))
        V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
        dofs = 3 * V.dofmap.index_map.size_global
        u = dolfinx.fem.Function(V, name="u")
        p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="p")
        F = ufl.Identity(3) + ufl.grad(u)
        J = ufl.det(F)
        density = materials.neo_hookean(F.T * F, c=μ, J=J) + p * (J - 1) - p**2 / (2 * κ)
        energy = density * ufl.dx(metadata={"quadrature_degree": 4})
        ds = _surface(mesh, _at_radius(A, 1e-6))
        load = dolfinx.fem.Constant(mesh, np.float64(A))  # radius of the balloon, or pressure
        bcs = [
            *_symmetry_conditions(V),
            _zero_component(V, 2, lambda x: np.isclose(x[2] % length, 0.0)),
        ]
        contacts = []
        if kind == "contact":
            contacts = [Contact(u, ds, cylinder((0, 0, 1), load))]
            target = a
        else:
            N = ufl.FacetNormal(mesh)
            energy += load * ufl.dot(u, N) * ds  # a dead load
            load.value = 0.0
            target = 2.0  # kPa
        problem = NonlinearProblem(energy, u, bcs=bcs, condense=p, contacts=contacts, subdomains=16)

        def set_load(value: float, load: dolfinx.fem.Constant = load) -> None:
            load.value = value

        start = float(load.value)
        first = (target - start) / 3.0
        increments = Steps(first=first, least=first / 16)
        steps = follow_load(problem, set_load, [target], increments, start=start)
        newton_steps = [newton for load_step in steps for newton in load_step.all_steps]
        iterations[kind] = [newton.linear_iterations for newton in newton_steps]
    return {
        "dofs": dofs,
        "newton": len(iterations["contact"]),
        "newton_pressure": len(iterations["pressure"]),
        "iterations": float(np.mean(iterations["contact"])),
        "iterations_pressure": float(np.mean(iterations["pressure"])),
        "most_iterations": max(iterations["contact"]),
        "most_iterations_pressure": max(iterations["pressure"]),
    }


def _graded_coordinates(cells: int, fine: float, *, ratio: float, far: float) -> np.ndarray:
    """Return the coordinates of a graded line from 0, (n,) [mm].

    Args:
        cells: Number of equal cells from 0 to ``fine``.
        fine: Length of the uniform part [mm].
        ratio: Ratio of the lengths of neighbouring cells beyond it.
        far: Length that the line has at least [mm].
    """
    coordinates = list(np.linspace(0.0, fine, cells + 1))
    length = fine / cells
    while coordinates[-1] < far:
        length *= ratio
        coordinates.append(coordinates[-1] + length)
    return np.array(coordinates)


def _ring_mesh(
    comm: MPI.Comm, cells: tuple[int, int], radii: tuple[float, float]
) -> dolfinx.mesh.Mesh:
    """Mesh a quarter of a ring with quadrilaterals of quadratic geometry.

    Args:
        comm: A communicator.
        cells: Cells through the thickness and around.
        radii: Inner and outer radius [mm].
    """
    kind = dolfinx.mesh.CellType.quadrilateral
    mesh = dolfinx.mesh.create_rectangle(comm, [(0, 0), (1, 1)], cells, kind)
    A, B = radii

    def place(x: Points) -> Points:
        return _polar(A + (B - A) * x[:, 0], x[:, 1], [])

    return create_curved_mesh(mesh, place)


def _tube_mesh(
    comm: MPI.Comm, cells: tuple[int, int, int], sizes: tuple[float, float, float]
) -> dolfinx.mesh.Mesh:
    """Mesh a quarter of a tube with tetrahedra of quadratic geometry.

    Args:
        comm: A communicator.
        cells: Cells through the thickness, around and along.
        sizes: Inner and outer radius, and length [mm].
    """
    with repeatable_partitions():
        mesh = dolfinx.mesh.create_unit_cube(comm, *cells)
    A, B, length = sizes

    def place(x: Points) -> Points:
        return _polar(A + (B - A) * x[:, 0], x[:, 1], [length * x[:, 2]])

    return create_curved_mesh(mesh, place)


def _polar(r: np.ndarray, share: np.ndarray, along: list[np.ndarray]) -> np.ndarray:
    """Return the positions with polar coordinates r and share · 90°, (n, 2 or 3).

    Args:
        r: Radii [mm], (n,).
        share: Angles over a right angle, (n,).
        along: Coordinates along the axis [mm], (n,); none in the plane.
    """
    angle = np.pi / 2.0 * share
    return np.stack([r * np.cos(angle), r * np.sin(angle), *along], axis=1)


def _plane_strain(u: dolfinx.fem.Function) -> tuple[ufl.core.expr.Expr, ufl.core.expr.Expr]:
    """Return F in three dimensions, and J, of a displacement in the plane."""
    grad = ufl.grad(u)
    F = ufl.as_tensor([[1 + grad[0, 0], grad[0, 1], 0], [grad[1, 0], 1 + grad[1, 1], 0], [0, 0, 1]])
    return F, ufl.det(F)


def _at_radius(radius: float, atol: float = 1e-8) -> Marker:
    """Return the marker of points at a distance from the axis [mm]."""
    return lambda x: np.isclose(np.hypot(x[0], x[1]), radius, rtol=0.0, atol=atol)


def _surface(mesh: dolfinx.mesh.Mesh, where: Marker) -> ufl.Measure:
    """Return the measure of the boundary facets that a marker marks."""
    dim = mesh.topology.dim - 1
    facets = dolfinx.mesh.locate_entities_boundary(mesh, dim, where)
    tags = dolfinx.mesh.meshtags(mesh, dim, np.sort(facets), np.ones(len(facets), dtype=np.int32))
    return ufl.Measure("ds", mesh, subdomain_data=tags)(1)


def _zero_component(V: dolfinx.fem.FunctionSpace, k: int, where: Marker) -> dolfinx.fem.DirichletBC:
    """Return the condition that component k is zero on the facets that a marker marks."""
    part = V.sub(k)
    dim = V.mesh.topology.dim - 1
    collapsed, _ = part.collapse()
    facets = dolfinx.mesh.locate_entities_boundary(V.mesh, dim, where)
    dofs = dolfinx.fem.locate_dofs_topological((part, collapsed), dim, facets)
    return dolfinx.fem.dirichletbc(dolfinx.fem.Function(collapsed), dofs, part)


def _symmetry_conditions(V: dolfinx.fem.FunctionSpace) -> list[dolfinx.fem.DirichletBC]:
    """Return the conditions of a quarter: no displacement normal to its planes of symmetry."""
    return [
        _zero_component(V, 0, lambda x: np.isclose(x[0], 0.0)),
        _zero_component(V, 1, lambda x: np.isclose(x[1], 0.0)),
    ]


def _newton_steps(steps: Sequence[LoadStep]) -> int:
    """Return the number of Newton steps of some load steps, failed attempts included."""
    return sum(len(step.all_steps) for step in steps)


def _integral(form: ufl.Form, comm: MPI.Comm) -> float:
    """Return the value of a form without arguments. Collective."""
    return float(comm.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(form))))


def _mean(f: dolfinx.fem.Function, comm: MPI.Comm) -> float:
    """Return the mean over the dofs of all processes. Collective."""
    values = f.x.array[: f.function_space.dofmap.index_map.size_local]
    total, count = comm.allreduce(np.array([values.sum(), len(values)]))
    return float(total / count)


def _largest(f: dolfinx.fem.Function, comm: MPI.Comm) -> float:
    """Return the largest value of a dof, 0 at least. Collective."""
    return float(comm.allreduce(f.x.array.max(initial=0.0), op=MPI.MAX))


#: By name: a function that solves a case on a communicator and returns its record.
CASES: dict[str, Callable[[MPI.Comm], Record]] = {
    "hertz": hertz,
    "tube": tube,
    "ring": ring,
    "wall": wall,
}


@dataclass(frozen=True, slots=True)
class Comparison:
    """A row of the page: a quantity beside its closed form.

    Args:
        case: A key of :data:`CASES`.
        title: Name of the case on the page.
        quantity: Name of the quantity on the page.
        key: Key of its relative error in a record.
        bound: Accepted error [%].
    """

    case: str
    title: str
    quantity: str
    key: str
    bound: float


SPHERE = "sphere on a half space"
WIDENED = "tube on a cylinder that grows by 40 %"
CLOSED = "ring between plates, closed by 40 %"

COMPARISONS = (
    Comparison("hertz", SPHERE, "radius of the contact", "radius_error", 2.0),
    Comparison("hertz", SPHERE, "greatest pressure", "pressure_error", 3.0),
    Comparison("hertz", SPHERE, "force at a depth", "force_error", 1.0),
    Comparison("tube", WIDENED, "pressure in the lumen", "pressure_error", 0.5),
    Comparison("tube", WIDENED, "outer radius", "outer_radius_error", 0.1),
    Comparison("ring", CLOSED, "work beside the energy", "energy_error", 0.5),
)


def _fields(records: Sequence[Record]) -> Fields:
    """Return a row for each recorded quantity, its error in percent, and the iterations."""
    by_case = {record["case"]: record for record in records}
    rows = []
    for compared in COMPARISONS:
        if compared.case in by_case:
            record = by_case[compared.case]
            error = 100.0 * record[compared.key]
            rows.append(record | asdict(compared) | {"error": error})
    walls = []
    if "wall" in by_case:
        wall = by_case["wall"]
        walls.append(wall | {"ratio": wall["iterations"] / wall["iterations_pressure"]})
    return {"rows": rows, "walls": section(walls)}


def _is_known(record: Record) -> bool:
    """Return True if a record is one of this study."""
    return record.get("case") in CASES and "newton" in record


def _cases(_args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    for case in CASES:
        yield {"case": case, "processes": comm.size}


def _run(case: Record, keep: Keep, _args: Arguments, comm: MPI.Comm) -> None:
    """Solve a case and time it. Collective."""
    started = time.perf_counter()
    values = CASES[case["case"]](comm)
    keep({}, values | {"seconds": time.perf_counter() - started})


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="contact",
    known=_is_known,
    cases=_cases,
    run=_run,
    fields=_fields,
)

if __name__ == "__main__":
    STUDY.main()
