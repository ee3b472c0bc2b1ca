# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Motion with inertia: the generalised-α method in the form of Arnold and Brüls (2007).

Forces are balanced at the end of a step, by the acceleration ü there, and Newmark's formulas take
another one, the algorithmic acceleration a, which follows ü with the numerical damping of Chung and
Hulbert (1993):

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

The factors c and d are Constants of the user's forms (:class:`InertiaFactor`,
:class:`RateFactor`), where a path finds them. So ``follow_load`` can stop inertia and velocities in
forms whose Motion no longer exists. For this reason the factors own all that is to be stopped.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

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
from dolfinx_feti.mechanics.supports import DashpotFactor, dashpots_in
from dolfinx_feti.runtime.arrays import Array, Indices
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.runtime.values import require_positive, require_within

__all__ = ["Motion", "dirichlet_dofs", "stop_motions"]

#: Relative tolerance of the solve with the mass matrix for the initial acceleration: far below that
#: of Newton's method, as the solve is cheap (CG with Jacobi's preconditioner, once a path).
MASS_RTOL = 1e-12

#: Largest number of iterations of that solve. The condition number of a mass matrix, scaled by its
#: diagonal, does not depend on the mesh size (Wathen 1987), and a few dozen iterations are enough:
#: more mean a density that is not positive.
MASS_MAX_ITERATIONS = 500


@dataclass(frozen=True, slots=True)
class DrivenDashpot:
    """Function and Constant that a motion sets, so that a dashpot's (w − w⁰)/Δt is the velocity."""

    last: dolfinx.fem.Function  # w⁰
    time_step: dolfinx.fem.Constant  # Δt [s]


class RateFactor(dolfinx.fem.Constant):
    """The factor d in a velocity d (u − û); zero in equilibria.

    Attributes:
        reference: û, a Function in the space of u.
        dashpots: Dashpots whose rate is that velocity: their last displacement is û and their time
            step 1/d.
    """

    def __init__(self, V: dolfinx.fem.FunctionSpace) -> None:
        """Create the factor of a body at rest, without dashpots.

        Args:
            V: Space of u.
        """
        super().__init__(V.mesh, np.float64(0.0))
        self.reference = dolfinx.fem.Function(V)
        self.dashpots: list[DrivenDashpot] = []

    def set(self, d: float, reference: Array) -> None:
        """Set the velocity to d (u − û).

        Args:
            d: Factor [1/s], positive.
            reference: Values of û, with ghosts.
        """
        self.value = d
        self.reference.x.array[:] = reference
        for dashpot in self.dashpots:
            dashpot.last.x.array[:] = reference
            dashpot.time_step.value = 1.0 / d

    def stop(self) -> None:
        """Set the velocity to zero, and detach the dashpots, which then do not resist."""
        self.value = 0.0
        for dashpot in self.dashpots:
            dashpot.time_step.value = np.inf
        self.dashpots = []


class InertiaFactor(dolfinx.fem.Constant):
    """The factor c in the inertia ½ ∫ ρ c (u − ũ)², zero in equilibria.

    Attributes:
        rate: d of the same motion.
    """

    def __init__(self, rate: RateFactor) -> None:
        """Create the factor of a body at rest."""
        super().__init__(rate.ufl_domain(), np.float64(0.0))
        self.rate = rate

    def stop(self) -> None:
        """Set inertia and velocity in the forms to zero."""
        self.value = 0.0
        self.rate.stop()


