# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""dolfinx's ``LinearProblem`` with a FETI solver."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

from petsc4py import PETSc

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.fem.assembly import assemble_owned
from dolfinx_feti.fem.user_forms.checks import check_scalar_type
from dolfinx_feti.problems.arguments import checked_conditions, require_function
from dolfinx_feti.problems.forms import condensed_fields, linear_forms
from dolfinx_feti.problems.history import NewtonStep, proved_negative
from dolfinx_feti.problems.incompressible import check_kappa
from dolfinx_feti.problems.multipliers import update_until_met
from dolfinx_feti.problems.solvers import (
    check_linear_solver,
    create_solver,
    failures_as_reasons,
    warn_of_unread_options,
)
from dolfinx_feti.problems.torn_problem import Balance, ProblemOptions, TornProblem
from dolfinx_feti.problems.unknowns.alternatives import all_forms_in
from dolfinx_feti.problems.unknowns.linear_blocks import LinearBlocks, arrange_linear
from dolfinx_feti.problems.unknowns.mixed_of_one import MixedOfOne, is_mixed_of_one
from dolfinx_feti.problems.volume_multipliers import (
    VolumeMultipliers,
    VolumeUpdates,
    create_volume_multipliers,
)
from dolfinx_feti.runtime.arrays import Array, Integers
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.petsc_errors import python_errors
from dolfinx_feti.runtime.petsc_options import inserted
from dolfinx_feti.scalars.couplings import check_couplings, coupling_works, refuse_condensed_fields
from dolfinx_feti.scalars.equations import Coupling

#: Volume change that multipliers leave by default, as a share of that under the penalty alone. The
#: penalty is 30 times as stiff as the body and changes u by about 1/30. So 1e-6 of its volume
#: change is 3e-8 of u: about the tolerance of the linear solves, 1e-8.
LINEAR_VOLUME_TOLERANCE = 1e-6


