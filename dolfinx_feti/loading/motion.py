# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Motion with inertia: the generalised-α method (Chung and Hulbert 1993).

.. math:: M a_{n+1-α_m} + F(u_{n+1-α_f};\, t_{n+1-α_f}) = 0, \qquad
          w_{n+1-α} = (1 - α)\, w_{n+1} + α\, w_n,

with Newmark's formulas, :math:`u_{n+1} = u_n + Δt\, v_n + Δt^2 ((½ - β) a_n + β a_{n+1})` and
:math:`v_{n+1} = v_n + Δt ((1 - γ) a_n + γ a_{n+1})`. The unknown u of the problem is
:math:`u_{n+1-α_f}`, so that its forms stay as they are, and mass and damping are affine in it:

.. math:: a_{n+1-α_m} = c\, (u - \tilde u), \qquad v_{n+1-α_f} = d\, (u - \hat u), \qquad
          c = \frac{1 - α_m}{(1 - α_f)\, β\, Δt^2}, \qquad d = \frac{γ}{β\, Δt}.

With the spectral radius ρ_∞ at high frequencies, α_m = (2 ρ_∞ − 1)/(ρ_∞ + 1), α_f = ρ_∞/(ρ_∞ + 1),
γ = ½ − α_m + α_f and β = ¼ (1 − α_m + α_f)²: of second order, and stable for linear problems.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import dolfinx
import dolfinx.fem.petsc
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.errors import ConvergenceError

__all__ = ["Motion"]

Array = npt.NDArray[np.float64]

#: Of the mass matrix' own solve, which a Jacobi preconditioner serves.
MASS_RTOL, MASS_ITERATIONS = 1e-12, 500


