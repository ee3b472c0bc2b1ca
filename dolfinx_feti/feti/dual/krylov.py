# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Krylov methods of the dual form: CG where the system is positive definite, GMRES otherwise.

CG is safe if neither a regularised subdomain nor the defect D has a negative eigenvalue; see
``stopping`` for their end.
"""

from __future__ import annotations

from types import SimpleNamespace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.dual.stopping import StoppingTest
from dolfinx_feti.feti.dual.system import DualSystem
from dolfinx_feti.feti.solution import CURVATURE, RESTART, Monitor, Solution
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.runtime.petsc_options import inserted

__all__ = ["CG", "choose_method", "has_own_test", "solve"]


#: Methods that precondition nothing but their residuals.
CG = ("cg", "fcg", "pipecg")


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
        test = StoppingTest(
            system,
            target=target,
            max_it=max_it,
            cg=is_cg,
            first=system.unbalanced(b) / norm if norm and not is_cg else 0.0,
            monitor=monitor,
        )
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
        small = reason == PETSc.KSP.ConvergedReason.CONVERGED_RTOL
        best = x.array_r.copy() if small or test.best is None else test.best
        if reason in CURVATURE:
            best = _completed(system, b, x.array_r, best)
        its = ksp.getIterationNumber()
        ritz = _ritz_values(ksp) if is_cg and its > 0 else (np.nan, np.nan)
        return best, Solution(reason, its, ritz)


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
