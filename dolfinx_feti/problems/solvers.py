# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""PETSc's solvers with contexts of this package: creation from options, checks, and tolerances.

PETSc views a KSP at the end of each solve; here the plain ``-ksp_view`` prints FETI's table once.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace

from petsc4py import PETSc

from dolfinx_feti.feti.options import read_options
from dolfinx_feti.feti.solve_settings import ErrorAllowance
from dolfinx_feti.feti.solver import FETI
from dolfinx_feti.feti.unread_options import may_be_solver_option, warn_of_unread
from dolfinx_feti.problems.solver_options import (
    BOUNDS_TEXT,
    FOREIGN_PREFIXES,
    LINEAR_TOLERANCE_OPTIONS,
    PLAIN_VIEWS,
    SOLVER_CHOICES,
    VARIATIONAL_PREFIX,
    options_without_effect,
    require_no_bounds,
)
from dolfinx_feti.runtime.collective import on_all, warn
from dolfinx_feti.runtime.compat import petsc_errors_silenced
from dolfinx_feti.runtime.petsc_library import c_function
from dolfinx_feti.runtime.petsc_options import inserted, unread_options, withheld

#: Default relative tolerance of Newton's method: PETSc's own. It is also that of the estimated
#: error, so that eight digits of u are right.
RTOL = 1e-8

#: Default absolute tolerance of Newton's method: none, as forces have units.
ATOL = 1e-50

#: Default largest number of Newton steps: a bound for solves that do not converge. The hardest ones
#: of the tests (total variation) take 67; their scripts set another.
MAX_STEPS = 30

#: Attribute of a solver until its first solve: options that were not read when it was created.
UNREAD_ATTRIBUTE = "feti_unread_options"


# -- creation --------------------------------------------------------------------------------------


def create_solver(
    A: PETSc.Mat, prefix: str, petsc_options: Mapping[str, object], *, lifted: bool = False
) -> PETSc.KSP:
    """Create a KSP with a FETI context, set from the options. Collective.

    Args:
        A: A torn matrix.
        prefix: Prefix of the options.
        petsc_options: Options without prefix, in addition to those of the command line.
        lifted: Whether right-hand sides are lifted, see ``TornProblem.create_linear_solver``.

    Raises:
        ValueError: An option has a wrong value.
    """
    ksp = PETSc.KSP().create(A.comm)
    _set_from_options(ksp, ksp, FETI(lifted=lifted), A, prefix, petsc_options)
    return ksp


def create_newton_solver(
    newton: object, A: PETSc.Mat, prefix: str, petsc_options: Mapping[str, object]
) -> PETSc.SNES:
    """Create a SNES with a context, and its KSP with a FETI context, set from the options.

    Args:
        newton: Context of the SNES.
        A: A torn matrix, which will hold the tangents.
        prefix: Prefix of the options.
        petsc_options: Options without prefix, in addition to those of the command line.

    Raises:
        ValueError: An option has a wrong value.

    Note:
        Collective.
    """
    snes = PETSc.SNES().create(A.comm)
    snes.setType(PETSc.SNES.Type.PYTHON)
    snes.setPythonContext(newton)
    snes.setTolerances(rtol=RTOL, atol=ATOL, max_it=MAX_STEPS)
    _set_from_options(snes, snes.getKSP(), FETI(newton=True), A, prefix, petsc_options)
    return snes