class Motion:
    """Inertia and velocities of a displacement.

    Example::

        motion = Motion(u, density=1e-6)  # kg/mm³, with mm, kPa and s
        problem = NonlinearProblem(energy + motion.inertia, u, bcs=bcs)
        follow_time(problem, motion, set_time, [0.1], TimeSteps(first=1e-3, least=1e-5), state=[u])

    Attributes:
        u: The displacement; on the way to the end of a step, that at :math:`t_{n+1-α_f}`.
        velocity: v of the last state, a Function; an initial velocity is set here.
        acceleration: a of the last state, a Function.
        dt: Δt, a Constant, for materials whose memory fades with time.
        inertia: Form ½ ∫ ρ c (u − ũ)², to be added to an energy; its derivative is added to a
            residual, and its second derivative to a tangent.
        rate: The velocity in u, d (u − û), for forces that damp.
    """

    def __init__(self, u: dolfinx.fem.Function, density: float | Expr, *, rho: float = 0.8) -> None:
        """Begin at rest.

        Args:
            u: The displacement.
            density: Mass per reference volume, ρ; in kg/mm³ with mm, kPa and s.
            rho: Spectral radius ρ_∞ at high frequencies, from 0, which damps them in one step, to
                1, which keeps them.

        Raises:
            ValueError: ``rho`` is not between 0 and 1.
        """
        if not 0.0 <= rho <= 1.0:
            raise ValueError(f"rho={rho}: give a spectral radius between 0 and 1.")
        V = u.function_space
        self.u = u
        self.velocity = dolfinx.fem.Function(V, name="velocity")
        self.acceleration = dolfinx.fem.Function(V, name="acceleration")
        self.dt = dolfinx.fem.Constant(V.mesh, np.float64(0.0))
        self._ahead, self._behind = dolfinx.fem.Function(V), dolfinx.fem.Function(V)  # ũ, û
        self._c, self._d = (dolfinx.fem.Constant(V.mesh, np.float64(0.0)) for _ in range(2))
        self._α_m, self._α_f = (2.0 * rho - 1.0) / (rho + 1.0), rho / (rho + 1.0)
        self._γ = 0.5 - self._α_m + self._α_f
        self._β = 0.25 * (1.0 - self._α_m + self._α_f) ** 2
        self._last: Array = u.x.array.copy()  # u_n
        self._density = density
        difference, v = u - self._ahead, self.velocity
        self.inertia = density * self._c / 2 * ufl.inner(difference, difference) * ufl.dx
        self.rate = self._d * (u - self._behind)
        self._kinetic = dolfinx.fem.form(density / 2 * ufl.inner(v, v) * ufl.dx)

    def start(self, residual: dolfinx.fem.Form, bcs: list[dolfinx.fem.DirichletBC]) -> None:
        """Let the initial acceleration balance the forces, M a = −F(u).

        Args:
            residual: F(u; v) with the inertia in it.
            bcs: Conditions of the problem; their dofs have no acceleration.

        Raises:
            ConvergenceError: The mass matrix could not be solved with: a density is not positive.

        Note:
            Collective.
        """
        V = self.u.function_space
        self._ahead.x.array[:] = self.u.x.array  # no inertia
        self._d.value, self._behind.x.array[:] = 0.0, 0.0
        test, trial = ufl.TestFunction(V), ufl.TrialFunction(V)
        mass = dolfinx.fem.form(self._density * ufl.inner(trial, test) * ufl.dx)
        M = dolfinx.fem.petsc.assemble_matrix(mass, bcs)
        M.assemble()
        b = dolfinx.la.vector(V.dofmap.index_map, V.dofmap.index_map_bs)
        dolfinx.fem.assemble_vector(b.array, residual)
        b.scatter_reverse(dolfinx.la.InsertMode.add)
        f, a = M.createVecs()
        f.array[:] = -b.array[: f.getLocalSize()]
        for bc in bcs:
            dofs, _ = bc.dof_indices()
            f.array[dofs[dofs < f.getLocalSize()]] = 0.0
        ksp = PETSc.KSP().create(M.comm)
        ksp.setOperators(M)
        ksp.setType(PETSc.KSP.Type.CG)
        ksp.getPC().setType(PETSc.PC.Type.JACOBI)
        ksp.setTolerances(rtol=MASS_RTOL, max_it=MASS_ITERATIONS)
        ksp.solve(f, a)
        solved = ksp.getConvergedReason() > 0
        self.acceleration.x.array[: a.getLocalSize()] = a.array_r
        self.acceleration.x.scatter_forward()
        for owned in (ksp, M, f, a):
            owned.destroy()
        if not solved:
            raise ConvergenceError(
                "The mass matrix could not be solved with for the initial acceleration: give a "
                "positive density in all cells."
            )

    def enter(self, dt: float) -> float:
        """Enter a step: let u be the displacement that is looked for, beginning with u_n.

        Args:
            dt: Its length Δt.

        Returns:
            The time from the beginning of the step at which forces are balanced, (1 − α_f) Δt.
        """
        v, a, u = self.velocity.x.array, self.acceleration.x.array, self.u.x.array
        α_m, α_f, β, γ = self._α_m, self._α_f, self._β, self._γ
        c = (1.0 - α_m) / ((1.0 - α_f) * β * dt**2)
        d = γ / (β * dt)
        self.dt.value, self._c.value, self._d.value = dt, c, d
        self._last = u.copy()
        free = u + dt * v + dt**2 * (0.5 - β) * a  # u_{n+1} without a_{n+1}
        self._ahead.x.array[:] = α_f * u + (1.0 - α_f) * free - α_m / c * a
        past = α_f * u + (1.0 - α_f) * free  # where a_{n+1} = 0
        rate = v + (1.0 - α_f) * dt * (1.0 - γ) * a  # v_{n+1−α_f}, there
        self._behind.x.array[:] = past - rate / d
        return (1.0 - α_f) * dt

    def predict(self) -> None:
        """Let the iteration begin where a constant acceleration leads."""
        v, a, dt = self.velocity.x.array, self.acceleration.x.array, float(self.dt.value)
        self.u.x.array[:] = self._last + (1.0 - self._α_f) * (dt * v + dt**2 / 2.0 * a)

    def error(self) -> float:
        """Estimate the error of the displacement in this step, (β − 1/6) Δt² (a_{n+1} − a_n).

        Returns:
            Its largest entry (Zienkiewicz and Xie 1991).

        Note:
            Collective.
        """
        change = np.abs(self._next()[1] - self.acceleration.x.array).max(initial=0.0)
        largest = self.u.function_space.mesh.comm.allreduce(change, op=MPI.MAX)
        return abs(self._β - 1.0 / 6.0) * float(self.dt.value) ** 2 * largest

    def leave(self) -> Array:
        """Go to the end of the step: u, velocity and acceleration are those of t_{n+1}.

        Returns:
            How far the step has led, u_{n+1} − u_n, with ghosts.
        """
        u, a = self._next()
        dt, γ = float(self.dt.value), self._γ
        self.velocity.x.array[:] += dt * ((1.0 - γ) * self.acceleration.x.array + γ * a)
        self.acceleration.x.array[:] = a
        self.u.x.array[:] = u
        return u - self._last

    def kinetic_energy(self) -> float:
        """Return ½ ∫ ρ v².

        Note:
            Collective.
        """
        comm = self.u.function_space.mesh.comm
        return float(comm.allreduce(dolfinx.fem.assemble_scalar(self._kinetic)))

    def _next(self) -> tuple[Array, Array]:
        """Return u and a at the end of the step."""
        dt, β, last = float(self.dt.value), self._β, self._last
        v, a = self.velocity.x.array, self.acceleration.x.array
        u = np.asarray((self.u.x.array - self._α_f * last) / (1.0 - self._α_f))
        return u, np.asarray((u - last - dt * v - dt**2 * (0.5 - β) * a) / (β * dt**2))
