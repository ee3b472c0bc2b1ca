# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""PETSc's solvers with contexts of this package: made from options, and what fails in them.

Options that choose another solver have no effect, which is logged once. PETSc views a KSP at the
end of each solve; the plain ``-ksp_view`` is FETI's here, which prints its table once.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from petsc4py import PETSc

from dolfinx_feti.feti.options import read_options
from dolfinx_feti.feti.solver import FETI, VIEW_ONCE
from dolfinx_feti.runtime.collective import on_all, warn
from dolfinx_feti.runtime.petsc_options import inserted, withheld

#: Default relative tolerance of Newton's method.
RTOL = 1e-8

#: Options that choose a solver, and the one value that changes nothing here.
SOLVERS = {
    "ksp_type": "python",
    "ksp_python_type": "dolfinx_feti.FETI",
    "pc_type": "none",
    "snes_type": "python",
    "snes_python_type": "dolfinx_feti.problems.newton.Newton",
}

#: Options that state how accurate linear solves are.
LINEAR_TOLERANCES = ("ksp_rtol", "ksp_atol", "snes_ksp_ew")

#: How options of solvers begin that have no place here.
FOREIGN = ("pc_", "mat_", "mg_", "snes_linesearch_")

#: Values of ``-ksp_view`` that name the screen and no format.
PLAIN = ("", "ascii", "true", "1")


def create_solver(A: PETSc.Mat, prefix: str, petsc_options: Mapping[str, object]) -> PETSc.KSP:
    """Create a KSP of a torn matrix with the FETI context, and set it from the options."""
    ksp = PETSc.KSP().create(A.comm)
    _set_up(ksp, ksp, FETI(), A, prefix, petsc_options)
    return ksp


def create_newton_solver(
    newton: object, A: PETSc.Mat, prefix: str, petsc_options: Mapping[str, object]
) -> PETSc.SNES:
    """Create a SNES and its KSP with their contexts, and set them from the options."""
    snes = PETSc.SNES().create(A.comm)
    snes.setType(PETSc.SNES.Type.PYTHON)
    snes.setPythonContext(newton)
    snes.setTolerances(rtol=RTOL, atol=1e-50, max_it=30)
    _set_up(snes, snes.getKSP(), FETI(newton=True), A, prefix, petsc_options)
    return snes


def _set_up(
    solver: PETSc.KSP | PETSc.SNES,
    ksp: PETSc.KSP,
    feti: FETI,
    A: PETSc.Mat,
    prefix: str,
    petsc_options: Mapping[str, object],
) -> None:
    """Give a solver, whose KSP is this one, the FETI context and options. Collective.

    Raises:
        ValueError: An option has a wrong value.
    """
    comm = A.comm.tompi4py()
    solver.setOptionsPrefix(prefix)

    def set_up() -> None:
        with inserted(prefix, petsc_options):
            other = options_without_effect(prefix)
            named = ", ".join(f"-{prefix}{name} {value}".rstrip() for name, value in other.items())
            if other:
                warn(
                    f"Without effect: {named}. FETI solves the torn system; leave them out. "
                    f"-{prefix}feti_… chooses its parts, see docs/options.md.",
                    comm,
                )
            once = PETSc.Options(prefix).getString("ksp_view", "none") in PLAIN
            ksp.setAttr(VIEW_ONCE, once)
            with withheld(prefix + name for name in (*SOLVERS, *other, *["ksp_view"] * once)):
                ksp.setOperators(A)
                ksp.setType(PETSc.KSP.Type.PYTHON)
                ksp.setPythonContext(feti)
                read_options(prefix)  # PETSc would turn its ValueError into an error code
                try:
                    solver.setFromOptions()
                except PETSc.Error as error:
                    cause = re.sub(r"\A\[\d+\] ", "", str(error).splitlines()[-1])
                    raise ValueError(
                        f"PETSc refuses one of the options -{prefix}…: {cause}. See "
                        "docs/options.md."
                    ) from error
        for each in (solver, ksp):
            each.setErrorIfNotConverged(False)  # a failure is for the package to report

    on_all(set_up, comm)


@contextmanager
def no_closer_than(norm: float, ksp: PETSc.KSP) -> Iterator[None]:
    """Let a solver end at a residual norm, unless options state how accurate it is to be."""
    _, atol, *_ = ksp.getTolerances()
    options = PETSc.Options(ksp.getOptionsPrefix())
    if not any(options.hasName(name) for name in LINEAR_TOLERANCES):
        ksp.setTolerances(atol=max(atol, norm))
    try:
        yield
    finally:
        ksp.setTolerances(atol=atol)


def options_without_effect(prefix: str) -> dict[str, str]:
    """Find the options under a prefix that belong to another solver, with their values."""
    found = {}
    for key, value in PETSc.Options().getAll().items():
        name = key.removeprefix(prefix)
        foreign = name not in SOLVERS and name.startswith(FOREIGN)
        if key.startswith(prefix) and (foreign or value != SOLVERS.get(name, value)):
            found[name] = value
    return found
