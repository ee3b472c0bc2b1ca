# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The paper's cube: elasticity with the fundamental solution prescribed on the whole surface.

Kelvin's fundamental solution is the displacement of the whole space under a unit force at
:math:`x^*` in the direction of the first axis, and the exact solution in the cube:

.. math:: U^*_{1k}(x, x^*) = \frac{1}{8π} \frac{1}{E} \frac{1 + ν}{1 - ν} \left[
          (3 - 4ν) \frac{δ_{1k}}{|x - x^*|} +
          \frac{(x_1 - x^*_1)(x_k - x^*_k)}{|x - x^*|^3} \right], \qquad k = 1, 2, 3

(eq. 52, Augustin_eq:fundSol).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl

from benchmarks.common.clock import Stopwatch, event_clock
from benchmarks.common.records import Record
from dolfinx_feti import LinearProblem
from dolfinx_feti.meshes.cube import create_cube
from dolfinx_feti.runtime import compat

#: Young's modulus and Poisson's ratio, the paper's.
YOUNG = 210.0
POISSON = 0.45

#: x*, outside of the cube.
SOURCE = (2.0, 2.0, 2.0)

#: Degree of the quadrature that measures the error.
QUADRATURE = 6

#: Relative reduction of the dual residual, the paper's.
RTOL = 1e-8

#: Functions that mark stiff subcubes, (n,). Arguments: indices of each subcube along three axes,
#: (n, 3); number of subcubes on an edge.
PATTERNS = {
    "none": lambda place, edge: np.zeros(len(place), dtype=bool),
    "checkerboard": lambda place, edge: place.sum(axis=1) % 2 == 1,
    "layer": lambda place, edge: place[:, 2] == edge // 2,
}


@dataclass(frozen=True, slots=True)
class Case:
    """Parameters of a case; the defaults are the paper's.

    Args:
        degree: Degree of the displacement.
        level: Level of refinement: 2^(level − 1) cells along an edge of a subdomain.
        subdomains_per_edge: Subdomains along an edge of the cube.
        type: ``feti_type``.
        pc: ``feti_pc_type``.
        scaling: ``feti_scaling``.
        coarse_q: ``feti_coarse_q``.
        coarse_modes: ``feti_coarse_modes``.
        reorthogonalize: Whether CG reorthogonalises all directions.
        jump: Factor of Young's modulus in the stiff subcubes.
        pattern: A key of :data:`PATTERNS`.
    """

    degree: int = 1
    level: int = 1
    subdomains_per_edge: int = 8
    type: str = "all_floating"
    pc: str = "dirichlet"
    scaling: str = "multiplicity"
    coarse_q: str = "identity"
    coarse_modes: int = 0
    reorthogonalize: bool = False
    jump: float = 1.0
    pattern: str = "none"

    def options(self) -> dict[str, object]:
        """Return the options of the solver."""
        return {
            "feti_formulation": "dual",
            "feti_type": self.type,
            "feti_pc_type": self.pc,
            "feti_scaling": self.scaling,
            "feti_coarse_q": self.coarse_q,
            "feti_coarse_modes": self.coarse_modes,
            **({"feti_dual_ksp_type": "fcg"} if self.reorthogonalize else {}),
            "feti_dual_ksp_rtol": RTOL,
        }


