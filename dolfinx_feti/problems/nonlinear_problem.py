# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""dolfinx's ``NonlinearProblem`` with Newton's method on torn tangents and a FETI solver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.fem.checks import (
    check_bcs,
    check_nonlinear_forms,
    check_pressure_space,
    check_scalar_type,
    check_space,
)
from dolfinx_feti.fem.decomposition import decompose
from dolfinx_feti.fem.quadrature import limit_quadrature_degree
from dolfinx_feti.feti.solver import FETI
from dolfinx_feti.petsc_options import inserted, require_prefix
from dolfinx_feti.problems.history import NewtonStep
from dolfinx_feti.problems.newton import Newton, Start
from dolfinx_feti.problems.solvers import create_newton_solver, python_errors
from dolfinx_feti.problems.system import System, Tangent

__all__ = ["NonlinearProblem"]


class NonlinearProblem:
    """Solve F(u; v) = 0 for all v by Newton's method, every step with a FETI method.

    Example::

        problem = dolfinx_feti.NonlinearProblem(
            [F_u, F_p], u, bcs=bcs, condense=p, subdomains=64, petsc_options_prefix="artery_",
            petsc_options={"feti_type": "all_floating", "snes_monitor": None},
        )
        problem.solve()

    Attributes:
        u: The unknown.
        solver: The SNES.
        A: The torn tangent.
        decomposition: Subdomain of each owned cell.
    """

    def __init__(
        self,
        F: ufl.Form | Sequence[ufl.Form],
        u: dolfinx.fem.Function,
        *,
        bcs: Sequence[dolfinx.fem.DirichletBC] = (),
        J: ufl.Form | None = None,
        condense: dolfinx.fem.Function | None = None,
        energy: ufl.Form | None = None,
        subdomains: int | npt.NDArray[np.integer],
        petsc_options_prefix: str,
        petsc_options: Mapping[str, object] | None = None,
        quadrature_degree: int | None = None,
        volume_ratio: ufl.core.expr.Expr | None = None,
    ) -> None:
        """Tear the mesh, derive and compile the forms.

        Args:
            F: Residual; or an energy, whose derivatives are taken; with ``condense``, an energy
                Π(u, p) or the pair of residuals (tested with v, tested with q).
            u: Unknown; holds the start and then the solution.
            bcs: Dirichlet conditions on u.
            J: Tangent of the residual tested with v, in u; derived from it if not given. A
                symmetric one lets the dual method be CG.
            condense: Piecewise constant pressure that is eliminated cell by cell.
            energy: Potential Π(u) or Π(u, p) whose derivatives are the residuals F, if they have
                one: F itself if that is an energy. It keeps Newton's method on the way down.
            subdomains: Their number over all processes, or a part per owned cell.
            petsc_options_prefix: Non-empty prefix of all options, equal on all processes.
            petsc_options: Options without prefix: ``snes_…``, ``feti_…``, see ``docs/options.md``.
            quadrature_degree: Highest degree of the integrals that state none; twice that of u
                if not given, see ``quadrature``.
            volume_ratio: Expression that every iterate keeps positive at all quadrature points;
                det(I + Grad u) if not given and u is a displacement.

        Raises:
            ValueError: Bad prefix, options, subdomains, boundary conditions or forms.
            TypeError: An unsupported element or scalar type.

        Note:
            Collective; raises on all processes.
        """
        check_scalar_type()
        self._prefix = require_prefix(petsc_options_prefix)
        self._petsc_options = dict(petsc_options or {})
        V = u.function_space
        check_space(V)
        check_bcs(V, bcs)
        if condense is not None:
            check_pressure_space(condense.function_space)
        degree = 2 * V.ufl_element().embedded_superdegree
        degree = degree if quadrature_degree is None else quadrature_degree
        energy = potential(F, energy)
        F_u, F_p = residuals(F, u, condense)
        F_u = limit_quadrature_degree(F_u, degree)
        F_p = None if F_p is None else limit_quadrature_degree(F_p, degree)
        J = ufl.derivative(F_u, u, ufl.TrialFunction(V)) if J is None else J
        check_nonlinear_forms(F_u, J, u)
        J = limit_quadrature_degree(J, degree)
        pressure = None
        if F_p is not None and condense is not None:
            pressure = (F_p, condense)
        self.u = u
        self.decomposition = decompose(V.mesh, subdomains)
        self._system = System(
            F_u,
            u,
            bcs=bcs,
            J=J,
            pressure=pressure,
            energy=None if energy is None else limit_quadrature_degree(energy, degree),
            volume_ratio=default_volume_ratio(u) if volume_ratio is None else volume_ratio,
            quadrature_degree=degree,
            decomposition=self.decomposition,
        )
        self.A = self._system.A
        self._newton = Newton(self._system)
        self._x = self.A.createVecRight()
        feti = FETI()
        feti.refuse_indefinite = self._system.has_potential
        self.solver = create_newton_solver(
            self._newton, feti, self.A, self._prefix, self._petsc_options
        )

    @property
    def history(self) -> list[NewtonStep]:
        """What each Newton step of the last solve cost."""
        return self._newton.history

    def residual_norm(self) -> float:
        """Return ‖r‖ of the present state under the present load.

        Note:
            Collective.
        """
        return self._system.norm(self._system.residual().condensed)

    def linearise(self) -> Tangent:
        """Assemble the tangent at the present state and load, for the first step of a solve.

        Call it in an equilibrium, *before* the load grows, and give it to :meth:`solve`. A tangent
        with the new load and the old stress is that of a wall which the pressure already softens
        and no tension stiffens yet; it can be indefinite although every state on the way is stable.
        The tangent of the last equilibrium makes the first step the prediction along the path of
        loading.

        Returns:
            A name of the tangent, which the matrix holds until the next step is assembled.

        Note:
            Collective.
        """
        return self._system.linearise()

    def solve(
        self, *, reference: float | None = None, first_tangent: Tangent | None = None
    ) -> dolfinx.fem.Function:
        """Iterate from the present u (and pressure) to the solution.

        Args:
            reference: A residual norm that the relative tolerance refers to if that of the start is
                larger, such as :meth:`residual_norm` of the last equilibrium under the new load
                where a guess begins with a far larger one: far out, a material that stiffens
                exponentially begins with a residual of which no share is an equilibrium. One that
                is NaN does not count.
            first_tangent: The tangent of the first step, made by :meth:`linearise`; that of the
                present state if not given.

        Returns:
            The unknown u.

        Raises:
            ConvergenceError: Newton's method or FETI failed; u holds the last good iterate.
            ValueError: ``reference`` is negative, or the matrix no longer holds ``first_tangent``.

        Note:
            Collective.
        """
        start = self._start(reference, first_tangent)
        with (
            inserted(self._prefix, self._petsc_options),
            self._newton.starting(start),
            python_errors(),
        ):
            self.solver.solve(None, self._x)
        if self.solver.getConvergedReason() < 0:
            message = self._newton.message.rstrip(".")
            raise ConvergenceError(f"Newton's method did not converge: {message}.")
        return self.u

    def _start(self, reference: float | None, tangent: Tangent | None) -> Start:
        """Check what a solve is to begin with.

        Raises:
            ValueError: See :meth:`solve`.
        """
        if reference is not None and reference < 0.0:
            raise ValueError(f"reference is {reference}: give the norm of a residual.")
        replaced = tangent is not None and tangent != self._system.tangent()
        if self._system.comm.allreduce(replaced, op=MPI.LOR):
            raise ValueError(
                "first_tangent names a tangent that this problem's matrix does not hold any more: "
                "pass what linearise() has returned to the very next solve()."
            )
        return Start(np.inf if reference is None else float(reference), tangent)

    def __del__(self) -> None:
        """Free the PETSc objects."""
        for name in ("solver", "_x", "_system"):
            owned = getattr(self, name, None)  # __init__ may have raised
            if owned is not None:
                owned.destroy()


