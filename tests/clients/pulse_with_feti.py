# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Plugin of pytest that lets fenicsx-pulse's own tests solve by FETI, and by LU for comparison.

``scripts/clients.py`` runs pulse's tests with ``-p pulse_with_feti``. Each ``StaticProblem`` gets
a solver that first lets dolfinx solve the same forms by LU, then returns to the start, solves by
FETI, and compares all unknowns. Pressures are discontinuous, as FETI condenses them.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, ClassVar

from mpi4py import MPI  # before petsc4py: the wheels of PyPI bring MPI along with it

import cardiac_geometries
import numpy as np
import pulse
import pytest

import dolfinx
import dolfinx.fem.petsc

from dolfinx_feti import ConvergenceError, NonlinearProblem

#: Subdomains of each problem. The default would be one for meshes of this size, and FETI without an
#: iteration; with 4 or 16 as many tests would pass.
SUBDOMAINS = 8

#: Absolute tolerance of both Newton methods. Pulse's own, 1e-6, is 1e-5 of the load on a mesh in
#: metres: both solvers then stop at different states, 3e-6 apart.
SNES_ATOL = 1e-10

#: Most that the displacement may differ from LU's, over its largest value. Incompressible cells
#: keep their volume to 1e-8: where the base is fixed and the volume given, u is 3e-3 of the wall's
#: size, and they differ by 2.0e-6. With ``volume_tolerance=1e-9`` that is 9.5e-8. Elsewhere it is
#: at most 1e-6; at a tenth of that the error of pulse's Newton method shows, which stops at steps
#: of 1e-8 of the solution.
MAX_DIFFERENCE = 4e-6

#: Most that the other unknowns may differ, over their largest value. Incompressible cells keep
#: their volume to 1e-8, which is kappa 1e-8 = 6e-3 Pa in a pressure of 1e3 Pa; a tenth of this
#: bound is reached where the load is small.
MAX_PRESSURE_DIFFERENCE = 1e-4


class FETIProblem(NonlinearProblem):
    """The class of docs/pulse.md: pulse asks ``problem.solver`` whether it has converged."""

    def solve(self) -> Any:
        """Solve; if Newton's method fails, raise its error only if pulse is to raise one."""
        try:
            return super().solve()
        except ConvergenceError:
            if self.solver.getErrorIfNotConverged():
                raise


class ComparedProblem(FETIProblem):
    """A FETI problem that compares each solution with dolfinx's, which solves by LU.

    Attributes:
        created: All such problems of the present test.
    """

    created: ClassVar[list[ComparedProblem]] = []

    def __init__(self, F: Any, u: Any, **arguments: Any) -> None:
        """Create the problem, and the one of dolfinx with the same forms."""
        arguments["petsc_options"] = {**arguments["petsc_options"], "snes_atol": SNES_ATOL}
        super().__init__(F, u, subdomains=SUBDOMAINS, **arguments)
        arguments["petsc_options_prefix"] = "reference_"
        self.reference = dolfinx.fem.petsc.NonlinearProblem(F, u, **arguments)
        self.reference.solver.setErrorIfNotConverged(False)
        self.unknowns = list(u) if isinstance(u, list) else [u]
        self.linear_iterations = 0
        self.solves = 0
        self.differences: dict[str, float] = {}
        self.created.append(self)

    def solve(self) -> Any:
        """Solve by LU and by FETI from the same start; compare all unknowns. Collective."""
        starts = [w.x.array.copy() for w in self.unknowns]
        self.reference.solve()
        expected = [w.x.array.copy() for w in self.unknowns]
        for w, start in zip(self.unknowns, starts, strict=True):
            w.x.array[:] = start
        self.solves += 1
        try:
            solution = super().solve()
        finally:
            self.linear_iterations += sum(step.linear_iterations for step in self.history)
        has_converged = self.solver.getConvergedReason() > 0
        assert has_converged == (self.reference.solver.getConvergedReason() > 0), (
            f"FETI has the converged reason {self.solver.getConvergedReason()}, dolfinx's Newton "
            f"method {self.reference.solver.getConvergedReason()} in solve {self.solves}"
        )
        if has_converged:
            for number, (w, values) in enumerate(zip(self.unknowns, expected, strict=True)):
                self._compare(number, w, values)
        return solution

    def _compare(self, number: int, w: dolfinx.fem.Function, expected: np.ndarray) -> None:
        """Fail if unknown number ``number``, whose first is u, is not LU's. Collective."""
        comm = w.function_space.mesh.comm
        missed = comm.allreduce(np.abs(w.x.array - expected).max(initial=0.0), op=MPI.MAX)
        largest = comm.allreduce(np.abs(expected).max(initial=0.0), op=MPI.MAX)
        if missed == 0.0:
            return
        difference = missed / largest
        kind = "displacement"
        bound = MAX_DIFFERENCE
        if number > 0:
            kind = "other unknowns"
            bound = MAX_PRESSURE_DIFFERENCE
        self.differences[kind] = max(self.differences.get(kind, 0.0), difference)
        assert difference < bound, (
            f"unknown {number}, {w.name}, differs from LU's by {difference:.1e} of its largest "
            f"value {largest:.3g} in solve {self.solves}, more than {bound:g}"
        )


