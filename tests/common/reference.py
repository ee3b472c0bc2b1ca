# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A dense reference: the FETI methods in a few lines of numpy, each as it is defined.

It shares no line with the package: B from the copies, K⁺ as Moore–Penrose inverse, the kernel from
an SVD, the projector with Q = I, plain conjugate gradients.
"""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt
import scipy.linalg

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.integer]


def jumps(to_global: Indices, dirichlet: npt.NDArray[np.bool_], *, all_floating: bool) -> Array:
    """Form the jump operator, (m, n): differences of copies, then Dirichlet rows.

    Args:
        to_global: Dof of each torn one, (n,).
        dirichlet: Which *dofs* have a prescribed value, (dofs,).
        all_floating: Whether each copy of a Dirichlet dof has a row.
    """
    rows = []
    unit = np.eye(len(to_global))
    for dof in np.flatnonzero(~dirichlet):
        copies = np.flatnonzero(to_global == dof)
        rows += [unit[i] - unit[j] for i, j in itertools.combinations(copies, 2)]
    if all_floating:
        rows += [unit[i] for i in np.flatnonzero(dirichlet[to_global])]
    return np.array(rows).reshape(-1, len(to_global))


def feti(K: Array, f: Array, B: Array, c: Array, *, rtol: float = 1e-12) -> tuple[Array, Array]:
    """Solve K u + Bᵀλ = f, B u = c by the projected method of the paper; return u and λ."""
    R = scipy.linalg.null_space(K, rcond=1e-10)
    Kp = np.linalg.pinv(K, rcond=1e-10, hermitian=True)
    F, d = B @ Kp @ B.T, B @ Kp @ f - c
    G, e = B @ R, R.T @ f
    N = np.linalg.pinv(G.T @ G, hermitian=True)
    P = np.eye(len(B)) - G @ N @ G.T
    scale = np.linalg.norm(F @ (G @ N @ e)) + np.linalg.norm(d)
    lam = conjugate_gradients(P @ F @ P, P @ (d - F @ (G @ N @ e)), atol=rtol * scale) + G @ N @ e
    alpha = N @ G.T @ (F @ lam - d)
    return Kp @ (f - B.T @ lam) + R @ alpha, lam


def conjugate_gradients(A: Array, b: Array, *, atol: float) -> Array:
    """Solve A x = b for a symmetric positive semidefinite A and b in its range."""
    x, r = np.zeros_like(b), b.copy()
    p, rho = r.copy(), r @ r
    for _ in range(10 * len(b)):
        if rho <= atol**2:
            break
        q = A @ p
        alpha = rho / (p @ q)
        x, r = x + alpha * p, r - alpha * q
        rho, old = r @ r, rho
        p = r + rho / old * p
    return x
