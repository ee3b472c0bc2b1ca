# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""An energy is edited twice in one session: the second edit compiles nothing."""

from __future__ import annotations

import random

import cffi
import numpy as np
import pytest
from collective import COMM, agree, small
from problems import cube, dirichlet, free_residual, left

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem


def density(u: dolfinx.fem.Function, edit: int) -> ufl.core.expr.Expr:
    """Rubber with fibres that do not push; the second edit adds a term and changes the numbers."""
    c = 3.0 + COMM.bcast(random.random())  # no cache has the forms
    F = ufl.Identity(2) + ufl.grad(u)
    C, J = F.T * F, ufl.det(F)
    a = ufl.as_vector([0.8, 0.6])
    E = ufl.dot(a, C * a) - 1
    psi = c / 2 * (ufl.tr(C) - 2 - 2 * ufl.ln(J)) + 20.0 * ufl.ln(J) ** 2
    psi += ufl.conditional(ufl.gt(E, 0.0), c * (ufl.exp(0.8 * E**2) - 1), 0.0)
    return psi if edit == 1 else psi + ufl.cosh(2.0 * (ufl.tr(C) - 2)) - 1


@pytest.mark.parametrize("given", ["residual", "energy"])
def test_second_edit_compiles_nothing(given, monkeypatch):
    """Each form of an edit is analysed once, and both are at equilibrium in dolfinx's residual."""
    compiled: list[object] = []
    analysed: list[ufl.Form] = []
    compile_c, analyse = cffi.FFI.compile, ufl.algorithms.compute_form_data
    monkeypatch.setattr(
        cffi.FFI, "compile", lambda *a, **known: compiled.append(a) or compile_c(*a, **known)
    )
    monkeypatch.setattr(
        ufl.algorithms,
        "compute_form_data",
        lambda form, **known: analysed.append(form) or analyse(form, **known),
    )
    mesh = cube(2, 3)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    u, bc = dolfinx.fem.Function(V), dirichlet(V, left)
    load = dolfinx.fem.Constant(mesh, (0.2, 0.3))
    for edit in (1, 2):
        energy = density(u, edit) * ufl.dx(degree=4) - ufl.inner(load, u) * ufl.ds
        F = ufl.derivative(energy, u, ufl.TestFunction(V))
        compiled.clear()
        analysed.clear()
        problem = NonlinearProblem(
            energy if given == "energy" else F,
            u,
            bcs=[bc],
            subdomains=4,
            petsc_options={"snes_rtol": 1e-10},
        )
        problem.solve()
        calls = COMM.allreduce(len(compiled))
        agree(edit == 1 or calls == 0, f"{calls} calls of the C compiler")
        kinds = [{i.integral_type() for i in form.integrals()} for form in analysed]
        cells = sum("cell" in kind for kind in kinds)
        agree(cells == (3 if given == "energy" else 2), kinds)
        small(np.divide(*free_residual(F, [bc])), 1e-8)
        agree(COMM.allreduce(len(compiled)) > calls, "a cache has the residual")
