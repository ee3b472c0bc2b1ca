# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""dolfinx's ``NonlinearProblem`` with Newton's method on torn tangents and a FETI solver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Unpack

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.fem.checks import check_scalar_type
from dolfinx_feti.fem.content import content_of
from dolfinx_feti.fem.internal_variables import create_internal_variables
from dolfinx_feti.problems.arguments import checked_conditions, require_function
from dolfinx_feti.problems.forms import condensed_fields, default_volume_ratio, derive
from dolfinx_feti.problems.history import NewtonStep
from dolfinx_feti.problems.multipliers import hold, prepare, updated
from dolfinx_feti.problems.newton import Newton, Start
from dolfinx_feti.problems.solvers import create_newton_solver
from dolfinx_feti.problems.system import Residual, Tangent
from dolfinx_feti.problems.torn_problem import Common, TornProblem
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.petsc_errors import python_errors
from dolfinx_feti.runtime.petsc_options import inserted
from dolfinx_feti.scalars import couplings as coupled
from dolfinx_feti.scalars.equations import Coupling, separated


class NonlinearProblem(TornProblem):
    """Solve F(u; v) = 0 for all v by Newton's method, every step with a FETI method.

    It takes the arguments of dolfinx's class of this name, from 0.9 to 0.11, and the subdomains; it
    drives a SNES of its own in every version.

    Example::

        problem = dolfinx_feti.NonlinearProblem(
            [F_u, F_p], u, bcs=bcs, condense=p, subdomains=64, petsc_options_prefix="artery_",
            petsc_options={"feti_type": "all_floating", "snes_monitor": None},
        )
        problem.solve()

    Attributes:
        u: The unknown.
        solver: The SNES.
        content: Unknowns, and the Functions and Constants in the forms.
        volume_changes: The greatest abs(mean J − 1) of a cell after each Newton solve of the last
            :meth:`solve` with a ``volume_tolerance``. Further ones: :class:`TornProblem`.
    """

    def __init__(
        self,
        F: ufl.Form | Sequence[ufl.Form],
        u: dolfinx.fem.Function | Sequence[dolfinx.fem.Function],
        bcs: Sequence[dolfinx.fem.DirichletBC] | None = None,
        J: ufl.Form | None = None,
        form_compiler_options: Mapping[str, object] | None = None,
        jit_options: Mapping[str, object] | None = None,
        *,
        condense: dolfinx.fem.Function | Sequence[dolfinx.fem.Function] | None = None,
        energy: ufl.Form | None = None,
        volume_tolerance: float | None = None,
        internal_variables: Mapping[dolfinx.fem.Function, Expr] | None = None,
        petsc_options: Mapping[str, object] | None = None,
        quadrature_degree: int | None = None,
        volume_ratio: Expr | None = None,
        scalars: Sequence[Coupling] = (),
        **common: Unpack[Common],
    ) -> None:
        """Tear the mesh, derive and compile the forms. Collective; raises on all processes.

        Args:
            F: Residual, or residuals [F_u, F_s] of u and of scalars; or an energy, whose
                derivatives are taken; with ``condense``, an energy Π(u, p) or the residuals (tested
                with v, and with the q of each condensed field).
            u: Unknown; holds the start and then the solution. Or [u, s], s on real spaces.
            bcs: Dirichlet conditions on u.
            J: Tangent of the residual tested with v, in u; derived from it if not given. A
                symmetric one lets FETI use conjugate gradients.
            form_compiler_options: Options of FFCx.
            jit_options: Options of the C compiler and its cache.
            condense: Scalar field, or several, whose dofs no two cells share, such as a
                discontinuous pressure: eliminated cell by cell, and updated with u.
            energy: Potential Π(u) or Π(u, p) whose derivatives are the residuals F, if they have
                one: F itself if that is an energy. It keeps Newton's method on the way down.
            volume_tolerance: Most that abs(J − 1) may be in the mean of each cell: multipliers then
                take the place of an ever larger κ, see :meth:`solve`.
            internal_variables: What the material remembers: Functions of quadrature points or of
                cells (DG), each with its update in UFL, see :meth:`update_internal_variables`.
            petsc_options: Options without prefix: ``snes_…``, ``feti_…``, see ``docs/options.md``.
            quadrature_degree: Highest degree of the integrals that state none; UFL's estimates, as
                in dolfinx, if not given.
            volume_ratio: Expression that every iterate keeps positive at all points of a quadrature
                of this degree, or of twice that of u. If not given, det(I + Grad u) where the forms
                contain I + Grad u, Grad uᵀ Grad u, or a determinant or inverse in Grad u.
            scalars: Scalar unknowns beside u with their equations, such as cavities whose volume is
                prescribed (:mod:`dolfinx_feti.scalars`). Those on real spaces belong to u and F.
            **common: ``subdomains``, ``petsc_options_prefix`` and more, see
                :class:`~dolfinx_feti.problems.torn_problem.Common`.

        Raises:
            ValueError: Bad prefix, options, subdomains, boundary conditions or forms.
            TypeError: An unsupported element or scalar type.
        """
        check_scalar_type()
        self._given = u
        F, u, blocks = separated(F, u)
        require_function(u)
        assert isinstance(u, dolfinx.fem.Function)
        V = u.function_space
        conditions = on_all(lambda: checked_conditions(V, bcs), V.mesh.comm)
        fields = condensed_fields(condense)
        couplings = [*blocks, *coupled.checked_couplings(scalars, conditions, V)]
        degree, work = quadrature_degree, coupled.works(couplings)
        forms = derive(F, u, J=J, condense=fields, energy=energy, degree=degree, work=work)
        coupled.refuse_condensed_fields(couplings, fields, forms.residuals[1:])
        torn = replace(
            forms,
            energy=None if couplings else forms.energy,
            volume_ratio=default_volume_ratio(forms) if volume_ratio is None else volume_ratio,
            degree=2 * V.ufl_element().embedded_superdegree if degree is None else degree,
        )
        compilers = form_compiler_options, jit_options
        super().__init__(
            "nonlinear_problem", torn, conditions, couplings, compilers, petsc_options, **common
        )
        self.u, system = u, self._system
        if volume_tolerance is not None:
            prepare(system, volume_tolerance)
        self._volume_tolerance = volume_tolerance
        equations = (c for coupling in couplings for c in coupling.equation.equations)
        parts = (*forms.residuals, forms.energy, *equations)
        self.content = content_of((u, *fields), parts)
        self._memory = create_internal_variables(
            internal_variables or {}, self._compiler, coefficients=self.content.coefficients
        )
        self._history: list[NewtonStep] = []
        self.volume_changes: list[float] = []
        self._newton = Newton(system, self._known_advice)
        self.solver = create_newton_solver(self._newton, self.A, self._prefix, self._petsc_options)

    @cached_property
    def F(self) -> dolfinx.fem.Form:
        """The compiled residual, without condensation; as ``J`` collective the first time."""
        return self._compiler.form(self._forms.F_u)

    @cached_property
    def J(self) -> dolfinx.fem.Form:
        """The compiled tangent, for other uses: FETI has one on the torn space. Collective."""
        return self._compiler.form(self._forms.J)

    def __getattr__(self, name: str) -> object:
        """Answer a script that hands the problem to dolfinx's ``NewtonSolver``."""
        message = f"'{type(self).__name__}' object has no attribute '{name}'"
        if name not in ("L", "a", "form"):
            raise AttributeError(message)
        message += "; it drives Newton's method itself: call problem.solve() in the place of "
        message += "dolfinx.nls.petsc.NewtonSolver"
        raise AttributeError(message, name=name, obj=None)  # else Python asks whether 'A' was meant

    @property
    def history(self) -> list[NewtonStep]:
        """What each Newton step of the last solve cost, those after multipliers included."""
        return self._history + self._newton.history

    def residual_norm(self) -> float:
        """Return ‖r‖ of the present state under the present load. Collective."""
        self._hold()
        return self._system.norm(self._system.residual().condensed)

    def linearise(self) -> Tangent:
        """Assemble the tangent at the present state and load, for the first step. Collective.

        Call it in an equilibrium, *before* the load grows, and give it to :meth:`solve`: the first
        step is then a prediction along the path. A tangent with the new load and the old stress can
        be indefinite although every state on the way is stable. It returns a name of the tangent,
        which the matrix holds until the next step is assembled.
        """
        return self._system.linearise()

    def _assemble(self) -> Residual:
        self._hold()
        return super()._assemble()

    def solve(
        self,
        *,
        reference: float | None = None,
        first_tangent: Tangent | None = None,
        renew: bool = True,
        give_up_early: bool = False,
    ) -> dolfinx.fem.Function | Sequence[dolfinx.fem.Function]:
        """Iterate from the present u (and pressure) to the solution, as u was given. Collective.

        With a ``volume_tolerance`` the material is incompressible in the end: after each Newton
        solve the pressure becomes the multiplier (docs/theory.md, *Multipliers*). A solve begins
        with λ = p: a state that is restored or read brings its multipliers along.

        Args:
            reference: A residual norm that the relative tolerance refers to if that of the start is
                larger, such as :meth:`residual_norm` of the last equilibrium under the new load
                where a guess begins with a far larger one. One that is NaN does not count.
            first_tangent: The tangent of the first step, made by :meth:`linearise`; that of the
                present state if not given.
            renew: Whether FETI's preconditioner and its Ritz vectors begin anew. If not, those of
                the last solve serve on as long as ``-feti_lag`` lets them: faster where the state
                has not changed much, and u depends on earlier solves, within the tolerance.
            give_up_early: Whether to end at once where step lengths stay below 0.1, or where the
                tangent of a bad guess is indefinite: a shorter increment is cheaper then.

        Raises:
            ConvergenceError: Newton's method or FETI failed; u holds the last good iterate.
            ValueError: ``reference`` is negative, or the matrix no longer holds ``first_tangent``.
        """
        system = self._system
        if reference is not None and reference < 0.0:
            raise ValueError(f"reference is {reference}: give the norm of a residual.")
        if system.comm.allreduce(first_tangent not in (None, system.tangent), op=MPI.LOR):
            raise ValueError(
                "first_tangent names a tangent that this problem's matrix does not hold any more: "
                "pass what linearise() has returned to the very next solve()."
            )
        most = np.inf if reference is None else float(reference)
        start = Start(reference=most, tangent=first_tangent, early=give_up_early)
        system.scalars.check()
        if renew:
            self.renew()
        self._history, self.volume_changes = [], []
        if self._volume_tolerance is None:
            self._run(start)
        else:
            self._run_with_multipliers(start, self._volume_tolerance)
        return self._given

    def _run(self, start: Start) -> None:
        """Iterate by Newton's method, or raise ConvergenceError."""
        self._newton.start = start
        try:
            with inserted(self._prefix, self._petsc_options), python_errors():
                self.solver.solve(None, self.x)
        except BaseException:  # of a monitor, during which PETSc locks x
            locked, self.x = self.x, self.x.duplicate()
            locked.destroy()
            raise
        self.b.array[:] = self._newton.residual
        if self.solver.getConvergedReason() < 0:
            message = self._newton.message.rstrip(".")
            raise ConvergenceError(f"Newton's method did not converge: {message}.")

    def _run_with_multipliers(self, start: Start, tolerance: float) -> None:
        """Iterate by Newton's method and update the multipliers, in turn, up to a tolerance."""
        reference = min(self.residual_norm(), start.reference)  # λ = p
        rtol, *_ = self.solver.getTolerances()

        def solve(update: int) -> bool:
            if update:
                self._history += self._newton.history
            self._run(replace(Start() if update else start, reference=reference, rough=True))
            return self._newton.at_end

        for change in updated(self._system, solve, max(tolerance, rtol)):
            self.volume_changes.append(change)

    def _hold(self) -> None:
        """Let the present pressure be the multiplier, if there are multipliers."""
        if self._volume_tolerance is not None:
            hold(self._system)

    @property
    def internal_variables(self) -> tuple[dolfinx.fem.Function, ...]:
        """The Functions that hold what the material remembers, and scalars of a path."""
        return (*self._memory.functions, *self._system.scalars.histories)

    def update_internal_variables(self, *, balanced: bool | None = None) -> None:
        """Let each internal variable be its update at the present state, all at once. Collective.

        Call it when a state is accepted, as ``follow_load`` and ``follow_time`` do: a solve changes
        none of them. With ``balanced`` only those that the balance of forces depends on, or not.
        """
        self._memory.update(balanced=balanced)
        if balanced is not False:
            self._system.scalars.accept()

    def begin_step(self, length: float) -> None:
        """Tell the scalars, such as a Windkessel, the length of the next step of load or time."""
        self._system.scalars.begin(length)

    def renew(self) -> None:
        """Let the next solve begin with a preconditioner of its own, and no Ritz vectors."""
        self.solver.getKSP().getPythonContext().renew()
