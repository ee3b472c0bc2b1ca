# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""dolfinx's ``LinearProblem`` with a FETI solver."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import cached_property

from petsc4py import PETSc

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.fem.checks import check_scalar_type
from dolfinx_feti.problems.arguments import checked_conditions, require_function
from dolfinx_feti.problems.forms import condensed_fields, linear_forms
from dolfinx_feti.problems.history import NewtonStep, proved_negative
from dolfinx_feti.problems.solvers import create_solver
from dolfinx_feti.problems.system import Residual
from dolfinx_feti.problems.torn_problem import TornProblem
from dolfinx_feti.runtime.arrays import Array, Integers
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.petsc_errors import python_errors
from dolfinx_feti.runtime.petsc_options import inserted
from dolfinx_feti.scalars.border import ScalarSystem
from dolfinx_feti.scalars.couplings import checked_couplings, refuse_condensed_fields, works
from dolfinx_feti.scalars.equations import Coupling

__all__ = ["LinearProblem"]


class LinearProblem(TornProblem):
    """Solve a(u, v) = L(v) for all v with a FETI method.

    It takes the arguments of dolfinx's class of this name, from 0.9 to 0.11, and the subdomains.

    Example::

        problem = dolfinx_feti.LinearProblem(
            a, L, bcs=[bc], subdomains=64, petsc_options_prefix="cube_",
            petsc_options={"feti_type": "all_floating", "feti_pc_type": "dirichlet"},
        )
        u = problem.solve()

    Attributes:
        u: The solution.
        solver: The KSP.
        A: The torn matrix; ``A.mult`` is the assembled operator.
        b: The assembled right-hand side.
        x: The last solution, without ghosts; u has memory of its own.
        decomposition: Subdomain of each owned cell.
        history: What the last solve cost, one record.
    """

    def __init__(
        self,
        a: ufl.Form | Sequence[Sequence[ufl.Form | None]],
        L: ufl.Form | Sequence[ufl.Form],
        bcs: Sequence[dolfinx.fem.DirichletBC] | None = None,
        u: dolfinx.fem.Function | None = None,
        petsc_options: Mapping[str, object] | None = None,
        form_compiler_options: Mapping[str, object] | None = None,
        jit_options: Mapping[str, object] | None = None,
        *,
        condense: dolfinx.fem.Function | Sequence[dolfinx.fem.Function] | None = None,
        near_null_space: PETSc.NullSpace | None = None,
        null_space: PETSc.NullSpace | None = None,
        subdomains: int | Integers | None = None,
        seed: int = 0,
        petsc_options_prefix: str | None = None,
        scalars: Sequence[Coupling] = (),
        P: ufl.Form | None = None,
        kind: str | None = None,
        entity_maps: Sequence[object] | None = None,
    ) -> None:
        """Tear the mesh and compile the forms.

        Args:
            a: Bilinear form with integrals over cells, exterior facets and vertices; with
                ``condense``, its blocks [[a_uu, a_up], [a_pu, a_pp]], or one form on a
                ``ufl.MixedFunctionSpace(V, Q)``.
            L: Linear form; with ``condense`` its blocks.
            bcs: Dirichlet conditions.
            u: Function for the solution; created if not given.
            petsc_options: Options without prefix, see ``docs/options.md``.
            form_compiler_options: Options of FFCx.
            jit_options: Options of the C compiler and its cache.
            condense: Functions, or one, for the fields beside u whose dofs no two cells share, such
                as a discontinuous pressure: they are eliminated cell by cell.
            near_null_space: What A nearly maps to zero, orthonormal; constants and rotations if not
                given. As null_space, it may also be attached to ``A``.
            null_space: What A maps to zero, orthonormal.
            subdomains: Their number over all processes, or a part per owned cell; about one for
                2000 dofs if not given.
            seed: Another number for another decomposition into as many subdomains; that of one
                number is the same in every run.
            petsc_options_prefix: Non-empty prefix of all options, equal on all processes; one of
                its own, ``linear_problem_0_`` and so on, if not given.
            scalars: Scalar unknowns beside u with equations that are linear in both
                (:mod:`dolfinx_feti.scalars`).
            P: Without effect, as a preconditioner of dolfinx's.
            kind: Without effect, as a type of dolfinx's matrices.
            entity_maps: None; several meshes cannot be torn.

        Raises:
            ValueError: Bad prefix, options, subdomains, boundary conditions or forms.
            TypeError: An unsupported element or scalar type.

        Note:
            Collective; raises on all processes.
        """
        check_scalar_type()
        fields = condensed_fields(condense)
        if u is not None:
            require_function(u)
        self._fields = fields
        forms, self._load = linear_forms(a, L, u, fields)
        self._bilinear, V = forms.J, forms.u.function_space
        conditions = on_all(lambda: checked_conditions(V, bcs), V.mesh.comm)
        couplings = checked_couplings(scalars, conditions, V)
        refuse_condensed_fields(couplings, fields, forms.residuals[1:])
        super().__init__(
            "linear_problem",
            forms,
            conditions,
            compilers=(form_compiler_options, jit_options),
            prefix=petsc_options_prefix,
            petsc_options=petsc_options,
            subdomains=subdomains,
            seed=seed,
            near_null_space=near_null_space,
            null_space=null_space,
            unused={"P": P, "kind": kind, "entity_maps": entity_maps},
            least=1 if conditions else 2,  # a null space is one of several subdomains together
        )
        self.u = dolfinx.fem.Function(V) if u is None else u
        self.history: list[NewtonStep] = []
        work = sum(works(couplings), ufl.Form([]))
        self._system.scalars = ScalarSystem(
            couplings, self.u, work, self._compiler, free=~self._system.dirichlet
        )
        self.solver = create_solver(self.A, self._prefix, self._petsc_options)

    @cached_property
    def a(self) -> dolfinx.fem.Form:
        """The compiled bilinear form of u, for other uses; as ``L`` collective the first time."""
        return self._compiler.form(self._bilinear)

    @cached_property
    def L(self) -> dolfinx.fem.Form:
        """The compiled linear form of u."""
        return self._compiler.form(self._load)

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
        residual = self._assemble()
        assembled = time.perf_counter()
        with inserted(self._prefix, self._petsc_options), python_errors():
            if not self._system.scalars.size:
                self.solver.solve(self.b, self.x)
            else:
                self._solve_with_scalars(self._system.scalars)
        solved = time.perf_counter()
        feti = self.solver.getPythonContext()
        self.history = [
            NewtonStep.after(
                feti,
                [feti.iterations],
                residual=self.b.norm(),
                step_length=1.0,
                indefinite=proved_negative(feti),
                shift=0.0,
                seconds_assembly=assembled - started,
                seconds_linear=solved - assembled,
            )
        ]
        if self.solver.getConvergedReason() < 0:
            raise ConvergenceError(f"FETI did not converge: {feti.message}")
        _, p, s = self._system.increment(residual, self.x.array_r)
        self._system.scalars.set_values(s)
        self.u.x.array[: self.x.getLocalSize()] = self.x.array_r
        self.u.x.scatter_forward()
        for field in self._fields:
            field.x.array[:], p = np.split(p, [len(field.x.array)])
            field.x.scatter_forward()
        return self.u

    def _solve_with_scalars(self, scalars: ScalarSystem) -> None:
        """Solve for u and s, from zero: their equations are linear."""
        u, s = self.u.x.array.copy(), scalars.values()
        self.u.x.array[:] = 0.0
        scalars.set_values(np.zeros(scalars.size))
        try:
            scalars.check()
            scalars.linearise()
            c = scalars.residual()
            self.x.array[:] = scalars.solve(self.solver, self.A, -self.b.array_r, c)
        finally:
            self.u.x.array[:] = u
            scalars.set_values(s)

    def linear_system(self) -> tuple[PETSc.Mat, PETSc.Vec]:
        """Assemble A, the problem's own, and a b that the caller destroys. Collective."""
        self._assemble()
        return self.A, self.b.copy()

    def _approximation(self) -> Array:
        """Return the last solution, (owned,)."""
        return np.asarray(self.u.x.array[: self.b.getLocalSize()])

    def _assemble(self) -> Residual:
        """Assemble A, its near kernel, and b, and return the residual at zero."""
        residual = self._system.residual()
        self._system.linearise(residual)
        load = -residual.condensed
        for bc in self.bcs:
            bc.set(load)
        self.b.array[:] = load
        return residual