def potential(F: ufl.Form | Sequence[ufl.Form], energy: ufl.Form | None) -> ufl.Form | None:
    """Return the potential of the problem: F itself if that is an energy, or ``energy``.

    Raises:
        ValueError: Both are given, and differ.
    """
    if not isinstance(F, ufl.Form) or F.arguments():
        return energy
    if energy is not None and not F.equals(energy):
        raise ValueError(
            "energy is not F, which is an energy itself and the one that is minimised: leave "
            "energy out, or give the residuals as F."
        )
    return F


def residuals(
    F: ufl.Form | Sequence[ufl.Form], u: dolfinx.fem.Function, p: dolfinx.fem.Function | None
) -> tuple[ufl.Form, ufl.Form | None]:
    """Return the residuals tested with v and, for a condensed pressure, with q.

    Args:
        F: Residual, pair of residuals, or energy.
        u: Unknown.
        p: Pressure to be condensed.

    Raises:
        ValueError: The forms do not fit ``condense``.
    """
    if not isinstance(F, ufl.Form):
        forms = list(F)
        if p is None or len(forms) != 2 or any(len(form.arguments()) != 1 for form in forms):
            raise ValueError(
                f"F is a sequence of {len(forms)} forms: give two residuals, tested with v and "
                "with q, together with condense=p."
            )
        spaces = [form.arguments()[0].ufl_function_space() for form in forms]
        if spaces != [u.function_space, p.function_space]:
            raise ValueError("F holds residuals on other spaces: test them with v in V and q in Q.")
        return forms[0], forms[1]
    rank = len(F.arguments())
    if rank == 0 and u not in F.coefficients():
        raise ValueError(
            f"The unknown '{u.name}' does not occur in F: pass the Function that F is written in."
        )
    if rank > 1 or (rank == 1 and p is not None):
        raise ValueError(
            f"F has {rank} arguments: give a residual or an energy; with condense=p an energy "
            "Π(u, p) or the pair of its residuals."
        )
    if rank == 1:
        return F, None
    F_u = ufl.derivative(F, u, ufl.TestFunction(u.function_space))
    if p is None:
        return F_u, None
    return F_u, ufl.derivative(F, p, ufl.TestFunction(p.function_space))


def default_volume_ratio(u: dolfinx.fem.Function) -> ufl.core.expr.Expr | None:
    """Return det(I + Grad u) of a displacement, None for another unknown."""
    gdim = u.function_space.mesh.geometry.dim
    if u.ufl_shape != (gdim,):
        return None
    return ufl.det(ufl.Identity(gdim) + ufl.grad(u))
