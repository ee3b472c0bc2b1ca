# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What a linear and a nonlinear problem share: arguments, another solver of A, a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypedDict, Unpack

from petsc4py import PETSc

import dolfinx
import ufl

from dolfinx_feti.diagnosis.advice import Advice
from dolfinx_feti.diagnosis.run import Diagnosis, diagnose
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.decomposition import decompose, suggested_number
from dolfinx_feti.problems.arguments import agreed_prefix, checked_conditions
from dolfinx_feti.problems.forms import Forms
from dolfinx_feti.problems.solvers import create_solver
from dolfinx_feti.problems.system import Residual, System
from dolfinx_feti.runtime.arrays import Integers
from dolfinx_feti.runtime.collective import on_all, warn
from dolfinx_feti.scalars.equations import Coupling


class Common(TypedDict, total=False):
    """Further arguments of both problems, by keyword.

    Attributes:
        subdomains: Their number over all processes, or a part per owned cell; about one for 2000
            dofs if not given.
        seed: Another number for another decomposition into as many subdomains; that of one number
            is the same in every run.
        petsc_options_prefix: Non-empty prefix of all options, equal on all processes; one of its
            own, ``linear_problem_0_``, ``nonlinear_problem_0_`` and so on, if not given.
        near_null_space: What A nearly maps to zero, orthonormal; constants and the rotations of the
            deformed body if not given. As null_space, it may also be attached to ``A``.
        null_space: What A, or every tangent, maps to zero, orthonormal.
        P: Without effect, as a preconditioner of dolfinx's.
        kind: Without effect, as a type of dolfinx's matrices.
        entity_maps: None; several meshes cannot be torn.
    """

    subdomains: int | Integers | None
    seed: int
    petsc_options_prefix: str | None
    near_null_space: PETSc.NullSpace | None
    null_space: PETSc.NullSpace | None
    P: ufl.Form | None
    kind: str | None
    entity_maps: Sequence[object] | None


class TornProblem:
    """A problem whose linear systems are torn.

    Attributes:
        u: The unknown.
        solver: PETSc's solver.
        A: The torn matrix; ``A.mult`` is the assembled operator.
        b: The right-hand side of a linear problem; the residual of the last iterate of another one,
            with the pressure condensed into it.
        x: The last solution or iterate, as ``b`` without ghosts; u has memory of its own.
        P_mat: None, for FETI's preconditioner is no matrix; as ``preconditioner``.
        decomposition: Subdomain of each owned cell.
    """

    P_mat: None = None
    preconditioner: None = None
    u: dolfinx.fem.Function
    solver: PETSc.KSP | PETSc.SNES

    def __init__(
        self,
        name: str,
        forms: Forms,
        bcs: Sequence[dolfinx.fem.DirichletBC],
        scalars: Sequence[Coupling],
        compilers: tuple[Mapping[str, object] | None, Mapping[str, object] | None],
        petsc_options: Mapping[str, object] | None,
        /,
        **common: Unpack[Common],
    ) -> None:
        """Tear the mesh and compile the forms, which are checked; see :class:`Common`."""
        for other in sorted(common.keys() - Common.__annotations__.keys()):
            problem = type(self).__name__
            raise TypeError(f"{problem}() got an unexpected keyword argument '{other}'")
        V = forms.u.function_space
        comm = V.mesh.comm
        if common.get("entity_maps"):
            raise ValueError(
                "entity_maps relates several meshes, but only forms on one mesh can be torn: put "
                "coefficients on the mesh of the unknown."
            )
        unused = " and ".join(name for name in ("P", "kind") if common.get(name) is not None)
        if unused:
            warn(
                f"Without effect: {unused}. FETI has a preconditioner and a matrix (MATIS) of its "
                "own; leave it out.",
                comm,
            )
        self._known_advice: list[Advice] = []  # what earlier solves have found
        self._prefix = agreed_prefix(common.get("petsc_options_prefix"), name, comm)
        self._petsc_options = dict(petsc_options or {})
        self._forms, self._compiler = forms, Compiler(comm, *compilers)
        subdomains = common.get("subdomains")
        if subdomains is None:  # a null space is one of several subdomains together
            subdomains = suggested_number(V, 1 if bcs else 2)
        self.decomposition = decompose(V.mesh, subdomains, seed=common.get("seed", 0))
        self._system = System(
            forms,
            bcs=bcs,
            decomposition=self.decomposition,
            compiler=self._compiler,
            scalars=scalars,
        )
        self.A = self._system.A
        if (near_kernel := common.get("near_null_space")) is not None:
            self.A.setNearNullSpace(near_kernel)
        if (kernel := common.get("null_space")) is not None:
            self.A.setNullSpace(kernel)
        self.x, self.b = self.A.createVecs()
        for suffix, owned in (("A", self.A), ("x", self.x), ("b", self.b)):
            owned.setOptionsPrefix(f"{self._prefix}{suffix}_")

    @property
    def bcs(self) -> tuple[dolfinx.fem.DirichletBC, ...]:
        """The Dirichlet conditions. Others, assigned on all processes, hold in the next solve.

        Raises:
            ValueError: What is assigned is no list of conditions on the space of the unknown, or
                leaves a scalar unknown without a solution.
        """
        return tuple(self._system.bcs)

    @bcs.setter
    def bcs(self, bcs: Sequence[dolfinx.fem.DirichletBC] | None) -> None:
        V = self._system.u.function_space
        self._system.prescribe(on_all(lambda: checked_conditions(V, bcs), V.mesh.comm))

    @property
    def condenses(self) -> bool:
        """Whether fields are condensed."""
        return self._system.condensation is not None

    def linear_system(self) -> tuple[PETSc.Mat, PETSc.Vec]:
        """Assemble A and b of the next solve, or of its first Newton step. Collective.

        A stays the problem's own, the caller destroys b: −r with the pressure condensed into it in
        a Newton step.
        """
        b = self.A.createVecLeft()
        b.array[:] = -self._assemble().equations
        return self.A, b

    def _assemble(self) -> Residual:
        """Assemble A, its near kernel, and the residual where the next solve begins."""
        residual = self._system.residual()
        self._system.linearise(residual)
        return residual

    def create_linear_solver(self) -> PETSc.KSP:
        """Create another FETI solver of A, which the caller destroys, with the same options."""
        return create_solver(self.A, self._prefix, self._petsc_options)

    def diagnose(self) -> Diagnosis:
        """Measure what FETI builds for the next linear system and what its time goes into.

        It is assembled anew and solved once more, by another solver with the same options. PETSc's
        logging is begun if it is not, for the times. ``print`` the diagnosis, or take its
        ``records``. Collective.
        """
        return diagnose(
            self.linear_system,
            self.create_linear_solver,
            state=0.0 if self._system.u is self.u else self.u.x.array[: self._system.owned],
            prefix=self._prefix,
            known=self._known_advice,
        )

    def __del__(self) -> None:
        """Free the PETSc objects."""
        for name in ("solver", "x", "b", "_system"):
            owned = vars(self).get(name)  # __init__ may have raised
            if owned is not None:
                owned.destroy()
