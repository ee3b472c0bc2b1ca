# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Functions that a script sets on the SNES of a problem: called as PETSc calls them, or refused.

PETSc's own solvers compute residuals and tangents through the SNES. Newton's method of this package
assembles its own, and would never call another function. ``petsc4py`` stores the functions that a
script sets as attributes of the SNES.
"""

from __future__ import annotations

from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.problems.equations.system import Residual, System
from dolfinx_feti.problems.solver_options import BOUNDS_TEXT
from dolfinx_feti.problems.solvers import has_bounds
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.norms import norm
from dolfinx_feti.runtime.petsc_errors import python_errors

#: petsc4py's names of functions that Newton's method never calls. For each: the method of the SNES
#: that sets it, and the remedy, which complete the message of an error.
UNUSED_FUNCTIONS = {
    "__objective__": ("setObjective", "give the potential as energy="),
    "__initialguess__": ("setInitialGuess", "set u before problem.solve()"),
    "__precheck__": ("setLineSearchPreCheck", "the step length is the package's own"),
    "__postcheck__": ("setLineSearchPostCheck", "the step length is the package's own"),
    "__ngs__": ("setNGS", "leave it out"),
}

#: Norms of x and of the step that PETSc passes to a convergence test before the first step.
NO_NORMS = (0.0, 0.0)


class Hooks:
    """Functions of the SNES of a :class:`System`: the package's own, and those of a script."""

    def __init__(self, system: System) -> None:
        """Create the functions of a system; :meth:`attach` sets them.

        Args:
            system: The equations, whose state is that of the user's Functions.
        """
        self._system = system
        self._attached: dict[str, object] = {}  # attributes of the SNES as set by attach

    def attach(self, snes: PETSc.SNES, b: PETSc.Vec) -> None:
        """Set residual and tangent of a SNES, as dolfinx's problems do, and a convergence test.

        Afterwards ``getFunction`` and ``getJacobian`` return callables that move the state of the
        user's Functions to x, and evaluate there. Collective.

        Args:
            snes: The SNES, set from its options.
            b: Vector for the residual.
        """
        options = PETSc.Options(snes.getOptionsPrefix())
        requested = options.getString("snes_convergence_test", "default")
        snes.setFunction(self.compute_residual, b)
        snes.setJacobian(self.compute_tangent, self._system.tangent.A)
        snes.setConvergenceTest("skip" if requested == "skip" else _default_test)
        for name in ("__function__", "__jacobian__"):
            self._attached[name] = snes.getAttr(name)
        # any other test is the script's: "skip" as well, which the option sets instead of ours
        self._attached["__converged__"] = (_default_test, (), {})

    # -- the package's own functions ---------------------------------------------------------------

    def compute_residual(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        """Compute the residual at x into f, with u − g on Dirichlet dofs; u becomes x."""
        self._move(x)
        f.array[:] = self._system.residual().of_u

    def compute_tangent(
        self, snes: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat | None = None
    ) -> None:
        """Assemble the torn tangent at x into the problem's A; u becomes x, and P is ignored."""
        self._move(x)
        self._system.linearise()

    def _move(self, x: PETSc.Vec) -> None:
        """Set u to x, (owned,); condensed fields and scalars stay as they are."""
        state = self._system.state
        state.set(state.values()._replace(u=x.array_r))

    # -- functions that a script has set -----------------------------------------------------------

    def check(self, snes: PETSc.SNES) -> None:
        """Raise an error for functions of a script that Newton's method does not call. Collective.

        Raises:
            ValueError: A foreign residual or tangent, bounds, or another function that is unused.
        """
        on_all(lambda: self._check(snes), self._system.comm)

    def _check(self, snes: PETSc.SNES) -> None:
        """See :meth:`check`; not collective."""
        if snes.getAttr("__function__") != self._attached["__function__"]:
            raise ValueError(
                "problem.solver.setFunction has no effect: Newton's method assembles F itself. "
                "Give the residual as F, and work before each assembly as before_assembly=."
            )
        if snes.getAttr("__jacobian__") != self._attached["__jacobian__"]:
            raise ValueError(
                "problem.solver.setJacobian has no effect: Newton's method assembles J itself, as "
                "a torn matrix. Give the tangent as J, and work before each assembly as "
                "before_assembly=."
            )
        for name, (method, remedy) in UNUSED_FUNCTIONS.items():
            if snes.getAttr(name) is not None:
                raise ValueError(f"problem.solver.{method} has no effect: {remedy}.")
        if snes.hasNPC():
            raise ValueError(
                "problem.solver has a nonlinear preconditioner (getNPC, setNPC), which has no "
                "effect: FETI preconditions the linear systems. Leave it out."
            )
        if has_bounds(snes):
            raise ValueError(f"problem.solver.setVariableBounds {BOUNDS_TEXT}")

    def has_test(self, snes: PETSc.SNES) -> bool:
        """Return True if a script has set a convergence test.

        PETSc's own tests count: "default", set by a script, and "skip", also from an option.
        """
        return bool(snes.getAttr("__converged__") != self._attached["__converged__"])

    def publish(self, snes: PETSc.SNES, residual: Residual) -> None:
        """Write state and residual into the vectors of the SNES, for tests and monitors."""
        snes.getSolution().array[:] = self._system.state.values().u
        snes.getFunction()[0].array[:] = residual.of_u

    def call_test(self, snes: PETSc.SNES, residual: Residual, step: Array | None) -> int:
        """Call a script's convergence test as PETSc does. Collective.

        Args:
            snes: The SNES, whose iteration number is that of the present state.
            residual: Residual there. Its norm includes u − g on Dirichlet dofs, as in dolfinx.
            step: Last change of u, (owned,); None at the start.

        Returns:
            PETSc's converged reason, zero to continue. If processes differ, the smallest: a failure
            on one process is a failure, and the solve has converged only if all agree.
        """
        comm = self._system.comm
        norms = NO_NORMS
        if step is not None:
            norms = (norm(comm, self._system.state.values().u), norm(comm, step))
        residual_norm = norm(comm, residual.of_u)

        def test() -> int:
            with python_errors():
                return int(
                    snes.callConvergenceTest(snes.getIterationNumber(), *norms, residual_norm)
                )

        return int(comm.allreduce(on_all(test, comm), op=MPI.MIN))

    def has_update(self, snes: PETSc.SNES) -> bool:
        """Return True if a script has set an update on a process. Collective."""
        is_set = snes.getAttr("__update__") is not None
        return bool(self._system.comm.allreduce(is_set, op=MPI.LOR))

    def call_update(self, snes: PETSc.SNES) -> None:
        """Call a script's update at the beginning of a step. Collective.

        It may change coefficients, boundary values, u, or the vector of ``snes.getSolution()``: u
        becomes that vector if it has changed. The caller assembles the residual anew, so that F and
        J are those of one state.
        """
        comm = self._system.comm
        before = snes.getSolution().array_r.copy()

        def update() -> None:
            hook: Any = snes.getAttr("__update__")
            if hook is not None:
                function, arguments, keywords = hook
                function(snes, snes.getIterationNumber(), *arguments, **keywords)

        on_all(update, comm)
        after = snes.getSolution().array_r
        if comm.allreduce(not np.array_equal(before, after), op=MPI.LOR):
            self._move(snes.getSolution())


def _default_test(_snes: PETSc.SNES, _its: int, _norms: tuple[float, float, float]) -> int:
    """Return PETSc's reason to go on: this package judges convergence itself."""
    return int(PETSc.SNES.ConvergedReason.ITERATING)
