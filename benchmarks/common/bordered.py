# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Three ways to solve a bordered system with FETI, at equal tolerances.

.. math:: K x + B s = b, \qquad C^⊤ x = d

*Elimination* is what the package does (``feti.bordered``). *Augmented* eliminates with
:math:`K_γ = K ± γ B C^⊤` in the place of K, which is definite on a stable branch, by FGMRES that
one rough FETI solve with K preconditions; γ gives both terms one size along B. *Bordered* is FGMRES
for (x, s), preconditioned by the elimination with rough FETI solves. A K that is singular is
regularised in preconditioners.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.bordered import Border, BorderedSolver, solved

__all__ = ["WAYS", "System", "Way", "measure"]

Array = npt.NDArray[np.float64]
Map = Callable[[Array], Array]

#: Tolerance of the whole system, that of a rough solve, and the most outer iterations.
RTOL, ROUGH, MOST = 1e-8, 1e-2, 60


@dataclass
class System:
    """A bordered system on one process, its matrix regularised, and the solver of that one."""

    A: PETSc.Mat
    regular: PETSc.Mat
    ksp: PETSc.KSP
    border: Border
    b: Array
    d: Array
    iterations: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        """Keep K, as a torn matrix that is singular gets springs, and its free dofs."""
        self.K = self.A if self.A is self.regular else self.A.convert("aij", PETSc.Mat())
        self.free = np.ones(len(self.b), dtype=bool)
        dirichlet = self.A.query("dirichlet")
        if dirichlet is not None:
            self.free[dirichlet.getIndices()] = False
        for columns in (self.border.B, self.border.C, self.b):
            columns[~self.free] = 0.0
        diagonal = self.K.getDiagonal()
        self.stiffness = np.abs(diagonal.array_r)

    def multiply(self, x: Array) -> Array:
        """Return K x with zeros on Dirichlet dofs."""
        v, y = self.K.createVecs()
        v.array[:] = x
        self.K.mult(v, y)
        return np.where(self.free, y.array_r, 0.0)

    def precondition(self, r: Array, rtol: float = ROUGH) -> Array:
        """Return a rough solution of K x = r."""
        if not r.any():
            return np.zeros_like(r)
        self.ksp.setTolerances(rtol=rtol)
        x = solved(self.ksp, self.regular, r)
        self.iterations += self.ksp.getPythonContext().iterations
        return x


def _eliminated(system: System) -> tuple[Array, Array]:
    system.ksp.setTolerances(rtol=RTOL)
    solver, border = BorderedSolver(), system.border
    x, s = solver.solve(system.ksp, system.A, system.b, border, system.d)
    system.iterations = solver.iterations
    return x, s


def _augmented(system: System) -> tuple[Array, Array]:
    B, C, k = system.border.B, system.border.C, system.stiffness
    γ = np.array([(c * k) @ c / (b @ c * (c @ c)) for b, c in zip(B.T, C.T, strict=True)])  # ±

    def multiply(x: Array) -> Array:
        return system.multiply(x) + B @ (γ * (C.T @ x))

    X = np.column_stack([fgmres(multiply, system.precondition, column) for column in B.T])
    y = fgmres(multiply, system.precondition, system.b + B @ (γ * system.d))
    s = np.linalg.solve(C.T @ X, C.T @ y - system.d)
    x = y - X @ s
    return x, s - γ * (system.d - C.T @ x)


def _bordered(system: System) -> tuple[Array, Array]:
    n, B, C = len(system.b), system.border.B, system.border.C
    size = np.sqrt(np.abs(np.sum(B * C, axis=0)))
    scale = size / system.stiffness.mean()  # s and d become lengths
    X = np.column_stack([system.precondition(column) for column in B.T])
    S = C.T @ X

    def multiply(z: Array) -> Array:
        x, s = z[:n], z[n:] / scale
        return np.append(system.multiply(x) + B @ s, (C.T @ x) / scale)

    def precondition(r: Array) -> Array:
        y = system.precondition(r[:n])
        s = np.linalg.solve(S, C.T @ y - scale * r[n:])
        return np.append(y - X @ s, scale * s)

    z = fgmres(multiply, precondition, np.append(system.b, system.d / scale))
    return z[:n], z[n:] / scale


def fgmres(multiply: Map, precondition: Map, b: Array) -> Array:
    """Solve by flexible GMRES without restarts, to the tolerance or the most iterations."""
    beta = np.linalg.norm(b)
    V, Z, H = [b / beta], [], np.zeros((MOST + 1, MOST))
    for j in range(MOST):
        Z.append(precondition(V[j]))
        w = multiply(Z[j])
        for _ in range(2):
            h = np.array([v @ w for v in V])
            w, H[: j + 1, j] = w - np.column_stack(V) @ h, H[: j + 1, j] + h
        H[j + 1, j] = np.linalg.norm(w)
        rhs = beta * np.eye(j + 2)[0]
        y, *_ = np.linalg.lstsq(H[: j + 2, : j + 1], rhs)
        rest = np.linalg.norm(rhs - H[: j + 2, : j + 1] @ y)
        if rest <= RTOL * beta or H[j + 1, j] == 0.0:
            break
        V.append(w / H[j + 1, j])
    return np.column_stack(Z) @ y


WAYS = {"elimination": _eliminated, "augmented": _augmented, "bordered": _bordered}


class Way(BorderedSolver):
    """Takes the place of the package's own in a problem."""

    def __init__(self, way: str) -> None:
        """Take one of :data:`WAYS`."""
        super().__init__()
        self._way = WAYS[way]

    def solve(
        self, ksp: PETSc.KSP, A: PETSc.Mat, b: Array, border: Border, d: Array
    ) -> tuple[Array, Array]:
        """Solve; see BorderedSolver."""
        tolerances = ksp.getTolerances()
        system = System(A, A, ksp, border, b.copy(), d)
        x, s = self._way(system)
        ksp.setTolerances(*tolerances)
        ksp.getPythonContext().iterations = system.iterations
        return x, s


def measure(way: str, system: System) -> dict[str, object]:
    """Return FETI's iterations, processor time and what is left of both equations, relative."""
    before = time.process_time()
    x, s = WAYS[way](system)
    seconds, B, C = time.process_time() - before, system.border.B, system.border.C
    force = np.where(system.free, system.b - system.multiply(x) - B @ s, 0.0)
    forces = np.linalg.norm(system.b) + np.linalg.norm(B, axis=0) @ np.abs(s)
    terms = np.abs(system.d) + np.linalg.norm(C, axis=0) * np.linalg.norm(x)
    return {
        "iterations": system.iterations,
        "cpu_seconds": seconds,
        "left_of_forces": float(np.linalg.norm(force) / forces),
        "left_of_scalars": float(np.max(np.abs(system.d - C.T @ x) / terms)),
    }
