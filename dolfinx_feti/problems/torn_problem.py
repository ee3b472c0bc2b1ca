# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What a linear and a nonlinear problem share: another solver of their torn system, a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from petsc4py import PETSc

import dolfinx
from ufl.core.expr import Expr

from dolfinx_feti.diagnosis.advice import Advice
from dolfinx_feti.diagnosis.run import Diagnosis, diagnose
from dolfinx_feti.fem.assembly import dirichlet_mask, prescribe
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.decomposition import decompose, suggested_number
from dolfinx_feti.problems.arguments import agreed_prefix, checked_conditions, warn_unused
from dolfinx_feti.problems.forms import Forms
from dolfinx_feti.problems.solvers import create_solver
from dolfinx_feti.problems.system import System
from dolfinx_feti.runtime.arrays import Array, Integers
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.scalars.equations import Coupling

__all__ = ["TornProblem"]


class TornProblem:
    """A problem whose linear systems are torn.

    Attributes:
        u: The unknown.
        solver: PETSc's solver.
        A: The torn matrix; ``A.mult`` is the assembled operator.
        b: A vector of the assembled problem, as ``x`` without ghosts.
        x: Another one.
        P_mat: None, for FETI's preconditioner is no matrix.
        preconditioner: None.
        decomposition: Subdomain of each owned cell.
    """

    P_mat: None = None
    preconditioner: None = None
    u: dolfinx.fem.Function
    solver: PETSc.KSP | PETSc.SNES

    def __init__(
        self,
        kind: str,
        forms: Forms,
        bcs: Sequence[dolfinx.fem.DirichletBC],
        scalars: Sequence[Coupling] = (),
        *,
        compilers: tuple[Mapping[str, object] | None, Mapping[str, object] | None],
        prefix: str | None,
        petsc_options: Mapping[str, object] | None,
        subdomains: int | Integers | None,
        seed: int,
        near_null_space: PETSc.NullSpace | None,
        null_space: PETSc.NullSpace | None,
        unused: Mapping[str, object],
        least: int = 1,
        volume_ratio: Expr | None = None,
        quadrature_degree: int = 0,
    ) -> None:
        """Tear the mesh and compile the forms, checked, from what both problems take.

        Raises:
            ValueError: A bad prefix or number of subdomains, or maps between meshes.
        """
        V = forms.u.function_space
        comm = V.mesh.comm
        warn_unused(comm, unused)
        self._prefix = agreed_prefix(prefix, kind, comm)
        self._petsc_options = dict(petsc_options or {})
        self._compiler = Compiler(comm, *compilers)
        self.decomposition = decompose(
            V.mesh, suggested_number(V, least) if subdomains is None else subdomains, seed=seed
        )
        self._system = System(
            forms,
            bcs=bcs,
            decomposition=self.decomposition,
            volume_ratio=volume_ratio,
            quadrature_degree=quadrature_degree,
            compiler=self._compiler,
            scalars=scalars,
        )
        self.A = self._system.A
        if near_null_space is not None:
            self.A.setNearNullSpace(near_null_space)
        if null_space is not None:
            self.A.setNullSpace(null_space)
        self.x, self.b = self.A.createVecs()
        for name, owned in (("A", self.A), ("x", self.x), ("b", self.b)):
            owned.setOptionsPrefix(f"{self._prefix}{name}_")

    @property
    def bcs(self) -> tuple[dolfinx.fem.DirichletBC, ...]:
        """The Dirichlet conditions. Others may be assigned: the next solve meets them.

        Raises:
            ValueError: What is assigned is no list of conditions on the space of the unknown, or
                leaves a scalar unknown without a solution.

        Note:
            Assignment is collective.
        """
        return tuple(self._system.bcs)

    @bcs.setter
    def bcs(self, bcs: Sequence[dolfinx.fem.DirichletBC] | None) -> None:
        system, V = self._system, self._system.u.function_space
        conditions = on_all(lambda: checked_conditions(V, bcs), V.mesh.comm)
        dirichlet = dirichlet_mask(V, conditions)
        system.scalars.prescribe(conditions, free=~dirichlet)
        system.bcs, system.dirichlet = list(conditions), dirichlet
        prescribe(self.A, dirichlet)

    def linear_system(self) -> tuple[PETSc.Mat, PETSc.Vec]:
        """Assemble the torn system of the next solve.

        Returns:
            A, which stays the problem's own, and b, which the caller destroys.

        Note:
            Collective.
        """
        raise NotImplementedError

    @property
    def condenses(self) -> bool:
        """Whether fields are condensed."""
        return self._system.condensation is not None

    def _approximation(self) -> Array | float:
        """Return the x of the present state, (owned,), or one value for all."""
        return 0.0

    def _known_advice(self) -> tuple[Advice, ...]:
        """Return what earlier solves have found."""
        return ()

    def create_linear_solver(self) -> PETSc.KSP:
        """Create another FETI solver of A, with the options of this problem.

        Returns:
            A KSP that has set up nothing yet; the caller destroys it.

        Raises:
            ValueError: An option has a wrong value.

        Note:
            Collective.
        """
        return create_solver(self.A, self._prefix, self._petsc_options)

    def diagnose(self) -> Diagnosis:
        """Measure what FETI builds for the next linear system and what its time goes into.

        It is assembled anew and solved once more, by another solver with the same options. PETSc's
        logging is begun if it is not, for the times.

        Returns:
            The diagnosis: ``print`` it, or take its ``records``.

        Note:
            Collective.
        """
        return diagnose(
            self.linear_system,
            self.create_linear_solver,
            state=self._approximation(),
            prefix=self._prefix,
            known=self._known_advice(),
        )

    def __del__(self) -> None:
        """Free the PETSc objects."""
        for name in ("solver", "x", "b", "_system"):
            owned = vars(self).get(name)  # __init__ may have raised
            if owned is not None:
                owned.destroy()
