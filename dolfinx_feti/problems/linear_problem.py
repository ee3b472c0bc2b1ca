# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""dolfinx's ``LinearProblem`` with a FETI solver."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.fem import assembly
from dolfinx_feti.fem.checks import check_bcs, check_linear_forms, check_scalar_type, check_space
from dolfinx_feti.fem.decomposition import decompose, tear
from dolfinx_feti.petsc_options import inserted, require_prefix
from dolfinx_feti.problems.history import NewtonStep, proved_negative, record_step
from dolfinx_feti.problems.solvers import create_solver, python_errors

__all__ = ["LinearProblem"]


class LinearProblem:
    """Solve a(u, v) = L(v) for all v with a FETI method.

    Example::

        problem = dolfinx_feti.LinearProblem(
            a, L, bcs=[bc], subdomains=64, petsc_options_prefix="cube_",
            petsc_options={"feti_type": "all_floating", "feti_pc_type": "dirichlet"},
        )
        u = problem.solve()

    Attributes:
        u: The solution.
        solver: The KSP.
        A: The torn matrix.
        b: The assembled right-hand side.
        decomposition: Subdomain of each owned cell.
        history: What the last solve cost, one record.
    """

    def __init__(
        self,
        a: ufl.Form,
        L: ufl.Form,
        *,
        bcs: Sequence[dolfinx.fem.DirichletBC] = (),
        u: dolfinx.fem.Function | None = None,
        subdomains: int | npt.NDArray[np.integer],
        petsc_options_prefix: str,
        petsc_options: Mapping[str, object] | None = None,
    ) -> None:
        """Tear the mesh and compile the forms.

        Args:
            a: Bilinear form with cell and exterior-facet integrals.
            L: Linear form.
            bcs: Dirichlet conditions.
            u: Function for the solution; created if not given.
            subdomains: Their number over all processes, or a part per owned cell.
            petsc_options_prefix: Non-empty prefix of all options, equal on all processes.
            petsc_options: Options without prefix, see ``docs/options.md``.

        Raises:
            ValueError: Bad prefix, options, subdomains, boundary conditions or forms.
            TypeError: An unsupported element or scalar type.

        Note:
            Collective; raises on all processes.
        """
        check_scalar_type()
        self._prefix = require_prefix(petsc_options_prefix)
        self._petsc_options = dict(petsc_options or {})
        check_linear_forms(a, L, u)
        V = a.arguments()[0].ufl_function_space()
        check_space(V)
        check_bcs(V, bcs)
        self.u = dolfinx.fem.Function(V) if u is None else u
        self._bcs = list(bcs)
        self.decomposition = decompose(V.mesh, subdomains)
        space = tear(V, self.decomposition)
        self._a = assembly.torn_form(a, (space, space))
        self._L = dolfinx.fem.form(L)
        self._K = assembly.create_local_matrix(space, space, len(self.decomposition.subdomain))
        self.A = assembly.create_matis(space, self._K, self._bcs)
        self.b = self.A.createVecLeft()
        self.history: list[NewtonStep] = []
        self.solver = create_solver(self.A, self._prefix, self._petsc_options)

    def solve(self) -> dolfinx.fem.Function:
        """Assemble and solve.

        Returns:
            The solution u.

        Raises:
            ConvergenceError: FETI did not converge; u is left as it was.

        Note:
            Collective.
        """
        started = time.perf_counter()
        assembly.assemble(self._K, self._a)
        assembly.attach_near_kernel(self.A, self.u.function_space)
        load = assembly.assemble_owned(self._L)
        for bc in self._bcs:
            bc.set(load)
        self.b.array[:] = load
        x = self.A.createVecRight()
        assembled = time.perf_counter()
        with inserted(self._prefix, self._petsc_options), python_errors():
            self.solver.solve(self.b, x)
        solved = time.perf_counter()
        feti = self.solver.getPythonContext()
        self.history = [
            record_step(
                feti,
                residual=self.b.norm(),
                step_length=1.0,
                indefinite=proved_negative(feti),
                shift=0.0,
                iterations=[feti.iterations],
                assembly=assembled - started,
                linear=solved - assembled,
            )
        ]
        raise_if_diverged(self.solver)
        n = x.getLocalSize()
        self.u.x.array[:n] = x.array_r
        self.u.x.scatter_forward()
        x.destroy()
        return self.u

    def __del__(self) -> None:
        """Free the PETSc objects."""
        for name in ("solver", "A", "b", "_K"):
            owned = getattr(self, name, None)  # __init__ may have raised
            if owned is not None:
                owned.destroy()


def raise_if_diverged(ksp: PETSc.KSP) -> None:
    """Raise if a FETI solver did not converge.

    Raises:
        ConvergenceError: With the solver's message.
    """
    if ksp.getConvergedReason() < 0:
        raise ConvergenceError(f"FETI did not converge: {ksp.getPythonContext().message}")
