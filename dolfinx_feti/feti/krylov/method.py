# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Krylov methods: CG where the system is positive definite, GMRES otherwise.

Conjugate gradients are safe as long as the dual system is positive definite on the balanced pairs
(λ, s), that is if neither a regularised subdomain nor the defect D has a negative eigenvalue
(``definite``); otherwise GMRES takes over. ``stopping`` decides when they end.

The coefficients of CG are those of Lanczos' method. Rounding makes its vectors lose their
orthogonality to the eigenvectors that have converged: copies of these appear (ghosts), and
iterations are spent on them. PETSc's flexible CG (``feti_dual_ksp_type fcg``) makes each direction
F-orthogonal to all earlier ones, and so needs two vectors for each iteration.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.events import event
from dolfinx_feti.feti.krylov.deflation import RitzVectors
from dolfinx_feti.feti.krylov.stopping import KrylovSystem, Monitor, StoppingTest
from dolfinx_feti.petsc_options import inserted

__all__ = ["Method", "Solution", "choose_method", "solve"]

Array = npt.NDArray[np.float64]

#: Methods that precondition nothing but their residuals.
CG = ("cg", "fcg", "pipecg")

#: Methods for symmetric systems.
SYMMETRIC = (*CG, "minres", "symmlq")

#: Vectors that GMRES keeps before it begins anew.
RESTART = 200


@dataclass(frozen=True, slots=True)
class Method:
    """A Krylov method as the options have it.

    Attributes:
        type: PETSc's name of it.
        prefix: Options prefix, ``…feti_dual_``.
        stagnation: Iterations without a new least residual that end a solve; 0 for no end.
        users_test: Whether the user's own ``ksp_rtol`` or ``ksp_atol`` decides, not the residual of
            the assembled system.
    """

    type: str
    prefix: str
    stagnation: int
    users_test: bool

    @property
    def is_cg(self) -> bool:
        """Whether the preconditioner is only applied to residuals."""
        return self.type in CG

    @property
    def is_symmetric(self) -> bool:
        """Whether the method takes the system to be symmetric."""
        return self.type in SYMMETRIC


@dataclass(frozen=True, slots=True)
class Solution:
    """The outcome of a solve.

    Attributes:
        x: Local part of the best iterate.
        reason: PETSc's converged reason.
        iterations: Number of iterations.
        eigenvalues: Extreme Ritz values of CG, (λ_min, λ_max); nan for other methods.
        ritz_vectors: What a solve in the primal form leaves to later ones.
    """

    x: Array
    reason: int
    iterations: int
    eigenvalues: tuple[float, float]
    ritz_vectors: RitzVectors | None = None


def choose_method(comm: MPI.Comm, *, definite: bool, prefix: str, stagnation: int) -> Method:
    """Read the choice of a Krylov method from the options.

    Args:
        comm: Communicator of the system.
        definite: Whether CG is safe.
        prefix: Options prefix.
        stagnation: Iterations without a new least residual that end a solve; 0 for no end.

    Raises:
        PETSc.Error: The options ask for a method that PETSc does not have.

    Note:
        Collective.
    """
    own = PETSc.Options(prefix)
    ksp = _create_ksp(comm, "cg" if definite else "gmres", prefix, directions=1)
    kind = ksp.getType()
    ksp.destroy()
    users_test = any(own.hasName(f"ksp_{key}") for key in ("rtol", "atol"))
    return Method(kind, prefix, stagnation, users_test)


def solve(
    system: KrylovSystem,
    b: Array,
    method: Method,
    *,
    target: float,
    max_it: int,
    monitor: Monitor,
) -> Solution:
    """Solve 𝒜 x = b.

    Args:
        system: The system with its preconditioner.
        b: Local part of the right-hand side.
        method: The Krylov method.
        target: Wanted norm of the residual of the assembled system.
        max_it: Most iterations.
        monitor: Called with (iteration, norm of the residual of the assembled system).

    Returns:
        The solution, with the converged reason.

    Note:
        Collective.
    """
    first, rest = system.start(b)
    context = _Context(system)
    ksp = _create_ksp(system.comm, method.type, method.prefix, directions=max_it)
    mat = PETSc.Mat().createPython(((system.size, None),) * 2, context, comm=system.comm)
    mat.setUp()
    ksp.setOperators(mat)
    ksp.getPC().setPythonContext(context)
    rhs, x = mat.createVecs()
    rhs.array[:] = rest
    test = StoppingTest(
        system,
        lambda: context.norm,
        target=target,
        stagnation=method.stagnation,
        max_it=max_it,
        cg=method.is_cg,
        first=_proportion(system, rest, rhs.norm(), method),
        monitor=monitor,
    )
    if method.users_test:
        ksp.setTolerances(max_it=min(max_it, ksp.getTolerances()[3]))
        ksp.setMonitor(lambda _ksp, its, rnorm: test.measure(its, rnorm))
    else:
        ksp.setTolerances(max_it=max_it)
        ksp.setConvergenceTest(test)
    with event("FETIIterations"):
        ksp.solve(rhs, x)
    reason = ksp.getConvergedReason()
    found = x.array_r if reason > 0 or test.best is None else test.best
    its = ksp.getIterationNumber()
    ritz = _ritz_values(ksp) if method.is_cg and its > 0 else (np.nan, np.nan)
    solution = Solution(first + found, reason, its, ritz)
    for owned in (ksp, mat, rhs, x):
        owned.destroy()
    return solution


class _Context:
    """The system as PETSc calls it: context of a Mat and of a PC.

    Attributes:
        norm: Residual of the assembled system that the vector which was last preconditioned leaves.
    """

    def __init__(self, system: KrylovSystem) -> None:
        self._system = system
        self.norm = np.inf

    def mult(self, _mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        y.array[:] = self._system.multiply(x.array_r)

    def apply(self, _pc: PETSc.PC, r: PETSc.Vec, z: PETSc.Vec) -> None:
        z.array[:], self.norm = self._system.precondition(r.array_r)


def _create_ksp(comm: MPI.Comm, kind: str, prefix: str, *, directions: int) -> PETSc.KSP:
    """Create a KSP with the user's options; flexible CG keeps so many directions by default."""
    ksp = PETSc.KSP().create(comm)
    ksp.setOptionsPrefix(prefix)
    ksp.setType(kind)
    ksp.setGMRESRestart(RESTART)
    ksp.getPC().setType(PETSc.PC.Type.PYTHON)
    ksp.setComputeSingularValues(True)
    full = {} if PETSc.Options(prefix).hasName("ksp_fcg_mmax") else {"ksp_fcg_mmax": directions}
    with inserted(prefix, full):
        ksp.setFromOptions()
    if ksp.getType() in ("gmres", "fgmres"):
        ksp.setPCSide(PETSc.PC.Side.RIGHT)  # its residual then is the jump
    return ksp


def _proportion(system: KrylovSystem, r: Array, norm: float, method: Method) -> float:
    """Return the proportion of the residual of the assembled system to the method's own norm."""
    return system.unbalanced(r) / norm if norm and not method.is_cg else 0.0


def _ritz_values(ksp: PETSc.KSP) -> tuple[float, float]:
    """Return the extreme Ritz values; nan if CG has met a NaN."""
    try:
        high, low = ksp.computeExtremeSingularValues()
    except PETSc.Error:  # LAPACK does not accept the coefficients
        return np.nan, np.nan
    return low, high
