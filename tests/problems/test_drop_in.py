# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Scripts written for dolfinx, in ``drop_in/``, run with the two documented changes."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from petsc4py import PETSc

import numpy as np
from collective import COMM, agree, lu_solve, norm, small
from mixed import by_place
from problems import owned

import dolfinx
import dolfinx.fem.petsc
import ufl

import dolfinx_feti

SCRIPTS = Path(__file__).parent / "drop_in"

#: From 0.10, dolfinx's NonlinearProblem has a solver, and its LinearProblem takes a prefix.
RECENT = hasattr(dolfinx.fem.petsc, "NewtonSolverNonlinearProblem")


def run(text: str) -> SimpleNamespace:
    """Run a script; return its names. Options that dolfinx has left behind are removed."""
    names: dict[str, Any] = {"__name__": "script"}
    before = PETSc.Options().getAll()
    exec(compile(text, "script", "exec"), names)
    for key in PETSc.Options().getAll().keys() - before.keys():
        PETSc.Options().delValue(key)
    return SimpleNamespace(**names)


def original(name: str) -> str:
    """Return a script for the dolfinx that is here: 0.9 takes no prefix."""
    text = (SCRIPTS / f"{name}.py").read_text(encoding="utf-8")
    return text if RECENT else re.sub(r" *petsc_options_prefix=.*\n", "", text)


def changed(name: str) -> str:
    """Return a script with its import and its call changed, one line each."""
    text = (SCRIPTS / f"{name}.py").read_text(encoding="utf-8")
    text, imports = re.subn("from dolfinx.fem.petsc import", "from dolfinx_feti import", text)
    text, calls = re.subn(r"( *)(petsc_options_prefix=)", r"\1subdomains=8, \2", text)
    agree(imports == calls == 1)
    return text


def difference(u: dolfinx.fem.Function, v: dolfinx.fem.Function) -> float:
    """Return ‖u − v‖/‖v‖ of functions on meshes that were made alike, but distributed anew."""
    here, there = by_place(u), by_place(v)
    return float(np.linalg.norm(here - there) / np.linalg.norm(there))


def test_linear_script(caplog):
    expected = run(original("elasticity")).uh
    found = run(changed("elasticity"))
    small(difference(found.uh, expected), 1e-6)
    agree(isinstance(found.problem, dolfinx_feti.LinearProblem))
    texts = [record.message for record in caplog.records]
    agree(len(texts) == (COMM.rank == 0) and all("Without effect: -" in t for t in texts), texts)


def test_nonlinear_script():
    found = run(changed("tutorial"))
    small(correction(found.residual, found.u, found.bcs), 1e-7)
    agree(isinstance(found.problem, dolfinx_feti.NonlinearProblem))
    if RECENT:
        small(difference(found.uh, run(original("tutorial")).uh), 1e-6)


def correction(F: ufl.Form, u: dolfinx.fem.Function, bcs: list[dolfinx.fem.DirichletBC]) -> float:
    """Return ‖ΔU‖/‖U‖ of a Newton step by LU, assembled by dolfinx without the package."""
    r = dolfinx.fem.assemble_vector(dolfinx.fem.form(F))
    r.scatter_reverse(dolfinx.la.InsertMode.add)
    gap = np.zeros_like(r.array)
    for bc in bcs:
        bc.set(r.array, u.x.array, -1.0)
        bc.set(gap, u.x.array, -1.0)
    small(norm(gap[: len(owned(u))]), 1e-10)  # the conditions hold, nothing is to be lifted
    A = dolfinx.fem.petsc.assemble_matrix(dolfinx.fem.form(ufl.derivative(F, u)), bcs=bcs)
    A.assemble()
    b = A.createVecLeft()
    b.array[:] = r.array[: len(owned(u))]
    size = norm(lu_solve(A, b)) / norm(owned(u))
    A.destroy()
    b.destroy()
    return size