def _keep_in_memory() -> None:
    """Make cardiac_geometries return its geometries without files.

    It writes them with ADIOS2, which the wheel of dolfinx is built without, and h5py's wheel cannot
    write on several processes.
    """
    made: dict[Path, Any] = {}
    create = cardiac_geometries.mesh.lv_ellipsoid

    def lv_ellipsoid(outdir: Path, comm: MPI.Comm, **arguments: Any) -> Any:
        folder = Path(comm.bcast(str(outdir), root=0))  # pytest names one for each process
        made[Path(outdir)] = create(outdir=folder, comm=comm, **arguments)
        return made[Path(outdir)]

    def from_folder(comm: MPI.Comm, folder: Path, **arguments: Any) -> Any:
        return made.pop(Path(folder))

    def nothing(*arguments: Any, **named: Any) -> None:
        return None

    cardiac_geometries.mesh.lv_ellipsoid = lv_ellipsoid
    cardiac_geometries.mesh.save_geometry = nothing
    cardiac_geometries.fibers.utils.save_microstructure = nothing
    cardiac_geometries.geometry.Geometry.from_folder = from_folder


def _solve_by_feti() -> None:
    """Replace the problem of each StaticProblem, and use discontinuous pressures."""
    initialise = pulse.StaticProblem.__init__

    def with_feti(self: pulse.StaticProblem, *positional: Any, **named: Any) -> None:
        named["NonlinearProblem"] = ComparedProblem
        named["parameters"] = {**named.get("parameters", {}), "p_space": "DG_0"}
        initialise(self, *positional, **named)

    pulse.StaticProblem.__init__ = with_feti


_keep_in_memory()
_solve_by_feti()


@pytest.fixture
def mesh() -> dolfinx.mesh.Mesh:
    """The mesh of pulse's smaller tests, whose fixture is missing from its source archive."""
    return dolfinx.mesh.create_unit_cube(MPI.COMM_WORLD, 3, 3, 3)


@pytest.fixture(autouse=True)
def compared_problems(request: pytest.FixtureRequest) -> Any:
    """Fail a test that FETI has not solved, and print what it took."""
    ComparedProblem.created.clear()
    yield
    problems = ComparedProblem.created
    solves = sum(p.solves for p in problems)
    iterations = sum(p.linear_iterations for p in problems)
    differences: dict[str, float] = {}
    for problem in problems:
        for kind, value in problem.differences.items():
            differences[kind] = max(differences.get(kind, 0.0), value)
    compared = "".join(f", {kind} {value:.1e} off LU's" for kind, value in differences.items())
    if MPI.COMM_WORLD.rank == 0:
        sys.stdout.write(
            f"\nclients: {request.node.name} on {MPI.COMM_WORLD.size} processes: {solves} solves, "
            f"{iterations} FETI iterations{compared}\n"
        )
    assert solves > 0, "pulse has not solved by FETI"
    assert iterations > 0, "FETI took no iteration: the problem has one subdomain"
