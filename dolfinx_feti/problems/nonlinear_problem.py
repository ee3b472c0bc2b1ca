# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""dolfinx's ``NonlinearProblem`` with Newton's method on torn tangents and a FETI solver."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.contact.contact import Contact
from dolfinx_feti.diagnosis.advice import Advice
from dolfinx_feti.diagnosis.cell_check import CellCheck
from dolfinx_feti.diagnosis.cell_volumes import CellVolumes
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.internal_variables import Updated, create_internal_variables
from dolfinx_feti.fem.user_forms.checks import check_scalar_type
from dolfinx_feti.fem.user_forms.deformation import volume_ratio_of_expression
from dolfinx_feti.fem.user_forms.forgotten_pressures import check_pressures
from dolfinx_feti.fem.user_forms.form_content import content_of
from dolfinx_feti.problems.arguments import (
    checked_conditions,
    require_callable,
    require_function,
    require_torn_space,
)
from dolfinx_feti.problems.boundary import add_boundary
from dolfinx_feti.problems.contacts import Contacts, ContactUpdates, checked_contacts
from dolfinx_feti.problems.equations.system import Residual
from dolfinx_feti.problems.equations.tangent import TangentId
from dolfinx_feti.problems.forms import Forms, condensed_fields, derive, volume_ratio_of
from dolfinx_feti.problems.history import NewtonStep
from dolfinx_feti.problems.incompressible import check_kappa
from dolfinx_feti.problems.iteration.iterate import Start
from dolfinx_feti.problems.multipliers import MultiplierUpdates, update_until_met
from dolfinx_feti.problems.newton import Newton
from dolfinx_feti.problems.solvers import (
    check_newton_solver,
    create_newton_solver,
    failures_as_reasons,
    relative_tolerance,
    warn_of_unread_options,
)
from dolfinx_feti.problems.torn_problem import Balance, ProblemOptions, TornProblem
from dolfinx_feti.problems.unknowns.mixed_of_one import MixedOfOne, is_mixed_of_one
from dolfinx_feti.problems.unknowns.nonlinear_blocks import NonlinearBlocks, arrange_nonlinear
from dolfinx_feti.problems.volume_multipliers import (
    VOLUME_TOLERANCE,
    VolumeUpdates,
    create_volume_multipliers,
)
from dolfinx_feti.runtime.arrays import Integers
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.norms import norm
from dolfinx_feti.runtime.petsc_errors import python_errors
from dolfinx_feti.runtime.petsc_options import inserted
from dolfinx_feti.scalars.couplings import check_couplings, coupling_works, refuse_condensed_fields
from dolfinx_feti.scalars.equations import Coupling
from dolfinx_feti.wall.conditions.boundary import Boundary


