# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Krylov methods of the dual form: PETSc's CG where the system is positive definite, else GMRES.

CG is safe if neither a regularised subdomain nor the defect D has a negative eigenvalue. Every
preconditioned residual tells the norm :math:`\|T^⊤ t\|` of that of the *assembled* system. CG stops
on it; where it is an estimate (``exact`` is False), and in GMRES, which knows that of the jump, the
residual is formed when it promises convergence, and every few iterations, in CG from then on.
A fresh start follows stagnation, or a residual that departs from the true one.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.dual.system import DualSystem
from dolfinx_feti.feti.solution import CURVATURE, RESTART, STAGNATION, Monitor, Solution
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.runtime.petsc_options import inserted

Reason = PETSc.KSP.ConvergedReason

#: Methods that precondition nothing but their residuals.
CG = ("cg", "fcg", "pipecg")

#: By how much the proportion of the two residuals may have fallen before GMRES measures it.
OPTIMISM = 0.1

#: Iterations between two measurements in GMRES.
INTERVAL = 10

#: Quotient of true and updated residual above which GMRES starts afresh.
DEPARTED = 2.0


def choose_method(comm: MPI.Comm, *, definite: bool, prefix: str) -> str:
    """Read PETSc's name of the method from the options; CG is safe if ``definite``. Collective."""
    ksp = _create_ksp(comm, "cg" if definite else "gmres", prefix, directions=1)
    kind = ksp.getType()
    ksp.destroy()
    return str(kind)


def has_own_test(prefix: str) -> bool:
    """Tell whether the user's own tolerance decides, not the residual of the assembled system."""
    return any(_given(prefix, f"ksp_{key}") for key in ("rtol", "atol"))


def solve(
    system: DualSystem,
    b: Array,
    method: str,
    prefix: str,
    *,
    target: float,
    max_it: int,
    monitor: Monitor,
) -> tuple[Array, Solution]:
    """Solve 𝒜 x = b to the wanted norm of the residual of the assembled system. Collective.

    ``monitor`` is called with each iteration and that norm. Returns the local part of the best
    iterate, and how the method ended.
    """
    is_cg, own_test = method in CG, has_own_test(prefix)
    with Lifetime() as owned:
        ksp = owned.own(_create_ksp(system.comm, method, prefix, directions=max_it))
        # Not the system itself: PETSc destroys its contexts, and the system outlives this solve.
        context = SimpleNamespace(mult=system.mult, apply=system.apply)
        mat = PETSc.Mat().createPython(((system.size, None),) * 2, context, comm=system.comm)
        owned.own(mat).setUp()
        ksp.setOperators(mat)
        ksp.getPC().setPythonContext(context)
        x, rhs = map(owned.own, mat.createVecs())
        rhs.array[:] = b
        norm, system.norm = rhs.norm(), np.inf
        proportion = 1.0
        if not is_cg:
            proportion = system.unbalanced(b) / norm if norm else 0.0
        next_ = np.inf if is_cg else INTERVAL
        test = _StoppingTest(system, target, max_it, is_cg, monitor, proportion, next_)
        if is_cg and not (own_test or _given(prefix, "ksp_norm_type")):
            ksp.setNormType(PETSc.KSP.NormType.NATURAL)  # of rᵀ z, which CG has
        if own_test:
            ksp.setTolerances(max_it=min(max_it, ksp.getTolerances()[3]))
            ksp.setMonitor(lambda _ksp, its, rnorm: test.measure(its, rnorm))
        else:
            ksp.setTolerances(max_it=max_it)
            ksp.setConvergenceTest(test)
        with event("FETIIterations"):
            ksp.solve(rhs, x)
        reason = ksp.getConvergedReason()
        small = reason == Reason.CONVERGED_RTOL
        best = x.array_r.copy() if small or test.best is None else test.best
        if reason in CURVATURE:
            best = _completed(system, b, x.array_r, best)
        its = ksp.getIterationNumber()
        ritz = _ritz_values(ksp) if is_cg and its > 0 else (np.nan, np.nan)
        return best, Solution(reason, its, ritz)


