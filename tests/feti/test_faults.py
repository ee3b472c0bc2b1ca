# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Work that fails on one process ends set-up and solve on all, and leaves nothing.

The list of functions is generated: all of ``feti/subdomain``, and in other rooms those that call
LAPACK, BLAS or compiled code, if a solve calls them and they neither are collective nor guard.
"""

import faulthandler
import gc
import importlib
import inspect
import pkgutil
import sys
from functools import partial

from petsc4py import PETSc

import numpy as np
import pytest
from cases import each
from collective import COMM, agree, garbage
from hand_torn import random_values, unsymmetric

import dolfinx_feti
from dolfinx_feti import feti as package
from dolfinx_feti.feti.bordered import Border, BorderedSolver
from dolfinx_feti.runtime.petsc_options import inserted

#: Seconds after which processes are taken to wait for each other: all end then.
LONG = 60

#: Options, whether the matrix is unsymmetric, and whether a scalar unknown borders it.
FORMS = {
    "dual": ({"feti_formulation": "dual"}, False, False),
    "kept": ({"feti_formulation": "dual", "feti_interior": "keep"}, False, False),
    "primal": ({"feti_formulation": "primal", "feti_interior": "eliminate"}, False, False),
    "unsymmetric": ({"feti_formulation": "primal"}, True, False),
    "bordered": ({}, False, True),
}

#: What ends objects, and what only hands over to guarded work.
GUARDED = ("destroy", "load", "complete")


def fault(*_args, **_how):
    """Take the place of any function."""
    raise ArithmeticError("a fault")


def calls_numerics(function):
    """Tell whether a function, or one within it, calls LAPACK, BLAS or compiled code."""
    inner = [code for code in function.__code__.co_consts if inspect.iscode(code)]
    names = {name for code in (function.__code__, *inner) for name in code.co_names}
    return bool(names & {"linalg", "lapack", "blas", "lib"})


def local_functions():
    """Find the functions that work on the subdomains of one process alone."""
    for info in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        module = importlib.import_module(info.name)
        inside = info.name.startswith(package.__name__ + ".subdomain.")
        classes = [found for found in vars(module).values() if inspect.isclass(found)]
        for member in [m for owner in (module, *classes) for m in vars(owner).values()]:
            if not inspect.isfunction(member) or member.__module__ != info.name:
                continue
            collective = "ollective" in (member.__doc__ or "").replace("Not collective", "")
            guard = "deferred" in member.__code__.co_names or member.__name__ in GUARDED
            if collective or guard or member.__code__.co_freevars:
                continue
            if inside or calls_numerics(member):
                yield f"{info.name}.{member.__qualname__}", member


def message_of(problem, options, *, bordered):
    """Set a solver up and solve; return what it says, or raises; empty if all is well."""
    ksp = PETSc.KSP().create(COMM)
    ksp.setOptionsPrefix("fault_")
    ksp.setOperators(problem.A)
    b, x = problem.vector(random_values(problem)), problem.A.createVecRight()
    try:
        with inserted("fault_", options):
            ksp.setType(PETSc.KSP.Type.PYTHON)
            ksp.setPythonContext(dolfinx_feti.FETI())
            ksp.setFromOptions()
            ksp.setUp()
            if bordered:
                column = np.where(problem.dirichlet, 0.0, random_values(problem, seed=2))
                rows = column[slice(*b.getOwnershipRange()), None]
                border = Border(rows, rows, np.zeros((1, 1)))
                BorderedSolver().solve(ksp, problem.A, b.array_r, border, np.ones(1))
            else:
                ksp.solve(b, x)
        return str(ksp.getPythonContext().message)
    except Exception as error:
        return repr(error)
    finally:
        for owned in (ksp, b, x):
            owned.destroy()


def called(work):
    """Return the code of all functions that are called."""
    codes = set()
    sys.setprofile(lambda frame, _event, _argument: codes.add(frame.f_code))
    try:
        work()
    finally:
        sys.setprofile(None)
    return codes


@pytest.mark.processes(2)
@pytest.mark.filterwarnings("ignore:Assigning a code object")  # of a generator
@each(("options", "skew", "bordered"), FORMS)
def test_fault_on_one_process_is_an_error_on_all(options, skew, bordered, torn_grid):
    change = unsymmetric(0.02, skew=True) if skew else None
    problem = torn_grid((2, 2), (3, 2), components=2, change=change)
    solved = partial(message_of, problem, options, bordered=bordered)
    codes = called(lambda: agree(not solved(), solved()))
    functions = {n: f for n, f in sorted(dict(local_functions()).items()) if f.__code__ in codes}
    for name in COMM.bcast(sorted(functions)):
        function = functions[name]
        faulthandler.dump_traceback_later(LONG, exit=True)
        code = function.__code__
        if COMM.rank == 1:
            function.__code__ = fault.__code__
        try:
            said = solved()
        finally:
            function.__code__ = code
            faulthandler.cancel_dump_traceback_later()
        agree("fault" in said or "Error" in said, (name, said))
        gc.collect()
        agree(not garbage(COMM), (name, garbage(COMM)))
    agree(len(functions) > 30, sorted(functions))
    agree(not solved())
