# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Newton's method in dolfinx alone: displacement and pressure in one matrix, solved by MUMPS."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from petsc4py import PETSc

import numpy as np

import basix.ufl
import dolfinx
import dolfinx.fem.petsc
import ufl

from benchmarks.published.body import Body

__all__ = ["create_newton", "solve_by_mumps"]

STEP, MOST = 1e-9, 20  # the least relative Newton step, and its most


def create_newton(
    F: ufl.Form, w: dolfinx.fem.Function, bcs: Sequence[dolfinx.fem.DirichletBC]
) -> Callable[[], None]:
    """Return what solves F(w) = 0 from the state in w, with zeros prescribed. Collective.

    It raises a RuntimeError where Newton's method does not converge.
    """
    residual, tangent = (dolfinx.fem.form(form) for form in (F, ufl.derivative(F, w)))
    A = dolfinx.fem.petsc.create_matrix(tangent)
    ksp = PETSc.KSP().create(w.function_space.mesh.comm)
    ksp.setOperators(A)
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    ksp.getPC().setFactorSolverType("mumps")
    b, x = A.createVecLeft(), A.createVecRight()
    dw = dolfinx.fem.Function(w.function_space)
    fixed = np.concatenate([bc.dof_indices()[0] for bc in bcs])

    def solve() -> None:
        for _ in range(MOST):
            A.zeroEntries()
            dolfinx.fem.petsc.assemble_matrix(A, tangent, bcs=bcs)
            A.assemble()
            r = dolfinx.fem.assemble_vector(residual)
            r.scatter_reverse(dolfinx.la.InsertMode.add)
            r.array[fixed] = 0.0
            b.array[:] = -r.array[: b.getLocalSize()]
            ksp.solve(b, x)
            dw.x.array[: x.getLocalSize()] = x.array
            dw.x.scatter_forward()
            w.x.array[:] += dw.x.array
            step, size = (
                dolfinx.la.norm(each.sub(0).collapse().x) for each in (dw, w)
            )  # of the displacement
            if step < STEP * size:
                return
        raise RuntimeError(f"MUMPS: no convergence in {MOST} Newton steps, the last {step:.0e}.")

    return solve


def solve_by_mumps(body: Body) -> None:
    """Solve from the body's state, which is replaced. Collective.

    Raises:
        RuntimeError: Newton's method does not converge.
    """
    V, Q = body.u.function_space, body.p.function_space
    elements = [space.ufl_element() for space in (V, Q)]
    W = dolfinx.fem.functionspace(V.mesh, basix.ufl.mixed_element(elements))
    w = dolfinx.fem.Function(W)
    w.sub(0).interpolate(body.u)
    w.sub(1).interpolate(body.p)
    parts, tests = ufl.split(w), ufl.TestFunctions(W)
    F = sum(
        ufl.replace(form, {body.u: parts[0], body.p: parts[1], form.arguments()[0]: test})
        for form, test in zip(body.residuals, tests, strict=True)
    )
    bcs = []
    for component, facets in body.held:
        part = W.sub(0) if component is None else W.sub(0).sub(component)
        space, _ = part.collapse()
        dofs = dolfinx.fem.locate_dofs_topological((part, space), 2, facets)
        bcs.append(dolfinx.fem.dirichletbc(dolfinx.fem.Function(space), dofs, part))
    create_newton(F, w, bcs)()
    body.u.interpolate(w.sub(0).collapse())
    body.p.interpolate(w.sub(1).collapse())
