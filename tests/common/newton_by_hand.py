# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Newton's method without the package: dolfinx assembles, and NumPy solves with dense matrices."""

from __future__ import annotations

import numpy as np
from collective import COMM, dense, whole

import dolfinx
import dolfinx.fem.petsc
import ufl


def newton_by_hand(
    F: ufl.Form,
    w: dolfinx.fem.Function,
    bcs: list[dolfinx.fem.DirichletBC],
    s: dolfinx.fem.Constant,
    c: ufl.Form,
) -> None:
    """Solve F(w, s; v) = 0 and c(w) = 0 for w and a scalar s.

    Each process solves with the whole matrix [K B; Cᵀ 0].

    Args:
        F: Residual.
        w: First guess with the prescribed values, and the solution.
        bcs: Dirichlet conditions.
        s: First guess of the scalar, and its solution.
        c: The equation of the scalar.
    """
    dofmap = w.function_space.dofmap
    n = dofmap.index_map.size_local * dofmap.index_map_bs
    first = COMM.scan(n) - n
    is_prescribed = np.zeros(n, dtype=bool)
    for bc in bcs:
        dofs = bc.dof_indices()[0]
        is_prescribed[dofs[dofs < n]] = True
    free = ~whole(is_prescribed)

    def vector(form: dolfinx.fem.Form) -> np.ndarray:
        b = dolfinx.fem.assemble_vector(form)
        b.scatter_reverse(dolfinx.la.InsertMode.add)
        return np.where(free, whole(b.array[:n]), 0.0)

    r = dolfinx.fem.form(F)
    J = dolfinx.fem.form(ufl.derivative(F, w))
    v = ufl.variable(s)
    by_s = [
        i.reconstruct(integrand=ufl.diff(i.integrand(), v))
        for i in ufl.replace(F, {s: v}).integrals()
    ]
    border = [dolfinx.fem.form(f) for f in (ufl.Form(by_s), ufl.derivative(c, w))]
    c = dolfinx.fem.form(c)
    for _ in range(12):
        A = dolfinx.fem.petsc.assemble_matrix(J, bcs=bcs)
        A.assemble()
        B, C = map(vector, border)
        K = np.block([[dense(A), B[:, None]], [C, 0.0]])
        A.destroy()
        rhs = -np.append(vector(r), COMM.allreduce(dolfinx.fem.assemble_scalar(c)))
        x = np.linalg.solve(K, rhs)
        w.x.array[:n] += x[first : first + n]
        w.x.scatter_forward()
        s.value = s.value + x[-1]
        if np.linalg.norm(x) <= 1e-12:
            return
    raise AssertionError(f"Newton's method by hand does not converge: {np.linalg.norm(x)}")
