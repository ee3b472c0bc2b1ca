# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Base class of linear and nonlinear problems: torn matrix, other solvers of A, diagnosis."""

from __future__ import annotations

import difflib
import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

from mpi4py import MPI
from petsc4py import PETSc

import numpy.typing as npt

import dolfinx
import ufl

from dolfinx_feti.diagnosis.advice import Advice
from dolfinx_feti.diagnosis.cell_volumes import CellVolumes
from dolfinx_feti.diagnosis.run import Diagnosis, diagnose
from dolfinx_feti.fem.assembly import assemble_owned
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.decomposition import decompose, suggested_number
from dolfinx_feti.fem.user_forms.checks import check_forms
from dolfinx_feti.problems.arguments import checked_conditions, checked_prefix, require_form
from dolfinx_feti.problems.equations.system import Residual, System
from dolfinx_feti.problems.forms import Forms
from dolfinx_feti.problems.reactions import Reaction, reaction
from dolfinx_feti.problems.solvers import create_solver
from dolfinx_feti.runtime.arrays import Array, Integers
from dolfinx_feti.runtime.collective import on_all, warn
from dolfinx_feti.scalars.equations import Coupling


@dataclass(frozen=True, slots=True)
class ProblemOptions:
    """Arguments that both problem classes have; :class:`NonlinearProblem` describes them."""

    form_compiler_options: Mapping[str, object] | None
    jit_options: Mapping[str, object] | None
    petsc_options: Mapping[str, object] | None
    petsc_options_prefix: str | None
    subdomains: int | Integers | None
    seed: int
    near_null_space: PETSc.NullSpace | None
    null_space: PETSc.NullSpace | None
    P: ufl.Form | None
    kind: str | None
    entity_maps: Sequence[object] | None


#: Warning if u = 0 solves a problem because nothing acts on it; {} is a further remedy.
_UNLOADED = (
    "u = 0, as nothing acts on it: no load acts on a free dof, and no condition prescribes another "
    "value. If there is to be a load, set its value before solve(), and check that facets have the "
    "tags of its measure, such as ds(1){}."
)


class Balance(NamedTuple):
    """The forces that reactions are computed from."""

    residual: Array  # F(u; φ_i) at the present state, reactions on Dirichlet dofs, (owned,)
    form: ufl.Form  # F
    is_deformed: bool  # True if forces act at deformed positions