class Motion:
    """Inertia and velocities of a displacement.

    In each step ``follow_time`` calls :meth:`begin_step`, sets the loads, calls :meth:`predict`,
    solves, and calls :meth:`error_of_step` and :meth:`end_step`, in this order. If the step fails,
    it restores the last state and calls :meth:`set_to_last_state`.

    Example::

        from dolfinx_feti.loading import TimeSteps, follow_time

        motion = Motion(u, density=1e-6)  # kg/mm³, with mm, kPa and s
        problem = NonlinearProblem(energy + motion.inertia, u, bcs=bcs)
        steps = TimeSteps(first=1e-3, least=1e-5)
        follow_time(problem, motion, lambda time: set_load(100.0 * time), [2e-3], steps)

    Attributes:
        u: The displacement.
        velocity: v of the last state, a Function; an initial velocity is set here.
        acceleration: ü of the last state, a Function, with which forces are in balance.
        algorithmic_acceleration: a of the last state, a Function.
        dt: Δt, a Constant, for materials whose memory fades with time.
        inertia: Form ½ ∫ ρ c (u − ũ)², to be added to an energy; its derivative is added to a
            residual, and its second derivative to a tangent.
        rate: The velocity as an expression in u, d (u − û), for damping forces.
    """

    def __init__(self, u: dolfinx.fem.Function, density: float | Expr, *, rho: float = 0.8) -> None:
        """Create the motion of a body at rest.

        Args:
            u: The displacement.
            density: Mass per reference volume, ρ in the formulas; in kg/mm³ with mm, kPa and s.
            rho: Spectral radius ρ_∞ at high frequencies, from 0, which damps them in a step, to 1,
                which does not damp them.

        Raises:
            ValueError: ``rho`` is not between 0 and 1, or ``density`` not positive.
        """
        spectral_radius = rho  # the letter ρ alone is the density
        require_within(0.0, 1.0, {"rho": rho}, remedy="a spectral radius between 0 and 1")
        require_positive(density=density)
        V = u.function_space
        self.u = u
        self.velocity = dolfinx.fem.Function(V, name="velocity")
        self.acceleration = dolfinx.fem.Function(V, name="acceleration")
        self.algorithmic_acceleration = dolfinx.fem.Function(V, name="algorithmic_acceleration")
        self.dt = dolfinx.fem.Constant(V.mesh, np.float64(0.0))
        self._rate_factor = RateFactor(V)  # d
        self._inertia_factor = InertiaFactor(self._rate_factor)  # c
        self._inertial_reference = dolfinx.fem.Function(V)  # ũ
        self._α_m = (2.0 * spectral_radius - 1.0) / (spectral_radius + 1.0)
        self._α_f = spectral_radius / (spectral_radius + 1.0)
        self._γ = 0.5 - self._α_m + self._α_f
        self._β = 0.25 * (1.0 - self._α_m + self._α_f) ** 2
        self._u_n: Array = u.x.array.copy()  # u_n
        self._u_explicit: Array = self._u_n  # explicit part of u_{n+1}
        self._density = density
        difference = u - self._inertial_reference
        v = self.velocity
        self.inertia = (
            density * self._inertia_factor / 2 * ufl.inner(difference, difference) * ufl.dx
        )
        self.rate = self._rate_factor * (u - self._rate_factor.reference)
        self._kinetic = dolfinx.fem.form(density / 2 * ufl.inner(v, v) * ufl.dx)

    @property
    def histories(self) -> list[dolfinx.fem.Function]:
        """The Functions that a restart needs in addition to u."""
        return [self.velocity, self.acceleration, self.algorithmic_acceleration]

    @property
    def constants(self) -> list[dolfinx.fem.Constant]:
        """The Constants that a step changes, including time steps of attached dashpots."""
        time_steps = (dashpot.time_step for dashpot in self._rate_factor.dashpots)
        return [self.dt, self._inertia_factor, self._rate_factor, *time_steps]

    def is_only_inertia_in(self, constants: Iterable[dolfinx.fem.Constant]) -> bool:
        """Return True if forms with these Constants contain this inertia, and no other one."""
        factors = [constant for constant in constants if isinstance(constant, InertiaFactor)]
        return len(factors) == 1 and factors[0] is self._inertia_factor

    def attach_dashpots(self, constants: Iterable[dolfinx.fem.Constant]) -> None:
        """Make the dashpots of forms with these Constants resist the velocity.

        Raises:
            ValueError: The time step of a dashpot is no Constant, its displacement is not u, or its
                last displacement is no Function in the space of u.
        """
        self._rate_factor.dashpots = [self._driven(dashpot) for dashpot in dashpots_in(constants)]

    def _driven(self, dashpot: DashpotFactor) -> DrivenDashpot:
        """Return the Function and the Constant to set in a dashpot.

        Raises:
            ValueError: See :meth:`attach_dashpots`.
        """
        u = dashpot.u
        last = dashpot.last
        time_step = dashpot.time_step
        if u is not self.u:
            raise ValueError(
                f"A dashpot of {u} cannot follow the motion of {self.u}: give dashpot_energy the "
                "displacement of the Motion itself."
            )
        if not isinstance(time_step, dolfinx.fem.Constant):
            raise ValueError(
                f"A dashpot with a number as its time step, time_step={time_step}, cannot follow "
                "the motion: give a dolfinx.fem.Constant, which follow_time sets."
            )
        V = self.u.function_space
        if not isinstance(last, dolfinx.fem.Function) or last.function_space != V:
            raise ValueError(
                f"A dashpot with last={last} cannot follow the motion: give a Function of its own "
                "in the space of the displacement."
            )
        return DrivenDashpot(last, time_step)

    def stop(self) -> None:
        """Set inertia and rates in the forms to zero, for equilibria."""
        self._inertia_factor.stop()

    def set_to_last_state(self) -> None:
        """Set ũ and û so that the present u has the acceleration and velocity of the last state."""
        u = self.u.x.array
        c = float(self._inertia_factor.value)
        d = float(self._rate_factor.value)
        if d == 0.0:  # before the first step: any positive d serves, as û = u − v/d gives v
            d = 1.0
        self._inertial_reference.x.array[:] = u
        if c > 0.0:
            self._inertial_reference.x.array[:] -= self.acceleration.x.array / c  # ũ = u − ü/c
        self._rate_factor.set(d, u - self.velocity.x.array / d)  # û = u − v/d

    def balance(self, residual: dolfinx.fem.Form, bcs: Sequence[dolfinx.fem.DirichletBC]) -> None:
        """Compute the initial acceleration that balances all forces, M ü = −F(u, v). Collective.

        Args:
            residual: Residual of the problem, with forces of dashpots.
            bcs: Dirichlet conditions; their dofs keep their present acceleration.

        Raises:
            ConvergenceError: The density is not positive.
        """
        ü = self.acceleration
        dofs = dirichlet_dofs(bcs)
        prescribed = ü.x.array[dofs].copy()
        # F(u, v) without inertia: c = 0, so that ũ becomes u, and û is set such that d (u − û) = v
        ü.x.array[:] = 0.0
        self._inertia_factor.value = 0.0
        self.set_to_last_state()
        ü.x.array[dofs] = prescribed
        self._solve_with_mass(residual, bcs)
        self.algorithmic_acceleration.x.array[:] = ü.x.array
        self.dt.value = 0.0

    def _solve_with_mass(
        self, residual: dolfinx.fem.Form, bcs: Sequence[dolfinx.fem.DirichletBC]
    ) -> None:
        """Set ü on the free dofs to M⁻¹ (−F(u, v) − M ü_D), with ü_D of the others. Collective.

        Raises:
            ConvergenceError: The density is not positive.
        """
        V = self.u.function_space
        ü = self.acceleration
        test = ufl.TestFunction(V)
        trial = ufl.TrialFunction(V)
        mass = self._density * ufl.inner(trial, test) * ufl.dx
        with Lifetime() as lifetime:
            M = lifetime.own(dolfinx.fem.petsc.assemble_matrix(dolfinx.fem.form(mass), list(bcs)))
            M.assemble()
            f, a = map(lifetime.own, M.createVecs())
            owned = f.getLocalSize()
            dofs = dirichlet_dofs(bcs)
            owned_dofs = dofs[dofs < owned]
            inertia = assemble_owned(dolfinx.fem.form(ufl.action(mass, ü)))  # M ü_D
            f.array[:] = -assemble_owned(residual) - inertia
            f.array[owned_dofs] = ü.x.array[owned_dofs]
            ksp = lifetime.own(PETSc.KSP().create(M.comm))
            ksp.setOperators(M)
            ksp.setType("cg")
            ksp.getPC().setType("jacobi")
            ksp.setTolerances(rtol=MASS_RTOL, max_it=MASS_MAX_ITERATIONS)
            ksp.solve(f, a)
            has_converged = ksp.getConvergedReason() > 0
            ü.x.array[:owned] = a.array_r
        ü.x.scatter_forward()
        if not has_converged:
            raise ConvergenceError(
                "The mass matrix could not be solved with for the initial acceleration: give a "
                "positive density in all cells."
            )

    def begin_step(self, dt: float) -> None:
        """Set inertia and rates for a step of the length Δt [s] from the last state, u_n.

        If Δt differs from that of the last step, a of the last state is scaled (head of the file),
        in place: a path restores it if the step fails.
        """
        u = self.u.x.array
        v = self.velocity.x.array
        ü = self.acceleration.x.array
        a = self.algorithmic_acceleration.x.array
        α_m = self._α_m
        α_f = self._α_f
        β = self._β
        γ = self._γ
        dt_before = float(self.dt.value)
        if dt_before > 0.0:
            a[:] = ü + (dt / dt_before) * (a - ü)  # a − ü is scaled with Δt
        c = (1.0 - α_m) / ((1.0 - α_f) * β * dt**2)
        d = γ / (β * dt)
        self.dt.value = dt
        self._inertia_factor.value = c
        self._u_n = u.copy()
        self._u_explicit = u + dt * v + dt**2 * (0.5 - β) * a  # u_{n+1} − β Δt² a_{n+1}
        ũ = self._u_explicit - (α_m * a - α_f * ü) / ((1.0 - α_f) * c)
        û = self._u_explicit - (v + dt * (1.0 - γ) * a) / d
        self._inertial_reference.x.array[:] = ũ
        self._rate_factor.set(d, û)

    def predict(self) -> None:
        """Set u to its value at the end of the step if the acceleration were constant."""
        v = self.velocity.x.array
        a = self.algorithmic_acceleration.x.array
        dt = float(self.dt.value)
        self.u.x.array[:] = self._u_n + dt * v + dt**2 / 2.0 * a  # u_n + Δt v_n + ½ Δt² a_n

    def error_of_step(self) -> float:
        """Return the largest estimated error of u in this step [mm]. Collective.

        It is (β − 1/6) Δt² (a_{n+1} − a_n); source: O. C. Zienkiewicz and Y. M. Xie, Earthquake
        Engineering and Structural Dynamics 20 (1991).
        """
        change = np.abs(
            self._next_algorithmic_acceleration() - self.algorithmic_acceleration.x.array
        ).max(initial=0.0)
        largest = self.u.function_space.mesh.comm.allreduce(change, op=MPI.MAX)
        return abs(self._β - 1.0 / 6.0) * float(self.dt.value) ** 2 * largest

    def end_step(self) -> Array:
        """Set v, ü and a to those of t_{n+1}; return u_{n+1} − u_n, with ghosts."""
        u = self.u.x.array
        a = self.algorithmic_acceleration.x.array
        a_next = self._next_algorithmic_acceleration()
        c = float(self._inertia_factor.value)
        dt = float(self.dt.value)
        γ = self._γ
        self.velocity.x.array[:] += dt * ((1.0 - γ) * a + γ * a_next)  # v_{n+1}
        self.acceleration.x.array[:] = c * (u - self._inertial_reference.x.array)  # ü = c (u − ũ)
        self.algorithmic_acceleration.x.array[:] = a_next
        return u - self._u_n

    def kinetic_energy(self) -> float:
        """Return ½ ∫ ρ v². Collective."""
        comm = self.u.function_space.mesh.comm
        return float(comm.allreduce(dolfinx.fem.assemble_scalar(self._kinetic)))

    def damping_form(self, residual: ufl.Form) -> ufl.Form:
        """Return the integrals of a residual that depend on the velocity."""
        references = {self._rate_factor.reference}
        references.update(dashpot.last for dashpot in self._rate_factor.dashpots)
        integrals = [
            integral
            for integral in residual.integrals()
            if not references.isdisjoint(extract_coefficients(integral))
        ]
        return ufl.Form(integrals)

    def damping(self, residual: dolfinx.fem.Form | None) -> Array:
        """Return the present forces of dashpots, F(u, v) − F(u, 0), (owned,). Collective.

        Args:
            residual: The compiled :meth:`damping_form`; None if nothing depends on the velocity.
        """
        if residual is None:
            dofmap = self.u.function_space.dofmap
            return np.zeros(dofmap.index_map.size_local * dofmap.index_map_bs)
        moving = assemble_owned(residual)  # F(u, v)
        reference = self._rate_factor.reference.x.array.copy()
        d = float(self._rate_factor.value)
        self._rate_factor.set(d, self.u.x.array)
        at_rest = assemble_owned(residual)  # F(u, 0)
        self._rate_factor.set(d, reference)
        return moving - at_rest

    def _next_algorithmic_acceleration(self) -> Array:
        """Return a_{n+1} for the present u as u_{n+1}, with ghosts."""
        return np.asarray(
            (self.u.x.array - self._u_explicit) / (self._β * float(self.dt.value) ** 2)
        )

    # -- other names of the same members, for other programs; this package does not use them -------

    hold = set_to_last_state
    start = balance
    enter = begin_step
    leave = end_step
    error = error_of_step
    drive = attach_dashpots
    is_alone_in = is_only_inertia_in
    is_only_inertia_of = is_only_inertia_in

    @property
    def filtered(self) -> dolfinx.fem.Function:
        """Another name of ``algorithmic_acceleration``."""
        return self.algorithmic_acceleration

    @property
    def changes(self) -> list[dolfinx.fem.Function]:
        """Another name of ``histories``."""
        return self.histories

    @property
    def numbers(self) -> list[dolfinx.fem.Constant]:
        """Another name of ``constants``."""
        return self.constants


def dirichlet_dofs(bcs: Sequence[dolfinx.fem.DirichletBC]) -> Indices:
    """Return the local dofs with conditions, with ghosts, sorted."""
    dofs: list[Indices] = [np.empty(0, dtype=np.int32)]
    dofs += [bc.dof_indices()[0] for bc in bcs]
    return np.unique(np.concatenate(dofs))


def stop_motions(constants: Iterable[dolfinx.fem.Constant]) -> None:
    """Set inertia and velocities of all motions to zero in forms with these Constants."""
    for constant in constants:
        if isinstance(constant, InertiaFactor | RateFactor):
            constant.stop()
