# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Motion with inertia: the generalised-α method in the form of Arnold and Brüls (2007).

Forces are balanced at the end of a step, by the acceleration ü there, and Newmark's formulas take
another one, a, which follows ü with the numerical damping of Chung and Hulbert (1993):

.. math:: M \ddot u_{n+1} + F(u_{n+1}, v_{n+1};\, t_{n+1}) = 0, \qquad
          (1 - α_m)\, a_{n+1} + α_m a_n = (1 - α_f)\, \ddot u_{n+1} + α_f \ddot u_n, \\
          u_{n+1} = u_n + Δt\, v_n + Δt^2 ((½ - β) a_n + β a_{n+1}), \qquad
          v_{n+1} = v_n + Δt ((1 - γ) a_n + γ a_{n+1}).

The unknown of the problem is u_{n+1}, in which mass and damping are affine:

.. math:: \ddot u_{n+1} = c\, (u - \tilde u), \qquad v_{n+1} = d\, (u - \hat u), \qquad
          c = \frac{1 - α_m}{(1 - α_f)\, β\, Δt^2}, \qquad d = \frac{γ}{β\, Δt}.

With the spectral radius ρ_∞ at high frequencies, α_m = (2 ρ_∞ − 1)/(ρ_∞ + 1), α_f = ρ_∞/(ρ_∞ + 1),
γ = ½ − α_m + α_f and β = ¼ (1 − α_m + α_f)²: of second order. As a is the acceleration at the time
t + (α_m − α_f) Δt, the distance a − ü is scaled with Δt where that changes, which keeps the order.
"""

from __future__ import annotations

from collections.abc import Sequence
from weakref import WeakKeyDictionary, ref

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import dolfinx
import dolfinx.fem.petsc
import ufl
from ufl.algorithms.analysis import extract_coefficients
from ufl.core.expr import Expr

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.fem.assembly import assemble_owned
from dolfinx_feti.mechanics.supports import DASHPOTS
from dolfinx_feti.mechanics.values import require_positive, require_within
from dolfinx_feti.runtime.arrays import Array, Indices

__all__ = ["Motion", "fixed_dofs", "motions_in"]


#: Of the mass matrix' own solve, which a Jacobi preconditioner serves.
MASS_RTOL, MASS_ITERATIONS = 1e-12, 500


class Motion:
    """Inertia and velocities of a displacement.

    Example::

        motion = Motion(u, density=1e-6)  # kg/mm³, with mm, kPa and s
        problem = NonlinearProblem(energy + motion.inertia, u, bcs=bcs)
        follow_time(problem, motion, set_time, [0.1], TimeSteps(first=1e-3, least=1e-5), state=[u])

    Attributes:
        u: The displacement.
        velocity: v of the last state, a Function; an initial velocity is set here.
        acceleration: ü of the last state, a Function, with which forces are in balance.
        filtered: a of the last state, a Function.
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
            rho: Spectral radius ρ_∞, from 0, which damps high frequencies in a step, to 1.

        Raises:
            ValueError: ``rho`` is not between 0 and 1, or ``density`` not positive.
        """
        require_within(0.0, 1.0, {"rho": rho}, remedy="a spectral radius between 0 and 1", sign="=")
        require_positive(density=density)
        V = u.function_space
        self.u = u
        self.velocity = dolfinx.fem.Function(V, name="velocity")
        self.acceleration = dolfinx.fem.Function(V, name="acceleration")
        self.filtered = dolfinx.fem.Function(V, name="filtered_acceleration")
        self.dt, self._c, self._d = (
            dolfinx.fem.Constant(V.mesh, np.float64(0.0)) for _ in range(3)
        )
        self._ahead, self._behind = dolfinx.fem.Function(V), dolfinx.fem.Function(V)  # ũ, û
        self._α_m, self._α_f = (2.0 * rho - 1.0) / (rho + 1.0), rho / (rho + 1.0)
        self._γ = 0.5 - self._α_m + self._α_f
        self._β = 0.25 * (1.0 - self._α_m + self._α_f) ** 2
        self._last: Array = u.x.array.copy()  # u_n
        self._free: Array = self._last  # u_{n+1} without a_{n+1}
        self._dashpots: list[tuple[dolfinx.fem.Function, dolfinx.fem.Constant]] = []
        self._density = density
        difference, v = u - self._ahead, self.velocity
        self.inertia = density * self._c / 2 * ufl.inner(difference, difference) * ufl.dx
        self.rate = self._d * (u - self._behind)
        self._kinetic = dolfinx.fem.form(density / 2 * ufl.inner(v, v) * ufl.dx)
        MOTIONS[self._ahead] = ref(self)

    @property
    def changes(self) -> list[dolfinx.fem.Function]:
        """The Functions that a restart needs, beside u."""
        return [self.velocity, self.acceleration, self.filtered]

    @property
    def numbers(self) -> list[dolfinx.fem.Constant]:
        """The Constants that a step changes, those of the dashpots that it drives among them."""
        return [self.dt, self._c, self._d, *(time_step for _, time_step in self._dashpots)]

    def drive(self, coefficients: Sequence[dolfinx.fem.Function]) -> None:
        """Let dashpots of this displacement, by Functions of the forms, resist its velocity.

        Raises:
            ValueError: The time step of a dashpot is a number, or its displacement another one.
        """
        self._dashpots = []
        for last, found in ((f, dashpot) for f in coefficients for dashpot in DASHPOTS.get(f, ())):
            if found.u is not self.u or not isinstance(found.time_step, dolfinx.fem.Constant):
                raise ValueError(
                    "A dashpot of another displacement, or with a number as its time step, cannot "
                    "follow the motion: give it the displacement of the Motion and a Constant."
                )
            self._dashpots.append((last, found.time_step))

    def stop(self) -> None:
        """Leave inertia and rates out, for equilibria."""
        self._c.value = self._d.value = 0.0
        for _, time_step in self._dashpots:
            time_step.value = np.inf

    def hold(self) -> None:
        """Let inertia and rates be those of the last state, with the present u."""
        c, d = float(self._c.value), float(self._d.value) or 1.0
        ahead = self.acceleration.x.array / c if c > 0.0 else 0.0
        self._ahead.x.array[:] = self.u.x.array - ahead
        self._set_rate(d, self.u.x.array - self.velocity.x.array / d)

    def start(self, residual: dolfinx.fem.Form, bcs: Sequence[dolfinx.fem.DirichletBC]) -> None:
        """Let the initial acceleration balance the forces, those of dashpots too, M ü = −F(u, v).

        Dofs under conditions keep the acceleration that they have. A density that is not positive
        is a ConvergenceError. Collective.
        """
        V, ü = self.u.function_space, self.acceleration
        fixed = fixed_dofs(bcs)
        given = ü.x.array[fixed].copy()
        ü.x.array[:] = 0.0
        self._c.value = 0.0
        self.hold()
        ü.x.array[fixed] = given
        test, trial = ufl.TestFunction(V), ufl.TrialFunction(V)
        mass = self._density * ufl.inner(trial, test) * ufl.dx
        M = dolfinx.fem.petsc.assemble_matrix(dolfinx.fem.form(mass), list(bcs))
        M.assemble()
        f, a = M.createVecs()
        owned = f.getLocalSize()
        f.array[:] = -assemble_owned(residual) - assemble_owned(
            dolfinx.fem.form(ufl.action(mass, ü))
        )
        f.array[fixed[fixed < owned]] = given[fixed < owned]
        ksp = PETSc.KSP().create(M.comm)
        ksp.setOperators(M)
        ksp.setType("cg")
        ksp.getPC().setType("jacobi")
        ksp.setTolerances(rtol=MASS_RTOL, max_it=MASS_ITERATIONS)
        ksp.solve(f, a)
        converged = ksp.getConvergedReason() > 0
        ü.x.array[:owned] = a.array_r
        ü.x.scatter_forward()
        self.filtered.x.array[:] = ü.x.array
        self.dt.value = 0.0
        for owned_object in (ksp, M, f, a):
            owned_object.destroy()
        if not converged:
            raise ConvergenceError(
                "The mass matrix could not be solved with for the initial acceleration: give a "
                "positive density in all cells."
            )

    def enter(self, dt: float) -> None:
        """Enter a step of the length Δt: let u be what is looked for, beginning with u_n."""
        v, ü, u = (f.x.array for f in (self.velocity, self.acceleration, self.u))
        α_m, α_f, β, γ, last = self._α_m, self._α_f, self._β, self._γ, float(self.dt.value)
        a = self.filtered.x.array
        a[:] = ü + (dt / last if last > 0.0 else 1.0) * (a - ü)
        c = (1.0 - α_m) / ((1.0 - α_f) * β * dt**2)
        d = γ / (β * dt)
        self.dt.value, self._c.value = dt, c
        self._last, self._free = u.copy(), u + dt * v + dt**2 * (0.5 - β) * a
        self._ahead.x.array[:] = self._free - (α_m * a - α_f * ü) / ((1.0 - α_f) * c)
        self._set_rate(d, self._free - (v + dt * (1.0 - γ) * a) / d)

    def predict(self) -> None:
        """Let the iteration begin where a constant acceleration leads."""
        v, a, dt = self.velocity.x.array, self.filtered.x.array, float(self.dt.value)
        self.u.x.array[:] = self._last + dt * v + dt**2 / 2.0 * a

    def error(self) -> float:
        """Return the largest estimated error of u in this step, (β − 1/6) Δt² (a_{n+1} − a_n).

        Collective. Source: Zienkiewicz and Xie 1991.
        """
        change = np.abs(self._next() - self.filtered.x.array).max(initial=0.0)
        largest = self.u.function_space.mesh.comm.allreduce(change, op=MPI.MAX)
        return abs(self._β - 1.0 / 6.0) * float(self.dt.value) ** 2 * largest

    def leave(self) -> Array:
        """Go to the end of the step, t_{n+1}; return u_{n+1} − u_n, with ghosts."""
        a, dt, γ = self._next(), float(self.dt.value), self._γ
        self.velocity.x.array[:] += dt * ((1.0 - γ) * self.filtered.x.array + γ * a)
        self.acceleration.x.array[:] = float(self._c.value) * (self.u.x.array - self._ahead.x.array)
        self.filtered.x.array[:] = a
        return self.u.x.array - self._last

    def kinetic_energy(self) -> float:
        """Return ½ ∫ ρ v². Collective."""
        comm = self.u.function_space.mesh.comm
        return float(comm.allreduce(dolfinx.fem.assemble_scalar(self._kinetic)))

    def damping_form(self, residual: ufl.Form) -> ufl.Form:
        """Return the integrals of a residual in which the velocity is."""
        rates = {self._behind, *(last for last, _ in self._dashpots)}
        parts = [i for i in residual.integrals() if not rates.isdisjoint(extract_coefficients(i))]
        return ufl.Form(parts)

    def damping(self, residual: dolfinx.fem.Form | None) -> Array:
        """Return the present forces of dashpots, F(u, v) − F(u, 0), (owned,). Collective."""
        if residual is None:
            dofmap = self.u.function_space.dofmap
            return np.zeros(dofmap.index_map.size_local * dofmap.index_map_bs)
        whole = assemble_owned(residual)
        behind, d = self._behind.x.array.copy(), float(self._d.value)
        self._set_rate(d, self.u.x.array)
        elastic = assemble_owned(residual)
        self._set_rate(d, behind)
        return whole - elastic

    def _next(self) -> Array:
        """Return a_{n+1}."""
        return np.asarray((self.u.x.array - self._free) / (self._β * float(self.dt.value) ** 2))

    def _set_rate(self, d: float, behind: Array) -> None:
        """Let d (u − û) be the velocity, and that of dashpots, (u − u⁰)/Δt, too."""
        self._d.value, self._behind.x.array[:] = d, behind
        for last, time_step in self._dashpots:
            last.x.array[:], time_step.value = behind, 1.0 / d


def fixed_dofs(bcs: Sequence[dolfinx.fem.DirichletBC]) -> Indices:
    """Return the dofs under conditions, ghosts included."""
    return np.unique(
        np.concatenate([np.empty(0, dtype=np.int32), *(bc.dof_indices()[0] for bc in bcs)])
    )


#: Each motion by the ũ in its inertia, by which the forms of a problem tell that they have it.
MOTIONS: WeakKeyDictionary[dolfinx.fem.Function, ref[Motion]] = WeakKeyDictionary()


def motions_in(coefficients: Sequence[dolfinx.fem.Function]) -> list[Motion]:
    """Return the motions whose inertia is in forms with these Functions."""
    found = (MOTIONS[f]() for f in coefficients if f in MOTIONS)
    return [motion for motion in found if motion is not None]