class LinearProblem(TornProblem):
    """Solve a(u, v) = L(v) for all v with a FETI method.

    It takes the arguments of dolfinx's class of this name, from 0.9 to 0.11, and those of FETI.

    Example::

        problem = LinearProblem(
            a, L, bcs=bcs, subdomains=4, petsc_options_prefix="tube_",
            petsc_options={"feti_type": "all_floating", "ksp_rtol": 1e-10},
        )
        u = problem.solve()

    Attributes:
        u: The solution, or the list of solutions of a problem in blocks.
        solver: The KSP.
        volume_changes: The largest abs(mean div u) of a cell after each solve with multipliers.
        history: Records of the last :meth:`solve`: one, or one for each update of multipliers.

    Further attributes: :class:`TornProblem`.
    """

    def __init__(
        self,
        a: ufl.Form | Sequence[Sequence[ufl.Form | None]],
        L: ufl.Form | Sequence[ufl.Form],
        bcs: Sequence[dolfinx.fem.DirichletBC] | None = None,
        u: dolfinx.fem.Function | Sequence[dolfinx.fem.Function] | None = None,
        petsc_options: Mapping[str, object] | None = None,
        form_compiler_options: Mapping[str, object] | None = None,
        jit_options: Mapping[str, object] | None = None,
        *,
        condense: dolfinx.fem.Function | Sequence[dolfinx.fem.Function] | None = None,
        scalars: Sequence[Coupling] = (),
        kappa: float | None = None,
        volume_tolerance: float | None = None,
        subdomains: int | Integers | None = None,
        seed: int = 0,
        petsc_options_prefix: str | None = None,
        near_null_space: PETSc.NullSpace | None = None,
        null_space: PETSc.NullSpace | None = None,
        P: ufl.Form | None = None,
        kind: str | None = None,
        entity_maps: Sequence[object] | None = None,
    ) -> None:
        """Tear the mesh and compile the forms. Collective; raises on all processes.

        Args:
            a: Bilinear form with integrals over cells, exterior facets and vertices; or blocks
                [[a_uu, a_up], [a_pu, a_pp]], with None for zero, or a form on a
                ``ufl.MixedFunctionSpace(V, Q)``. One space, in any place, is continuous, and torn.
                Each other one is either a space in which no two cells share a dof, and its field is
                condensed; or a real space, and its unknown is a scalar.
            L: Linear form, or its blocks.
            bcs: Dirichlet conditions on the continuous unknown.
            u: Function for the solution, or a list for that of blocks; created if not given.
            petsc_options: Options without prefix, see ``docs/options.md``.
            form_compiler_options: Options of FFCx.
            jit_options: Options of the C compiler and its cache.
            condense: Functions, or one, for the fields whose dofs no two cells share, such as a
                discontinuous pressure: they are condensed cell by cell.
            scalars: Scalar unknowns in addition to u, with equations that are linear in both
                (:mod:`dolfinx_feti.scalars`).
            kappa: Modulus for condensed fields whose equation contains u but none of the fields,
                p = kappa div u. If given alone, it is that of a penalty; with ``volume_tolerance``,
                that of multipliers. If neither is given, there are multipliers with a modulus from
                a_uu. Several such fields have one modulus.
            volume_tolerance: Bound of div u that multipliers leave, as a share of the div u that
                the penalty leaves.
            subdomains: Number of subdomains over all processes, or the part of each owned cell;
                about one for 2000 dofs if not given.
            seed: Seed of the partitioner: one number gives the same decomposition in every run.
            petsc_options_prefix: Non-empty prefix of all options, equal on all processes; a unique
                one, ``linear_problem_0_``, ``linear_problem_1_`` and so on, if not given.
            near_null_space: Orthonormal vectors that A maps nearly to zero; constants and the
                rotations of the body if not given. May also be attached to ``A``.
            null_space: Orthonormal vectors that A maps to zero. May also be attached to ``A``.
            P: Accepted for compatibility with dolfinx; ignored.
            kind: Accepted for compatibility with dolfinx; ignored.
            entity_maps: Accepted for compatibility with dolfinx; several meshes cannot be torn.

        Raises:
            ValueError: Bad prefix, options, subdomains, boundary conditions or forms.
            TypeError: An unsupported element or scalar type.
        """
        check_scalar_type()
        if u is not None:
            for function in u if isinstance(u, Sequence) else [u]:
                require_function(function)

        # which unknown is torn, which are condensed, and which are scalars
        blocks = arrange_linear(a, L, u, condensed_fields(condense))
        self._fields = blocks.fields
        blocks, mixed = _rewrite_mixed_of_one(blocks)
        self._mixed_solution = None if mixed is None else mixed.solution
        mixed_zero = None if mixed is None else mixed.zero
        if mixed is not None and (scalars or blocks.equations):
            raise ValueError(
                "The unknown has a mixed element of one, which takes no scalars: create its space "
                "with that element alone."
            )
        forms, self._load = linear_forms(blocks.a, blocks.L, blocks.u, self._fields)
        V = forms.u.function_space

        # what acts on them
        conditions = on_all(
            lambda: checked_conditions(V, bcs, fields=self._fields, mixed=mixed_zero), V.mesh.comm
        )
        couplings = [*blocks.equations, *check_couplings(scalars, conditions, V)]
        has_incompressible_field = forms.compression is not None
        check_kappa(kappa, has_incompressible_field=has_incompressible_field)
        if volume_tolerance is not None and not has_incompressible_field:
            raise ValueError(
                f"volume_tolerance is {volume_tolerance}, but no condensed field is without a term "
                "of its own: leave it out, or leave the term −p q/kappa out of a."
            )
        refuse_condensed_fields(couplings, self._fields, forms.residuals[1:])

        # torn matrix and system; its unknowns are zero, the solution is stored in other Functions
        self.unknown = dolfinx.fem.Function(V) if blocks.u is None else blocks.u
        self.u = self._solutions(u, blocks)
        self._work = sum(coupling_works(couplings), ufl.Form([]))
        super().__init__(
            replace(forms, mixed=mixed_zero, scalar_forms=(self.unknown, self._work)),
            conditions,
            name="linear_problem",
            scalars=couplings,
            before_assembly=None,
            options=ProblemOptions(
                form_compiler_options=form_compiler_options,
                jit_options=jit_options,
                petsc_options=petsc_options,
                petsc_options_prefix=petsc_options_prefix,
                subdomains=subdomains,
                seed=seed,
                near_null_space=near_null_space,
                null_space=null_space,
                P=P,
                kind=kind,
                entity_maps=entity_maps,
            ),
        )
        self.history: list[NewtonStep] = []
        self.volume_changes: list[float] = []
        self._volume_multipliers = create_volume_multipliers(
            self._system,
            kappa=kappa,
            volume_tolerance=volume_tolerance,
            default_tolerance=LINEAR_VOLUME_TOLERANCE,
        )
        self.solver = create_solver(self.A, self._prefix, self._petsc_options)

    def _solutions(
        self, u: dolfinx.fem.Function | Sequence[dolfinx.fem.Function] | None, blocks: LinearBlocks
    ) -> dolfinx.fem.Function | Sequence[dolfinx.fem.Function]:
        """Return the Functions that :meth:`solve` returns: the user's, or new ones.

        New ones have the order of the blocks of L.
        """
        if isinstance(u, Sequence):
            return u
        if blocks.unknowns:
            return list(blocks.unknowns)
        return self.unknown if self._mixed_solution is None else self._mixed_solution.w

    @cached_property
    def a(self) -> dolfinx.fem.Form:
        """The compiled bilinear form of u, as in dolfinx; FETI has its own on the torn space.

        Collective the first time.
        """
        return self._compiler.form(self._forms.J)

    @cached_property
    def L(self) -> dolfinx.fem.Form:
        """The compiled linear form of u, as in dolfinx. Collective the first time."""
        return self._compiler.form(self._load)

    @cached_property
    def _residual_at_solution(self) -> ufl.Form:
        """The residual a(u, v) − L(v) at the solution, condensed fields and scalars included."""
        zero_fields = (equation.field for equation in self._forms.field_equations)
        solutions = dict(zip(zero_fields, self._fields, strict=True))
        coupling_and_load = ufl.replace(self._forms.F_u, solutions)  # A_up p − L
        return ufl.action(self._forms.J, self.unknown) + coupling_and_load + self._work

    @cached_property
    def _compiled_residual(self) -> dolfinx.fem.Form:
        """The compiled residual at the solution. Collective the first time."""
        return self._compiler.form(self._residual_at_solution)

    def _balance(self) -> Balance:
        """Return the forces at the solution. Collective."""
        residual = assemble_owned(self._compiled_residual)
        return Balance(residual, self._residual_at_solution, is_deformed=False)

    def _present_x(self) -> Array | float:
        """Return the solution, (owned,): a linear problem is one step from zero."""
        return np.array(self.unknown.x.array[: self._system.owned])

    def solve(self) -> dolfinx.fem.Function | Sequence[dolfinx.fem.Function]:
        """Assemble, solve, and return u; of blocks, the list of solutions. Collective.

        The values of u before do not matter: the system is solved from zero. With scalar unknowns,
        u and the scalars are zero while the KSP runs, for its monitors, too. After a failure all
        have the values from before.

        Raises:
            ConvergenceError: FETI or the multipliers did not converge.
        """
        on_all(lambda: check_linear_solver(self.solver, "problem.solver"), self._system.comm)
        self.history = []
        self.volume_changes = []
        if self._volume_multipliers is None:
            self._solve(assembles_matrix=True)
        else:
            self._solve_with_multipliers(self._volume_multipliers)
        self._warn_if_unloaded()
        return self.u

    def _solve_with_multipliers(self, multipliers: VolumeMultipliers) -> None:
        """Solve and update the multipliers in turn. Collective.

        The fields of the system are zero during each solve. Between solves they hold the solution,
        from which the multipliers are computed.

        Raises:
            ConvergenceError: FETI or the multipliers did not converge.
        """
        system = self._system
        fields = system.condensation
        if fields is None:
            raise RuntimeError("A problem without condensed fields has no multipliers.")
        zero = system.state.values().p
        multipliers.set(zero)

        def solve_once(n_updates: int) -> bool:
            fields.set_values(zero)
            self._solve(assembles_matrix=n_updates == 0)
            fields.set_values(np.concatenate([field.x.array for field in self._fields]))
            return True

        updates = VolumeUpdates(multipliers, multipliers.tolerance, is_relative=True)
        self.volume_changes = updates.violations
        try:
            update_until_met([updates], solve_once)
        finally:
            fields.set_values(zero)

    def _solve(self, *, assembles_matrix: bool) -> None:
        """Solve once, and store the solution; append a record, even if the solve fails.

        Args:
            assembles_matrix: Whether to assemble the matrix; if not, the last one is used.

        Raises:
            ConvergenceError: FETI did not converge; u is left as it was.
        """
        started = time.perf_counter()
        if assembles_matrix:
            residual = self._assemble_system()
        else:
            residual = self._system.residual()
        self.b.array[:] = -residual.of_u
        assembled = time.perf_counter()
        with (
            inserted(self._prefix, self._petsc_options),
            failures_as_reasons(self.solver),
            python_errors(self.solver),
        ):
            ds = self._solve_from_zero(residual.of_u)
            warn_of_unread_options(self.solver, self._prefix, self._petsc_options)
        solved = time.perf_counter()
        feti = self.solver.getPythonContext()
        self.history.append(
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
        )
        if self.solver.getConvergedReason() < 0:
            raise ConvergenceError(f"FETI did not converge: {feti.message}")
        solution = self._system.increment(residual, self.x.array_r, ds)  # from zero
        self._system.scalars.set_values(solution.s)
        self.unknown.x.array[: self.x.getLocalSize()] = self.x.array_r
        self.unknown.x.scatter_forward()
        if self._mixed_solution is not None:
            self._mixed_solution.write()
        begin = 0
        for field in self._fields:
            end = begin + len(field.x.array)
            field.x.array[:] = solution.p[begin:end]
            field.x.scatter_forward()
            begin = end

    def _solve_from_zero(self, r: Array) -> Array:
        """Solve A u + B s = −r and the equations of s, with u stored in ``x``. Collective.

        The equations of scalars are linearised at u = 0, s = 0. They are written in the Functions
        of the solution (``Forms.scalar_forms``). If there are any, these Functions are therefore
        zero during the solve, and get their values back afterwards.

        Args:
            r: Residual at zero, with −g on Dirichlet dofs, (owned,).

        Returns:
            s, (m,).
        """
        scalars = self._system.scalars
        if scalars.size == 0:
            self.x.array[:], ds = scalars.solve(self.solver, self.A, r, np.zeros(0))
            return ds
        u = self.unknown.x.array.copy()
        s = scalars.values()
        self.unknown.x.array[:] = 0.0
        scalars.set_values(np.zeros(scalars.size))
        try:
            scalars.check()
            scalars.linearise()
            self.x.array[:], ds = scalars.solve(self.solver, self.A, r, scalars.residual())
        finally:
            self.unknown.x.array[:] = u
            scalars.set_values(s)
        return ds


class MixedUnknowns(NamedTuple):
    """The unknowns of a linear problem on a mixed element with one part."""

    solution: MixedOfOne  # whose part receives the solution
    zero: MixedOfOne  # whose part the system is assembled at; conditions are on its mixed space


def _rewrite_mixed_of_one(blocks: LinearBlocks) -> tuple[LinearBlocks, MixedUnknowns | None]:
    """Rewrite a problem on a mixed element with one part as one on that part. Collective.

    Returns:
        The problem and its mixed unknowns; for another element the problem as it is, and None.
    """
    u = blocks.u
    if u is None:
        form = next(all_forms_in([blocks.a, blocks.L]), None)
        if form is None or not form.arguments():
            return blocks, None
        W = form.arguments()[0].ufl_function_space()
        if not is_mixed_of_one(W):
            return blocks, None
        u = dolfinx.fem.Function(W)
    if not is_mixed_of_one(u.function_space):
        return blocks, None
    solution = MixedOfOne(u)
    zero = MixedOfOne(dolfinx.fem.Function(u.function_space))
    a = solution.rewrite(blocks.a)
    L = solution.rewrite(blocks.L)
    return replace(blocks, a=a, L=L, u=solution.u), MixedUnknowns(solution, zero)