class NonlinearProblem(TornProblem):
    """Solve F(u; v) = 0 for all v by Newton's method, every step with a FETI method.

    It takes the arguments of dolfinx's class of this name, from 0.9 to 0.11, and those of FETI. It
    drives its own SNES with every version.

    Example::

        p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
        psi += materials.perturbed_lagrangian(J, p, kappa=1e5)
        problem = NonlinearProblem(
            psi * ufl.dx + pressure * ufl.inner(N, u) * ds(lumen), u, bcs=bcs, condense=p,
            subdomains=4, petsc_options_prefix="artery_", petsc_options={"snes_rtol": 1e-10},
        )
        pressure.value = 0.2  # kPa
        problem.solve()

    Attributes:
        u: The unknown, or the list of unknowns of a problem in blocks.
        solver: The SNES.
        content: Unknowns, and the Functions and Constants in the forms, which paths store.
        volume_changes: The largest abs(mean J − 1) of a cell after each Newton solve of the last
            :meth:`solve` with a ``volume_tolerance``.
        contact_violations: The largest violation of the contact conditions after each Newton solve
            of the last :meth:`solve` with contact, relative to the size of a cell. A violation is a
            penetration, or a gap at which a multiplier still pushes.

    Further attributes: :class:`TornProblem`.
    """

    def __init__(
        self,
        F: ufl.Form | Sequence[ufl.Form],
        u: dolfinx.fem.Function | Sequence[dolfinx.fem.Function],
        bcs: Sequence[dolfinx.fem.DirichletBC] | None = None,
        J: ufl.Form | Sequence[Sequence[ufl.Form | None]] | None = None,
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
        kappa: float | None = None,
        before_assembly: Callable[[Any], object] | None = None,
        contacts: Sequence[Contact] = (),
        contact_tolerance: float = 1e-3,
        boundary: Boundary | None = None,
        subdomains: int | Integers | None = None,
        seed: int = 0,
        petsc_options_prefix: str | None = None,
        near_null_space: PETSc.NullSpace | None = None,
        null_space: PETSc.NullSpace | None = None,
        P: ufl.Form | None = None,
        kind: str | None = None,
        entity_maps: Sequence[object] | None = None,
    ) -> None:
        """Tear the mesh, derive and compile the forms. Collective; raises on all processes.

        Args:
            F: Residual; or residuals of several unknowns, in the order of ``u`` followed by that of
                ``condense``; or an energy, whose derivatives are taken.
            u: Unknown, which holds the start and then the solution. Or several in any order: one on
                a continuous space; fields whose dofs no two cells share, such as discontinuous
                pressures, which are condensed; and scalars on real spaces.
            bcs: Dirichlet conditions on the continuous unknown.
            J: Tangent of the residual in u, or in blocks, with None for zero, in the order of F
                (with those of ``condense`` last); derived from F if not given. A symmetric one lets
                FETI use conjugate gradients.
            form_compiler_options: Options of FFCx.
            jit_options: Options of the C compiler and its cache.
            condense: Field, or several, whose dofs no two cells share, such as a discontinuous
                pressure: they are condensed cell by cell, and updated with u.
            energy: Potential Π(u) or Π(u, p) whose derivatives are the residuals F, if there is
                one; F itself if that is an energy. Used by the line search to ensure descent.
            volume_tolerance: Bound of abs(J − 1) in the mean of each cell. Multipliers enforce it
                with a moderate κ, see :meth:`solve`.
            internal_variables: State variables of the material: Functions of quadrature points or
                of cells (DG), each with its update in UFL, see :meth:`update_internal_variables`.
            petsc_options: Options without prefix: ``snes_…``, ``feti_…``, see ``docs/options.md``.
            quadrature_degree: Highest degree of integrals whose measure states none; UFL's
                estimates, as in dolfinx, if not given.
            volume_ratio: Expression that every iterate keeps positive, at all points of a
                quadrature of the degree ``quadrature_degree``, or twice the degree of u if that is
                not given. If the expression is not given, it is det F of the deformation gradient
                in the forms, such as I + Grad u, or I + Δt Grad v of a velocity. If the forms
                contain no such F, nothing is kept positive.
            scalars: Scalar unknowns in addition to u, with their equations, such as cavities whose
                volume is prescribed (:mod:`dolfinx_feti.scalars`). Those on real spaces belong to u
                and F.
            kappa: Modulus for condensed fields whose equation contains u but none of the fields, as
                of an incompressible material: p = kappa (J − 1), in the unit of the stress. A
                penalty if given alone; with ``volume_tolerance`` the modulus of the multipliers.
                Without both, multipliers are used, with a modulus from the stiffness at the start.
                Several such fields have one modulus.
            before_assembly: Function that is called with u, as it was given, on all processes
                before the residual and the tangent of each new state are assembled, trial states of
                the line search included. u, the condensed fields and the scalars hold that state,
                with ghosts. It updates coefficients of F and J, such as a stress from outside of
                UFL, from that state alone; it does not change the state. An energy given as F is
                then not used by the line search, because its derivative does not contain the
                change of the coefficients; one given by ``energy=`` is.
            contacts: Contacts of surfaces with rigid tools (:mod:`dolfinx_feti.contact`), which are
                added to F, J and the energy.
            contact_tolerance: Largest penetration, or gap at which a multiplier still pushes,
                relative to the size of a cell. The default is invisible in a plot of the mesh.
            boundary: Conditions on the surfaces of a wall, which ``apply_conditions`` of
                :mod:`dolfinx_feti.wall` returns: they are added to F, J, the energy and ``bcs``.
            subdomains: Number of subdomains over all processes, or the part of each owned cell;
                about one for 2000 dofs if not given.
            seed: Seed of the partitioner: one number gives the same decomposition in every run.
            petsc_options_prefix: Non-empty prefix of all options, equal on all processes; a unique
                one, ``nonlinear_problem_0_``, ``nonlinear_problem_1_`` and so on, if not given.
            near_null_space: Orthonormal vectors that every tangent maps nearly to zero; constants
                and the rotations of the deformed body if not given. May be attached to ``A``, too.
            null_space: Orthonormal vectors that every tangent maps to zero. May also be attached to
                ``A``.
            P: Accepted for compatibility with dolfinx; ignored.
            kind: Accepted for compatibility with dolfinx; ignored.
            entity_maps: Accepted for compatibility with dolfinx; several meshes cannot be torn.

        Raises:
            ValueError: Bad prefix, options, subdomains, boundary conditions or forms.
            TypeError: An unsupported element or scalar type.
        """
        check_scalar_type()
        update = _checked_update(before_assembly, u)
        arranged = _arrange(
            F,
            u,
            bcs,
            J,
            condense=condensed_fields(condense),
            energy=energy,
            boundary=boundary,
            scalars=scalars,
            contacts=contacts,
            contact_tolerance=contact_tolerance,
        )
        blocks = arranged.blocks
        forms, full_energy = _derive_forms(
            arranged,
            degree=quadrature_degree,
            volume_ratio=volume_ratio,
            updates_coefficients=update is not None,
        )
        check_kappa(kappa, has_incompressible_field=forms.compression is not None)
        if update is None:  # else a pressure that is zero now may be set by before_assembly
            check_pressures(
                blocks.F,
                arranged.energy,
                blocks.u,
                blocks.fields,
                internal_variables or {},
                Compiler(blocks.u.function_space.mesh.comm, form_compiler_options, jit_options),
            )
        self.u = u
        self.unknown = blocks.u
        self._contacts = arranged.contacts
        self._contact_tolerance = contact_tolerance

        # torn matrix and system; PETSc's objects, which __del__ destroys if anything below raises
        super().__init__(
            forms,
            arranged.conditions,
            name="nonlinear_problem",
            scalars=arranged.couplings,
            before_assembly=update,
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
        self._volume_multipliers = create_volume_multipliers(
            self._system,
            kappa=kappa,
            volume_tolerance=volume_tolerance,
            default_tolerance=VOLUME_TOLERANCE,
        )
        self._contacts.prepare(self._compiler)

        # what a path stores, and what is checked in accepted states
        scalar_equations = [
            form for coupling in arranged.couplings for form in coupling.equation.equations
        ]
        self.content = content_of(
            (arranged.users_unknown, *blocks.fields, *self._contacts.multipliers),
            (*forms.residuals, full_energy, *scalar_equations),
        )
        self._internal_variables = create_internal_variables(
            internal_variables or {}, self._compiler, coefficients=self.content.coefficients
        )
        self._cells = _create_cell_check(forms, blocks, self._compiler)

        # records and solver
        self._history_before_update: list[NewtonStep] = []  # of solves before the last update of λ
        self.volume_changes: list[float] = []
        self.contact_violations: list[float] = []
        self._newton = Newton(self._system)
        self.solver = create_newton_solver(self._newton, self.A, self._prefix, self._petsc_options)
        with inserted(self._prefix, self._petsc_options):
            self._newton.hooks.attach(self.solver, self.b)

    @cached_property
    def F(self) -> dolfinx.fem.Form:
        """The compiled residual, without condensation, as in dolfinx. Collective the first time."""
        return self._compiler.form(self._forms.F_u)

    @cached_property
    def J(self) -> dolfinx.fem.Form:
        """The compiled tangent, as in dolfinx; FETI has its own on the torn space.

        Collective the first time.
        """
        return self._compiler.form(self._forms.J)

    def __getattr__(self, name: str) -> object:
        """Raise an error, with a remedy for scripts that pass the problem to ``NewtonSolver``.

        dolfinx's ``NewtonSolver`` looks for the names below.
        """
        message = f"'{type(self).__name__}' object has no attribute '{name}'"
        if name not in ("L", "a", "form"):
            raise AttributeError(message)
        message += (
            "; it drives Newton's method itself: call problem.solve() in the place of "
            "dolfinx.nls.petsc.NewtonSolver"
        )
        # with an object Python would add its own suggestion, "Did you mean: 'A'?"
        raise AttributeError(message, name=name, obj=None)

    @property
    def history(self) -> list[NewtonStep]:
        """Records of the Newton steps of the last solve, between all updates of multipliers."""
        return self._history_before_update + self._newton.history

    @property
    def n_updates(self) -> int:
        """Number of updates of the multipliers of the volume in the last solve."""
        return max(len(self.volume_changes) - 1, 0)

    @property
    def has_contacts(self) -> bool:
        """Whether the problem has contacts."""
        return bool(self._contacts)

    def residual_norm(self) -> float:
        """Return ‖r‖ of the present state under the present load, with λ = p. Collective.

        It sets λ = p, as the next solve does.
        """
        self._begin_with_present_pressures()
        return norm(self._system.comm, self._system.residual().condensed)

    def linearise(self) -> TangentId:
        """Assemble the tangent at the present state and load, for the first step. Collective.

        Call it in an equilibrium, *before* the load grows, and pass the result to :meth:`solve`:
        the first step is then a prediction along the path. A tangent with the new load and the old
        stress can be indefinite although every state on the way is stable.

        Returns:
            Identity of the tangent; the matrix holds the tangent until the next assembly.
        """
        self._contacts.choose_missing_penalties(self._system)
        return self._system.linearise()

    def _balance(self) -> Balance:
        """Return the forces of the present state, with λ = p. Collective."""
        self._begin_with_present_pressures()
        is_deformed = self._system.deformation is not None
        force = self._system.residual().force
        return Balance(force, self._forms.F_u, is_deformed=is_deformed)

    def _assemble_system(self) -> Residual:
        """Assemble A and its near kernel; return the residual of the present state. Collective."""
        self._begin_with_present_pressures()
        return super()._assemble_system()

    def solve(
        self,
        *,
        reference: float | None = None,
        first_tangent: TangentId | None = None,
        renew: bool = True,
        give_up_early: bool = False,
        check_cells: bool = True,
    ) -> dolfinx.fem.Function | Sequence[dolfinx.fem.Function]:
        """Solve by Newton's method from the present u and pressure; return u as given. Collective.

        With a ``volume_tolerance`` the pressure becomes the multiplier after each Newton solve,
        until the material is incompressible (docs/theory.md, *Multipliers*). A solve begins with
        λ = p, so that restoring the pressure of a state also restores its multipliers.

        Args:
            reference: Residual norm that ``snes_rtol`` refers to, unless the norm at the start is
                smaller. Paths pass :meth:`residual_norm` of the last equilibrium under the new
                load: the norm at a predicted state may be larger by orders of magnitude. None and
                NaN have no effect.
            first_tangent: What :meth:`linearise` has returned: the first step uses that tangent. If
                it is not given, or the problem has contacts, the first step uses the tangent of the
                present state.
            renew: Whether to discard FETI's preconditioner and its Ritz vectors first. If False,
                those of the last solve are reused for as long as ``-feti_lag`` allows. That is
                faster if the state has changed little; u then depends on earlier solves, within the
                tolerance.
            give_up_early: Whether the solve fails as soon as step lengths stay below 0.1, or the
                first tangent is indefinite at a start whose residual exceeds ``reference``. Use it
                if you can retry with a shorter increment, which is cheaper
                (``iteration.early_end``).
            check_cells: Whether to check the cells of the solution, as :meth:`warn_of_cells` does.
                Paths do so in each state that they accept.

        Raises:
            ConvergenceError: Newton's method or FETI failed; u holds the last iterate. Classes in
                ``dolfinx_feti.errors`` distinguish the causes.
            ValueError: ``reference`` is negative, or the matrix no longer holds ``first_tangent``.
        """
        system = self._system
        if reference is not None and reference < 0.0:
            raise ValueError(f"reference is {reference}: give the norm of a residual.")
        is_outdated = first_tangent is not None and first_tangent is not system.tangent.id
        if system.comm.allreduce(is_outdated, op=MPI.LOR):
            raise ValueError(
                "first_tangent names a tangent that this problem's matrix does not hold any more: "
                "pass what linearise() has returned to the very next solve()."
            )
        has_reference = reference is not None and bool(np.isfinite(reference))
        start = Start(
            reference_norm=np.inf if reference is None else float(reference),
            follows_equilibrium=has_reference,
            # a tangent of the last equilibrium lacks the points that have touched a tool since
            tangent=None if self._contacts else first_tangent,
            allows_early_end=give_up_early,
        )
        system.scalars.check()
        on_all(lambda: check_newton_solver(self.solver, self._newton), system.comm)
        if renew:
            self.renew()
        self._history_before_update = []
        self.volume_changes = []
        self.contact_violations = []
        if self._volume_multipliers is None and not self._contacts:
            self._run(start)
        else:
            self._run_with_multipliers(start)
        if not self._contacts:  # a body that no tool touches yet is at rest for a reason
            self._warn_if_unloaded(
                "; pass what apply_conditions has returned to the problem, as boundary=",
                is_rounding=self._newton.outcome.is_rounding and not self.history,
            )
        if check_cells:
            self.warn_of_cells()
        return self.u

    def cell_volumes(self) -> CellVolumes | None:
        """Return the volume changes of the cells in the present state. Collective.

        det F, or ``volume_ratio``, is evaluated at points that the quadrature lacks: vertices and
        midpoints of edges, faces and cells (docs/cells_inside_out.md).

        Returns:
            The smallest and largest value, and how many cells are inside out; None if the forms
            contain no deformation gradient, or are defined at quadrature points only.
        """
        if self._cells is None:
            return None
        return self._cells.measure(self._system.conditions.mask)

    def warn_of_cells(self) -> None:
        """Log a warning if cells are inside out or distorted in the present state. Collective.

        A problem warns once of distorted cells, and once of cells that are inside out.
        """
        if self._cells is not None:
            self._cells.warn(self._system.conditions.mask)

    def _advice_on_cells(self, volumes: CellVolumes | None) -> list[Advice]:
        """Return advice on cells that are inside out or distorted."""
        if volumes is None or self._cells is None:
            return []
        return self._cells.advise(volumes)

    def _run(self, start: Start) -> None:
        """Iterate by Newton's method. Collective.

        Raises:
            ConvergenceError: It failed.
        """
        self._newton.prepare(start)
        try:
            with (
                inserted(self._prefix, self._petsc_options),
                failures_as_reasons(self.solver, self.solver.getKSP()),
                python_errors(self.solver),
            ):
                self.solver.solve(None, self.x)
                if self._newton.history:  # else no linear solver has read its options
                    warn_of_unread_options(self.solver, self._prefix, self._petsc_options)
        except BaseException:
            # PETSc locks x while it calls a monitor, and does not unlock it after an error there
            locked = self.x
            self.x = self.x.duplicate()
            locked.destroy()
            raise
        self.b.array[:] = self._newton.last_residual
        if self.solver.getConvergedReason() < 0:
            outcome = self._newton.outcome
            message = outcome.message.rstrip(".")
            raise outcome.error(f"Newton's method did not converge: {message}.")

    def _run_with_multipliers(self, start: Start) -> None:
        """Iterate by Newton's method and update the multipliers, in turn, up to their tolerances.

        With multipliers of the volume alone, each Newton solve may end before the solver's own
        tolerances are met (``Start.is_intermediate``), except the last one. Multipliers of a
        contact are updated in equilibrium: only there is it known which points touch.
        """
        self._contacts.fit_multipliers()
        self._begin_with_present_pressures()  # λ = p
        first_norm = norm(self._system.comm, self._system.residual().condensed)
        reference_norm = min(first_norm, start.reference_norm)
        constraints: list[MultiplierUpdates] = []
        if self._volume_multipliers is not None:
            # a looser solve does not determine p, and so the volume, any better than its tolerance
            tolerance = max(self._volume_multipliers.tolerance, relative_tolerance(self.solver))
            volume = VolumeUpdates(self._volume_multipliers, tolerance)
            constraints.append(volume)
            self.volume_changes = volume.violations
        if self._contacts:
            contact = ContactUpdates(self._system, self._contacts, self._contact_tolerance)
            constraints.append(contact)
            self.contact_violations = contact.violations
        is_intermediate = not self._contacts

        def solve_once(n_updates: int) -> bool:
            if n_updates > 0:
                self._history_before_update += self._newton.history
            begin = Start() if n_updates > 0 else start
            begin = replace(begin, reference_norm=reference_norm, is_intermediate=is_intermediate)
            self._run(begin)
            return self._newton.outcome.is_within_tolerances

        update_until_met(constraints, solve_once)
        self._contacts.require_no_crossing(self._contact_tolerance)
        self._contacts.store_positions()
        self._contacts.update_pressures()

    def _begin_with_present_pressures(self) -> None:
        """Choose missing penalties of contacts, and set λ = p if there are volume multipliers.

        Collective.
        """
        self._contacts.choose_missing_penalties(self._system)
        if self._volume_multipliers is not None:
            self._volume_multipliers.set_to_pressure()

    @property
    def internal_variables(self) -> tuple[dolfinx.fem.Function, ...]:
        """The Functions with the internal variables of material, scalars and contacts."""
        of_scalars_and_contacts = (*self._system.scalars.histories, *self._contacts.penalties)
        return (*self._internal_variables.functions, *of_scalars_and_contacts)

    def update_internal_variables(self, which: Updated = "all") -> None:
        """Update all internal variables at once from the present state. Collective.

        Call it when a state is accepted, as ``follow_load`` and ``follow_time`` do: a solve changes
        none of them.

        Args:
            which: ``"in_forces"`` for the variables that affect the forces, which paths update
                after ``on_step``; ``"recorded"`` for the others, which paths update before it; or
                ``"all"``.

        Raises:
            ValueError: ``which`` is none of these.
        """
        self._internal_variables.update(which)
        if which != "recorded":
            self._system.scalars.accept()

    def begin_step(self, length: float) -> None:
        """Prepare scalars and contacts for the next step of load or time.

        Contacts store the positions of body and tools before it.

        Args:
            length: Length of the step, in the unit of the path: Δt of time steps, which a
                Windkessel needs, or the increment of the load.
        """
        self._system.scalars.begin_step(length)
        self._contacts.store_positions()

    def renew(self) -> None:
        """Discard the preconditioner and the Ritz vectors; the next solve makes new ones."""
        self.solver.getKSP().getPythonContext().renew()

    def _advice_of_solves(self) -> list[Advice]:
        """Return the advice on the tangent from all solves."""
        return [finding.advice for finding in self._newton.findings]


def _checked_update(
    before_assembly: Callable[[Any], object] | None,
    u: dolfinx.fem.Function | Sequence[dolfinx.fem.Function],
) -> Callable[[], object] | None:
    """Return the call of ``before_assembly`` with u as it was given; None if there is none.

    Raises:
        ValueError: ``before_assembly`` cannot be called.
    """
    if before_assembly is None:
        return None
    require_callable(before_assembly)
    return partial(before_assembly, u)


@dataclass(frozen=True, slots=True)
class ArrangedProblem:
    """The user's problem, checked, with each unknown and form in its place.

    Attributes:
        users_unknown: The unknown on the continuous space, as the user gave it.
        blocks: Unknowns by what is done with them, and their forms, with those of a wall's
            conditions; a mixed element of one is rewritten.
        mixed: The user's unknown with a mixed element of one; None for other elements.
        energy: Potential of the forms; None if there is none.
        conditions: Dirichlet conditions.
        couplings: Scalars with their equations.
        contacts: Contacts.
    """

    users_unknown: dolfinx.fem.Function
    blocks: NonlinearBlocks
    mixed: MixedOfOne | None
    energy: ufl.Form | None
    conditions: Sequence[dolfinx.fem.DirichletBC]
    couplings: Sequence[Coupling]
    contacts: Contacts


def _arrange(
    F: ufl.Form | Sequence[ufl.Form],
    u: dolfinx.fem.Function | Sequence[dolfinx.fem.Function],
    bcs: Sequence[dolfinx.fem.DirichletBC] | None,
    J: ufl.Form | Sequence[Sequence[ufl.Form | None]] | None,
    *,
    condense: Sequence[dolfinx.fem.Function],
    energy: ufl.Form | None,
    boundary: Boundary | None,
    scalars: Sequence[Coupling],
    contacts: Sequence[Contact],
    contact_tolerance: float,
) -> ArrangedProblem:
    """Check and arrange the arguments of the same names of :class:`NonlinearProblem`. Collective.

    Raises:
        ValueError: Bad forms, boundary conditions, scalars or contacts.
        TypeError: An unsupported element.
    """
    for function in u if isinstance(u, Sequence) else [u]:
        require_function(function)
    if boundary is not None:
        complete = add_boundary(boundary, F, u, bcs, J, condense=condense, energy=energy)
        F = complete.F
        J = complete.J
        energy = complete.energy
        bcs = complete.bcs

    # which unknown is torn, which are condensed, and which are scalars
    given = arrange_nonlinear(F, u, J, condense)
    has_more = bool(given.equations or scalars or contacts)
    blocks, energy, mixed = _rewrite_mixed_of_one(given, energy, has_more_unknowns=has_more)
    V = blocks.u.function_space
    comm = V.mesh.comm
    on_all(lambda: require_torn_space(V, blocks.F), comm)

    # what acts on them
    conditions = on_all(lambda: checked_conditions(V, bcs, fields=blocks.fields, mixed=mixed), comm)
    couplings = [*blocks.equations, *check_couplings(scalars, conditions, V)]
    checked = on_all(lambda: checked_contacts(contacts, blocks.u, contact_tolerance), comm)
    return ArrangedProblem(given.u, blocks, mixed, energy, conditions, couplings, Contacts(checked))


def _derive_forms(
    arranged: ArrangedProblem,
    *,
    degree: int | None,
    volume_ratio: Expr | None,
    updates_coefficients: bool,
) -> tuple[Forms, ufl.Form | None]:
    """Derive the forms on the unknown that is torn.

    Args:
        arranged: The user's problem.
        degree: The user's highest quadrature degree.
        volume_ratio: The user's expression for det F, or None.
        updates_coefficients: Whether the problem has a ``before_assembly``.

    Returns:
        The forms; and their energy, which they leave out if there are scalars: its Constants
        identify the problem.

    Raises:
        ValueError: The forms do not fit each other, or the unknowns.
        TypeError: A field cannot be condensed.
    """
    blocks = arranged.blocks
    forms = derive(
        blocks.F,
        blocks.u,
        J=blocks.J,
        condense=blocks.fields,
        energy=arranged.energy,
        degree=degree,
        work=coupling_works(arranged.couplings),
        updates_coefficients=updates_coefficients,
        contacts=arranged.contacts.contacts,
    )
    refuse_condensed_fields(arranged.couplings, blocks.fields, forms.residuals[1:])
    full_energy = forms.energy
    if arranged.couplings:
        # The equations of scalars are no derivatives of an energy. ``derive`` has dropped it if
        # scalars do work on u; it is of no use without such work, either.
        forms = replace(forms, energy=None)
    forms = _with_volume_ratio(forms, volume_ratio, degree)
    return replace(forms, mixed=arranged.mixed), full_energy


def _create_cell_check(
    forms: Forms, blocks: NonlinearBlocks, compiler: Compiler
) -> CellCheck | None:
    """Return the check of cells in accepted states; None if forms have no volume ratio."""
    if forms.volume_ratio is None:
        return None
    return CellCheck(
        forms.volume_ratio,
        blocks.u,
        blocks.fields,
        compiler,
        quadrature_degree=forms.volume_ratio_degree,
    )


def _with_volume_ratio(
    forms: Forms, volume_ratio: Expr | None, quadrature_degree: int | None
) -> Forms:
    """Return forms with their volume ratio, and the degree of the points where it is evaluated.

    Args:
        forms: The forms.
        volume_ratio: The user's expression, or None.
        quadrature_degree: The user's degree; if None, twice that of u, the degree that is
            recommended for F as well.
    """
    if volume_ratio is None:
        ratio = volume_ratio_of(forms)
    else:
        ratio = volume_ratio_of_expression(volume_ratio, forms.u)
    degree = quadrature_degree
    if degree is None:
        degree = 2 * forms.u.function_space.ufl_element().embedded_superdegree
    return replace(forms, volume_ratio=ratio, volume_ratio_degree=degree)


def _rewrite_mixed_of_one(
    blocks: NonlinearBlocks, energy: ufl.Form | None, *, has_more_unknowns: bool
) -> tuple[NonlinearBlocks, ufl.Form | None, MixedOfOne | None]:
    """Rewrite a problem on a mixed element with one part as one on that part. Collective.

    Args:
        blocks: The problem.
        energy: Its energy.
        has_more_unknowns: Whether it has scalars or contacts.

    Returns:
        The problem, its energy, and the unknown as it was given; for another element the problem as
        it is and None.

    Raises:
        ValueError: The element is mixed, and there are scalars or contacts.
    """
    if not is_mixed_of_one(blocks.u.function_space):
        return blocks, energy, None
    if has_more_unknowns:
        raise ValueError(
            "The unknown has a mixed element of one, which takes no scalars or contacts: create "
            "its space with that element alone."
        )
    mixed = MixedOfOne(blocks.u)
    F = mixed.rewrite(blocks.F)
    J = mixed.rewrite(blocks.J)
    return replace(blocks, F=F, J=J, u=mixed.u), mixed.rewrite(energy), mixed