def create_problem(
    case: Case, comm: MPI.Comm
) -> tuple[Callable[[], LinearProblem], ufl.core.expr.Expr]:
    """Mesh the cube of a case. Collective.

    Returns:
        A function that creates the problem, whose PETSc options have the prefix ``cube_``: memory
        is measured from before its call. And the fundamental solution, which is exact if the
        coefficient does not jump.
    """
    subdomains = case.subdomains_per_edge
    mesh, part = create_cube(comm, subdomains, 2 ** (case.level - 1))
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", case.degree, (3,)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    mu = YOUNG / (2 * (1 + POISSON))
    lmbda = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    energy = 2 * mu * ufl.inner(_strain(u), _strain(v)) + lmbda * ufl.div(u) * ufl.div(v)
    if case.pattern != "none":
        indices = np.column_stack(np.unravel_index(part, (subdomains,) * 3))
        is_stiff = PATTERNS[case.pattern](indices, subdomains)
        factor = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
        dofs_of_cells = factor.function_space.dofmap.list[: len(part), 0]
        factor.x.array[dofs_of_cells] = np.where(is_stiff, case.jump, 1.0)
        energy = factor * energy
    exact = _fundamental_solution(mesh)
    values = dolfinx.fem.Function(V)
    values.interpolate(dolfinx.fem.Expression(exact, compat.interpolation_points(V)))
    mesh.topology.create_connectivity(2, 3)
    surface = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    dofs = dolfinx.fem.locate_dofs_topological(V, 2, surface)
    L = ufl.inner(dolfinx.fem.Constant(mesh, np.zeros(3)), v) * ufl.dx
    create = partial(
        LinearProblem,
        energy * ufl.dx,
        L,
        bcs=[dolfinx.fem.dirichletbc(values, dofs)],
        subdomains=part,
        petsc_options_prefix="cube_",
        petsc_options=case.options(),
    )
    return create, exact


def solve(linear: LinearProblem) -> Record:
    """Solve a problem; return sizes, iterations, spectrum and seconds. Collective."""
    comm = linear.u.function_space.mesh.comm
    coarse = event_clock(["FETICoarse"], comm)
    watch = Stopwatch(comm)
    watch.hook(linear.solver)
    linear.solve()
    feti = linear.solver.getPythonContext()
    report = feti.report()
    low, high = feti.eigenvalues
    (setup, krylov) = watch.wall_times()[0]
    (cpu_setup, cpu_krylov) = watch.processor_times()[0]
    return {
        "subdomains": report.subdomains,
        "dofs_local_max": report.dofs_local[1],
        "dofs": report.dofs,
        "dofs_torn": report.torn_dofs,
        "multipliers": report.multipliers,
        "coarse_size": report.coarse_size,
        "coarse_mib": _number(report.coarse_mib),
        "kernels": list(report.kernels),
        "interior_is": report.interior,
        "iterations": feti.iterations,
        "condition_number": _number(feti.condition_number),
        "lambda_min": _number(low),
        "lambda_max": _number(high),
        "relative_residual": feti.residual,
        "seconds_setup": float(setup),
        "seconds_solve": float(krylov),
        "seconds_coarse": coarse()["FETICoarse"],
        "cpu_seconds_setup": float(cpu_setup),
        "cpu_seconds_solve": float(cpu_krylov),
    }


def l2_error(u_h: dolfinx.fem.Function, u: ufl.core.expr.Expr) -> float:
    """Return the norm of the error, ‖u − u_h‖ in L₂ (eq. 53). Collective."""
    difference = u_h - u
    dx = ufl.dx(metadata={"quadrature_degree": QUADRATURE})
    square = dolfinx.fem.assemble_scalar(dolfinx.fem.form(ufl.inner(difference, difference) * dx))
    return float(np.sqrt(u_h.function_space.mesh.comm.allreduce(square, op=MPI.SUM)))


def _strain(u: ufl.core.expr.Expr) -> ufl.core.expr.Expr:
    """Return the linearised strain (eq. 19)."""
    return ufl.sym(ufl.grad(u))


def _fundamental_solution(mesh: dolfinx.mesh.Mesh) -> ufl.core.expr.Expr:
    """Return Kelvin's solution with its source at SOURCE (eq. 52)."""
    d = ufl.SpatialCoordinate(mesh) - ufl.as_vector(SOURCE)
    r = ufl.sqrt(ufl.dot(d, d))
    scale = (1 + POISSON) / (8 * np.pi * YOUNG * (1 - POISSON))
    direction = ufl.as_vector([1.0, 0.0, 0.0])
    return scale * ((3 - 4 * POISSON) * direction / r + d[0] * d / r**3)


def _number(value: float) -> float | None:
    """Return a number, or None if it is not finite: JSON has no NaN."""
    return float(value) if np.isfinite(value) else None