def _set_from_options(
    solver: PETSc.KSP | PETSc.SNES,
    ksp: PETSc.KSP,
    feti: FETI,
    A: PETSc.Mat,
    prefix: str,
    petsc_options: Mapping[str, object],
) -> None:
    """Set matrix, context and options of a solver, on all processes or none. Collective.

    Args:
        solver: A KSP or SNES.
        ksp: It, or its KSP.
        feti: Context of the KSP.
        A: A torn matrix.
        prefix: Prefix of the options.
        petsc_options: Options without prefix.

    Raises:
        ValueError: An option has a wrong value.
    """
    solver.setOptionsPrefix(prefix)

    def set_from_options() -> None:
        with inserted(prefix, petsc_options):
            require_no_bounds(prefix)
            ineffective = options_without_effect(prefix)
            _warn_of_ineffective(ineffective, prefix, A)
            prints_table = PETSc.Options(prefix).getString("ksp_view", "none") in PLAIN_VIEWS
            # hidden: options that choose another solver or its parts, and a view that FETI prints
            hidden = [*SOLVER_CHOICES]
            hidden += [name for name in ineffective if name.startswith(FOREIGN_PREFIXES)]
            if prints_table:
                hidden.append("ksp_view")
            with withheld(prefix + name for name in hidden):  # PETSc would choose another solver
                # the type, then its context, then the options, which configure the context
                ksp.setOperators(A)
                ksp.setType(PETSc.KSP.Type.PYTHON)
                ksp.setPythonContext(feti)
                _require_unlifted(prefix)
                _read_options(solver, prefix)
            ksp.setNormType(PETSc.KSP.NormType.DEFAULT)  # a KSP of type python has no other one
            unread = _unread(solver, prefix)
            for name in (*hidden, *ineffective):  # withheld from PETSc, or logged above
                unread.pop(name, None)
            solver.setAttr(UNREAD_ATTRIBUTE, unread)
            feti.serve_problem(prints_table=prints_table)
        # the option makes PETSc raise its code; the package raises ConvergenceError with a remedy.
        # A script may set it later, see failures_as_reasons.
        solver.setErrorIfNotConverged(False)
        ksp.setErrorIfNotConverged(False)

    on_all(set_from_options, A.comm.tompi4py())


def _warn_of_ineffective(ineffective: Mapping[str, str], prefix: str, A: PETSc.Mat) -> None:
    """Log options without effect, by their names without prefix and values."""
    if not ineffective:
        return
    texts = (f"-{prefix}{name} {value}".rstrip() for name, value in ineffective.items())
    warn(
        f"Without effect: {', '.join(texts)}. FETI solves the torn system; leave them out. "
        f"-{prefix}feti_… chooses its parts, see docs/options.md.",
        A.comm.tompi4py(),
    )


def _require_unlifted(prefix: str) -> None:
    """Check that no option sets lifted right-hand sides: a problem assembles unlifted ones.

    Raises:
        ValueError: ``feti_right_side`` is not "unlifted", or another option of FETI has a wrong
            value. PETSc would replace such an error by a code.
    """
    options = read_options(prefix)
    if options.right_side != "unlifted":
        raise ValueError(
            f"Option -{prefix}feti_right_side is '{options.right_side}', but a problem assembles "
            "its own right-hand sides, which FETI lifts: leave it out. For vectors of your own "
            "take problem.create_linear_solver(lifted=True)."
        )


def _read_options(solver: PETSc.KSP | PETSc.SNES, prefix: str) -> None:
    """Call ``setFromOptions``.

    Raises:
        ValueError: PETSc refuses a value.
    """
    try:
        solver.setFromOptions()
    except PETSc.Error as error:
        cause = re.sub(r"\A\[\d+\] ", "", str(error).splitlines()[-1])
        raise ValueError(
            f"PETSc refuses one of the options -{prefix}…: {cause}. See docs/options.md."
        ) from error


# -- options that nothing has read -----------------------------------------------------------------


def _unread(solver: PETSc.KSP | PETSc.SNES, prefix: str) -> dict[str, str]:
    """Return the options under a prefix that no solver has read on this process, without it."""
    unread = unread_options(prefix)
    if isinstance(solver, PETSc.KSP):
        # a check of the numbers of snes_… marks them as read, also of a problem without SNES
        for key, value in PETSc.Options().getAll().items():
            if key.startswith(f"{prefix}snes_"):
                unread[key.removeprefix(prefix)] = value or ""  # a flag has the value None
    return unread


def warn_of_unread_options(
    solver: PETSc.KSP | PETSc.SNES, prefix: str, petsc_options: Mapping[str, object]
) -> None:
    """Log the options that neither creation nor the first solve has read, once. Collective.

    Call it after a solve, while the options of the problem are in the database.

    Args:
        solver: The problem's solver.
        prefix: Its prefix.
        petsc_options: The problem's own options; others under the prefix are the command line's.
    """
    at_creation = solver.getAttr(UNREAD_ATTRIBUTE)
    if at_creation is None:
        return
    solver.setAttr(UNREAD_ATTRIBUTE, None)
    now = _unread(solver, prefix)
    still_unread = {
        name: value
        for name, value in at_creation.items()
        if name in now and (name in petsc_options or may_be_solver_option(name))
    }
    warn_of_unread(prefix, still_unread, solver.comm.tompi4py())


# -- checks before a solve -------------------------------------------------------------------------