@dataclass(slots=True)
class _StoppingTest:
    """Convergence test of a KSP for the residual of the assembled system.

    Attributes:
        system: The dual system.
        target: Norm of the residual that is wanted.
        max_it: Iterations, at most.
        cg: Whether the preconditioner is applied to residuals alone.
        monitor: Called with each iteration and the norm.
        proportion: That of the norm to the method's own one; in CG it is known, and this is one.
        next: Iteration in which an estimated residual is measured again.
        least: The least norm, and its iteration.
        best: The iterate with the least residual, where the method has it at hand (CG); else None.
    """

    system: DualSystem
    target: float
    max_it: int
    cg: bool
    monitor: Monitor
    proportion: float
    next: float
    least: tuple[float, int] = (np.inf, 0)
    best: Array | None = None

    def measure(self, its: int, rnorm: float) -> float:
        """Return the norm of the residual of the assembled system, in GMRES an estimate."""
        if not self.cg and its == 1:
            # right preconditioning: what was applied last is the first jump, scaled to one
            self.proportion = OPTIMISM * self.system.norm
        norm = self._indicator(rnorm) * self.proportion
        self.monitor(its, norm)
        return norm

    def __call__(self, ksp: PETSc.KSP, its: int, rnorm: float) -> int:
        """Return the converged reason after an iteration."""
        norm = self.measure(its, rnorm)
        if not np.isfinite(rnorm) or np.isinf(norm):
            return Reason.DIVERGED_NANORINF
        sure = self.cg and self.system.exact
        if not sure and (norm <= self.target or its >= self.next):
            norm, departed = self._measure_again(ksp, rnorm)
            self.next = its + INTERVAL
            if departed and norm > self.target:
                return Reason.CONVERGED_ITS
        if norm <= self.target or rnorm == 0.0:
            return Reason.CONVERGED_RTOL
        if norm < self.least[0]:
            self.least = (norm, its)
            self.best = ksp.getSolution().array_r.copy() if self.cg else None
        if its - self.least[1] >= STAGNATION:
            return Reason.CONVERGED_ITS  # for a fresh start
        return Reason.DIVERGED_MAX_IT if its >= self.max_it else Reason.ITERATING

    def _measure_again(self, ksp: PETSc.KSP, rnorm: float) -> tuple[float, bool]:
        """Form the residual of the iterate; tell whether the method's own has departed from it."""
        indicator = self._indicator(rnorm)  # before another vector is preconditioned
        r = ksp.buildResidual()
        norm, true = self.system.unbalanced(r.array_r), r.norm()
        r.destroy()
        self.proportion = norm / indicator if indicator > 0.0 else 0.0
        own = not self.cg and ksp.getNormType() == PETSc.KSP.NormType.UNPRECONDITIONED
        return norm, own and true > DEPARTED * rnorm

    def _indicator(self, rnorm: float) -> float:
        """Return what is known of the residual without a further product."""
        return self.system.norm if self.cg else rnorm


def _completed(system: DualSystem, b: Array, x: Array, best: Array) -> Array:
    """Return x + z, if its residual is less than that of the best iterate. Collective.

    As r·z = ‖r − G w‖²_Q + w·D w, CG breaks down where a motion w without stiffness is all that is
    missing, as between subdomains in a row.
    """
    z, _ = system.precondition(b - system.multiply(x))
    left = [system.unbalanced(b - system.multiply(each)) for each in (x + z, best)]
    return x + z if left[0] < left[1] else best


def _create_ksp(comm: MPI.Comm, kind: str, prefix: str, *, directions: int) -> PETSc.KSP:
    """Create a KSP with the user's options; flexible CG keeps so many directions by default."""
    ksp = PETSc.KSP().create(comm)
    ksp.setOptionsPrefix(prefix)
    ksp.setType(kind)
    ksp.setGMRESRestart(RESTART)
    ksp.getPC().setType(PETSc.PC.Type.PYTHON)
    ksp.setComputeSingularValues(True)
    usual = {} if _given(prefix, "ksp_fcg_mmax") else {"ksp_fcg_mmax": directions}
    with inserted(prefix, usual):
        ksp.setFromOptions()
    if ksp.getType() in ("gmres", "fgmres"):
        ksp.setPCSide(PETSc.PC.Side.RIGHT)  # its residual then is the jump
    return ksp


def _given(prefix: str, name: str) -> bool:
    """Tell whether the user's options have one of this name."""
    return bool(PETSc.Options(prefix).hasName(name))


def _ritz_values(ksp: PETSc.KSP) -> tuple[float, float]:
    """Return the extreme Ritz values; nan if CG has met a NaN."""
    try:
        high, low = ksp.computeExtremeSingularValues()
    except PETSc.Error:  # LAPACK does not accept the coefficients
        return np.nan, np.nan
    return low, high
