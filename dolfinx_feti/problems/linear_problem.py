# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""dolfinx's ``LinearProblem`` with a FETI solver."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Unpack

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.fem.checks import check_scalar_type
from dolfinx_feti.problems.arguments import checked_conditions, require_function
from dolfinx_feti.problems.forms import condensed_fields, linear_forms
from dolfinx_feti.problems.history import NewtonStep, proved_negative
from dolfinx_feti.problems.solvers import create_solver
from dolfinx_feti.problems.torn_problem import Common, TornProblem
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.petsc_errors import python_errors
from dolfinx_feti.runtime.petsc_options import inserted
from dolfinx_feti.scalars.border import ScalarSystem
from dolfinx_feti.scalars.couplings import checked_couplings, refuse_condensed_fields, works
from dolfinx_feti.scalars.equations import Coupling


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
        history: What the last solve cost, one record. Further ones: :class:`TornProblem`.
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
        scalars: Sequence[Coupling] = (),
        **common: Unpack[Common],
    ) -> None:
        """Tear the mesh and compile the forms. Collective; raises on all processes.

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
            scalars: Scalar unknowns beside u with equations that are linear in both
                (:mod:`dolfinx_feti.scalars`).
            **common: ``subdomains``, ``petsc_options_prefix`` and more, see
                :class:`~dolfinx_feti.problems.torn_problem.Common`.

        Raises:
            ValueError: Bad prefix, options, subdomains, boundary conditions or forms.
            TypeError: An unsupported element or scalar type.
        """
        check_scalar_type()
        self._fields = condensed_fields(condense)
        if u is not None:
            require_function(u)
        forms, self._load = linear_forms(a, L, u, self._fields)
        V = forms.u.function_space
        conditions = on_all(lambda: checked_conditions(V, bcs), V.mesh.comm)
        couplings = checked_couplings(scalars, conditions, V)
        refuse_condensed_fields(couplings, self._fields, forms.residuals[1:])
        compilers = form_compiler_options, jit_options
        super().__init__(
            "linear_problem", forms, conditions, [], compilers, petsc_options, **common
        )
        self.u = dolfinx.fem.Function(V) if u is None else u
        self.history: list[NewtonStep] = []
        work, free = sum(works(couplings), ufl.Form([])), ~self._system.dirichlet
        self._system.scalars = ScalarSystem(couplings, self.u, work, self._compiler, free=free)
        self.solver = create_solver(self.A, self._prefix, self._petsc_options)

    @cached_property
    def a(self) -> dolfinx.fem.Form:
        """The compiled bilinear form of u, for other uses; as ``L`` collective the first time."""
        return self._compiler.form(self._forms.J)

    @cached_property
    def L(self) -> dolfinx.fem.Form:
        """The compiled linear form of u."""
        return self._compiler.form(self._load)

    def solve(self) -> dolfinx.fem.Function:
        """Assemble, solve, and return u. Collective.

        Raises:
            ConvergenceError: FETI did not converge; u is left as it was.
        """
        started = time.perf_counter()
        residual = self._assemble()
        self.b.array[:] = -residual.equations
        assembled = time.perf_counter()
        with inserted(self._prefix, self._petsc_options), python_errors():
            self._solve_from_zero(residual.equations)
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

    def _solve_from_zero(self, r: Array) -> None:
        """Solve for u, into x, and for s."""
        scalars = self._system.scalars
        u, s = self.u.x.array.copy(), scalars.values()
        self.u.x.array[:] = 0.0
        scalars.set_values(np.zeros(scalars.size))
        try:
            scalars.check()
            scalars.linearise()
            self.x.array[:] = scalars.solve(self.solver, self.A, r, scalars.residual())
        finally:
            self.u.x.array[:] = u
            scalars.set_values(s)