def has_bounds(snes: PETSc.SNES) -> bool:
    """Return True if ``setVariableBounds`` was called; False if the library lacks the query."""
    get_bounds = c_function("SNESVIGetVariableBounds", (ctypes.c_void_p,) * 3)
    if get_bounds is None:
        return False
    low = ctypes.c_void_p()
    high = ctypes.c_void_p()
    with petsc_errors_silenced():  # an error code means that there are no bounds
        return not get_bounds(snes.handle, ctypes.byref(low), ctypes.byref(high))


def check_newton_solver(snes: PETSc.SNES, newton: object) -> None:
    """Check that a script has not turned a SNES into another solver. Not collective.

    Raises:
        ValueError: Its type, its context or its KSP is not the package's own any more.
    """
    solver_type = snes.getType()
    if solver_type is not None and solver_type.startswith(VARIATIONAL_PREFIX):
        raise ValueError(f"problem.solver has the type {solver_type}, which {BOUNDS_TEXT}")
    if solver_type != PETSc.SNES.Type.PYTHON or snes.getPythonContext() is not newton:
        raise ValueError(
            f"problem.solver has the type {solver_type} or another context, but it drives the "
            "package's own Newton's method: leave its type alone, or use a SNES of your own with "
            "problem.linear_system()."
        )
    check_linear_solver(snes.getKSP(), "problem.solver.getKSP()")


def check_linear_solver(ksp: PETSc.KSP, name: str) -> None:
    """Check that a script has not turned a KSP into another solver. Not collective.

    Args:
        ksp: The KSP.
        name: What a script calls it.

    Raises:
        ValueError: It is not FETI's any more.
    """
    solver_type = ksp.getType()
    if solver_type != PETSc.KSP.Type.PYTHON or not isinstance(ksp.getPythonContext(), FETI):
        raise ValueError(
            f"{name} has the type {solver_type}, but only FETI solves with the torn matrix: leave "
            "its type alone, or convert problem.A by A.convert('aij') for a KSP of your own."
        )


# -- tolerances ------------------------------------------------------------------------------------


def relative_tolerance(solver: PETSc.KSP | PETSc.SNES) -> float:
    """Return the relative tolerance of a solver."""
    rtol, *_ = solver.getTolerances()
    return float(rtol)


def max_steps(snes: PETSc.SNES) -> int:
    """Return the largest number of steps of a SNES."""
    *_, max_it = snes.getTolerances()
    return int(max_it)


@contextmanager
def failures_as_reasons(*solvers: PETSc.KSP | PETSc.SNES) -> Iterator[None]:
    """Return a context in which solvers end with a negative reason and never raise an error.

    Newton's method recovers from some failures of the linear solver. For all others the package
    raises ConvergenceError, which names a remedy. Afterwards ``setErrorIfNotConverged`` is as a
    script has set it after the creation of the solvers.
    """
    flags = [solver.getErrorIfNotConverged() for solver in solvers]
    for solver in solvers:
        solver.setErrorIfNotConverged(False)
    try:
        yield
    finally:
        for solver, flag in zip(solvers, flags, strict=True):
            solver.setErrorIfNotConverged(flag)


@contextmanager
def newton_tolerances(
    ksp: PETSc.KSP, *, norm: float, error: ErrorAllowance, load_rounding: float
) -> Iterator[None]:
    """Return a context in which linear solves are as accurate as a Newton step needs.

    The absolute tolerance of the KSP is raised to ``norm``, if it is smaller, and set back
    afterwards. If an option sets a tolerance of the KSP, both tolerances stay as they are.

    Args:
        ksp: A KSP with a FETI context.
        norm: ‖b − A x‖ that is small enough.
        error: Bounds of the estimated error that is small enough: a share of the solution, and
            sizes at the dofs, (owned,).
        load_rounding: Size of the rounding errors of b.
    """
    _, atol, *_ = ksp.getTolerances()
    options = PETSc.Options(ksp.getOptionsPrefix())
    feti: FETI = ksp.getPythonContext()
    settings = replace(feti.settings, load_rounding=load_rounding)
    if not any(options.hasName(name) for name in LINEAR_TOLERANCE_OPTIONS):
        ksp.setTolerances(atol=max(atol, norm))
        settings = replace(settings, error_allowance=error)
    try:
        with feti.solving_with(settings):
            yield
    finally:
        ksp.setTolerances(atol=atol)