class TornProblem(ABC):
    """A problem whose linear systems are torn.

    Attributes:
        u: The unknown, or the list of unknowns of a problem in blocks.
        unknown: The unknown on the continuous space, which is torn: u, or one of the list.
        solver: PETSc's solver.
        A: The torn matrix; ``A.mult`` is the assembled operator.
        b: The right-hand side of a linear problem; the residual r of the last iterate of a
            nonlinear one, with the fields condensed into it.
        x: The last solution or iterate, without ghosts, like ``b``; a copy of the values of u.
        P_mat: None: FETI's preconditioner is not a matrix.
        preconditioner: None, likewise.
        decomposition: Subdomain of each owned cell.
    """

    P_mat: None = None
    preconditioner: None = None
    u: dolfinx.fem.Function | Sequence[dolfinx.fem.Function]
    unknown: dolfinx.fem.Function
    solver: PETSc.KSP | PETSc.SNES

    def __new__(cls, *_: object, **keywords: object) -> Self:
        """Raise an error for keyword arguments that do not exist, with the most similar one.

        Python suggests similar ones itself from 3.13 on.

        Raises:
            TypeError: A keyword argument does not exist.
        """
        signature = inspect.signature(cls.__init__).parameters
        if any(parameter.kind is parameter.VAR_KEYWORD for parameter in signature.values()):
            return super().__new__(cls)  # a subclass that hands its keywords on
        parameters = list(signature)[1:]
        for name in sorted(keywords.keys() - set(parameters)):
            message = f"{cls.__name__}() got an unexpected keyword argument '{name}'"
            similar = difflib.get_close_matches(name, sorted(parameters), n=1)
            if similar:
                message += f". Did you mean '{similar[0]}'?"
            raise TypeError(message)
        return super().__new__(cls)

    def __init__(
        self,
        forms: Forms,
        bcs: Sequence[dolfinx.fem.DirichletBC],
        *,
        name: str,
        scalars: Sequence[Coupling],
        before_assembly: Callable[[], object] | None,
        options: ProblemOptions,
    ) -> None:
        """Tear the mesh and compile the forms. Collective.

        Args:
            forms: Forms, which have been checked.
            bcs: Dirichlet conditions, which have been checked.
            name: Name of the problem class, with which the default prefix of options begins.
            scalars: Scalar unknowns with their equations.
            before_assembly: Called before each assembly at a new state; None in a linear problem.
            options: The other arguments of both problem classes.

        Raises:
            ValueError: Bad prefix, options, subdomains, or several meshes.
        """
        V = forms.u.function_space
        comm = V.mesh.comm
        if options.entity_maps:
            raise ValueError(
                "entity_maps relates several meshes, but only forms on one mesh can be torn: put "
                "coefficients on the mesh of the unknown."
            )
        _warn_of_ignored_arguments(options.P, options.kind, comm)
        self._prefix = checked_prefix(options.petsc_options_prefix, name, comm)
        self._petsc_options = dict(options.petsc_options or {})
        self._forms = forms
        self._compiler = Compiler(comm, options.form_compiler_options, options.jit_options)
        subdomains = options.subdomains
        if subdomains is None:
            # FETI needs an interface: copies of dofs, or Dirichlet conditions as rows of B
            subdomains = suggested_number(V, 1 if bcs else 2)
        self.decomposition = decompose(V.mesh, subdomains, seed=options.seed)
        self._system = System(
            forms,
            bcs=bcs,
            decomposition=self.decomposition,
            compiler=self._compiler,
            scalars=scalars,
            before_assembly=before_assembly,
        )
        self.A = self._system.tangent.A
        if options.near_null_space is not None:
            self.A.setNearNullSpace(options.near_null_space)
        if options.null_space is not None:
            self.A.setNullSpace(options.null_space)
        self._is_load_checked = False  # by the first solve
        self.x, self.b = self.A.createVecs()
        for suffix, petsc_object in (("A", self.A), ("x", self.x), ("b", self.b)):
            petsc_object.setOptionsPrefix(f"{self._prefix}{suffix}_")

    @property
    def bcs(self) -> tuple[dolfinx.fem.DirichletBC, ...]:
        """The Dirichlet conditions. To change them for the next solve, assign others (collective).

        Raises:
            ValueError: The value is not a list of conditions on the space of the unknown, or leaves
                a scalar unknown without a solution.
        """
        return self._system.conditions.bcs

    @bcs.setter
    def bcs(self, bcs: Sequence[dolfinx.fem.DirichletBC] | None) -> None:
        V = self._forms.u.function_space
        mixed = self._forms.mixed
        conditions = on_all(lambda: checked_conditions(V, bcs, mixed=mixed), V.mesh.comm)
        self._system.prescribe(conditions)

    @property
    def condenses(self) -> bool:
        """Whether fields are condensed."""
        return self._system.condensation is not None

    def linear_system(self) -> tuple[PETSc.Mat, PETSc.Vec]:
        """Assemble A and b of the next solve, or of its first Newton step. Collective.

        Returns:
            A, which the problem owns, and b, which the caller destroys: in a Newton step −r, with
            the fields condensed into it.
        """
        b = self.A.createVecLeft()
        b.array[:] = -self._assemble_system().of_u
        return self.A, b

    def _assemble_system(self) -> Residual:
        """Assemble A and its near kernel; return the residual at the start of the next solve."""
        residual = self._system.residual()
        self._system.linearise(residual)
        return residual

    def _warn_if_unloaded(self, remedy: str = "", *, is_rounding: bool = False) -> None:
        """Log a warning if the first solve has ended at u = 0 without any residual. Collective.

        Later solves may be at zero load on purpose.

        Args:
            remedy: A further remedy.
            is_rounding: Whether the residual at u = 0 is known to be rounding.
        """
        if self._is_load_checked:
            return
        self._is_load_checked = True
        if self.x.norm() == 0.0 and (is_rounding or self.b.norm() == 0.0):
            warn(_UNLOADED.format(remedy), self._system.comm)

    def reaction(self, facets: npt.ArrayLike, *, point: npt.ArrayLike | None = None) -> Reaction:
        """Return force and moment that the surroundings exert on the body through a surface.

        They sum the reactions of all supports on the surface, and the loads and springs of surface
        integrals there, at the present state, with the problem's own quadrature. Over the whole
        boundary they balance the body forces to the tolerance of the solve. An edge that two
        clamped surfaces share counts for each of them: pass both at once for their sum.

        Forces act at deformed positions if the unknown is a displacement in large deformation, and
        else at reference positions. The deformation counts as large if F contains a determinant or
        an inverse of the deformation gradient.

        Args:
            facets: Facets of the surface on this process, owned ones and ghosts, such as
                ``dolfinx.mesh.locate_entities_boundary`` returns, or ``tags.find(number)``.
            point: Reference point of the moment, (d,); the origin if not given.

        Raises:
            ValueError: ``facets`` are not facet numbers of this mesh, or no process has one.

        Note:
            Collective; the result is the same on all processes.
        """
        balance = self._balance()
        return reaction(
            balance.residual,
            balance.form,
            self.unknown,
            facets,
            dirichlet=self._system.conditions.mask,
            is_deformed=balance.is_deformed,
            point=point,
            compiler=self._compiler,
        )

    @abstractmethod
    def _balance(self) -> Balance:
        """Return the forces that reactions are computed from. Collective."""

    def create_linear_solver(
        self, petsc_options: Mapping[str, object] | None = None, *, lifted: bool = False
    ) -> PETSc.KSP:
        """Create another FETI solver of A, which the caller destroys, with the same options.

        Args:
            petsc_options: Further options without prefix, which override the problem's own.
            lifted: Whether its right-hand sides are lifted, as by dolfinx's ``apply_lifting`` and
                ``set_bc``. If not, they are like those of :meth:`assemble_rhs`.
        """
        options = self._petsc_options | dict(petsc_options or {})
        return create_solver(self.A, self._prefix, options, lifted=lifted)

    def assemble_rhs(self, L: ufl.Form) -> PETSc.Vec:
        """Assemble the right-hand side of another load for A and its solvers. Collective.

        It holds the load on the free dofs, not lifted, and the prescribed values g on the Dirichlet
        dofs; for a nonlinear problem g − u, as in a Newton step.

        Args:
            L: Linear form, tested in the space of the unknown.

        Returns:
            A vector like ``b``; the caller destroys it.

        Raises:
            ValueError: L is no such form.
        """
        system = self._system
        V = self.unknown.function_space
        require_form("L", L)
        check_forms(V, L=(L, 1))
        load = assemble_owned(self._compiler.form(L))
        b = self.A.createVecLeft()
        b.array[:] = system.conditions.free(load) - system.conditions.gap()
        return b

    def diagnose(self) -> Diagnosis:
        """Measure FETI's parts for the next linear system, and its time. Collective.

        The system is assembled anew and solved once more, by another solver with the same options.
        PETSc's logging is begun, if necessary, for the times. ``print`` the diagnosis, or read its
        ``records``.

        Example::

            problem = LinearProblem(a, L, bcs=bcs, subdomains=4)
            problem.solve()
            print(problem.diagnose())
        """
        volumes = self.cell_volumes()
        return diagnose(
            self.linear_system,
            self.create_linear_solver,
            state=self._present_x(),
            prefix=self._prefix,
            earlier_advice=[*self._advice_of_solves(), *self._advice_on_cells(volumes)],
            volumes=volumes,
        )

    def _present_x(self) -> Array | float:
        """Return the x of the next linear system that is the present state, (owned,) or a number.

        It is zero if x is an increment, as in Newton's method.
        """
        return 0.0

    def cell_volumes(self) -> CellVolumes | None:
        """Return the volume changes of the cells; None for a linear problem."""
        return None

    def _advice_of_solves(self) -> list[Advice]:
        """Return advice from earlier solves."""
        return []

    def _advice_on_cells(self, volumes: CellVolumes | None) -> list[Advice]:
        """Return advice on cells that are inside out or distorted."""
        return []

    def __del__(self) -> None:
        """Destroy the PETSc objects, users of A before A itself."""
        for name in ("solver", "x", "b", "_system"):
            member = vars(self).get(name)  # __init__ may have raised
            if member is not None:
                member.destroy()


def _warn_of_ignored_arguments(P: ufl.Form | None, kind: str | None, comm: MPI.Comm) -> None:
    """Log arguments that dolfinx's classes have and that have no effect here. Collective."""
    ignored = []
    if P is not None:
        ignored.append("P")
    if kind is not None:
        ignored.append("kind")
    if ignored:
        warn(
            f"Without effect: {' and '.join(ignored)}. FETI has a preconditioner and a matrix "
            "(MATIS) of its own; leave it out.",
            comm,
        )
