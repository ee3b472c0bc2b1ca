# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The arguments that dolfinx's problem classes take, from 0.9 to 0.11: served, or answered."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.fem.checks import check_bcs, check_space
from dolfinx_feti.problems.mixed import refuse_blocks, refuse_mixed_form, refuse_mixed_space
from dolfinx_feti.runtime.collective import warn
from dolfinx_feti.runtime.petsc_options import require_prefix

__all__ = [
    "agreed_prefix",
    "checked_conditions",
    "missing",
    "require_forms",
    "require_function",
    "warn_unused",
]

#: How many problems of each kind have been given a prefix.
_made: Counter[str] = Counter()


def agreed_prefix(prefix: str | None, kind: str, comm: MPI.Comm) -> str:
    """Check a prefix of options, or make one that no other problem has.

    Args:
        prefix: What the user has given.
        kind: Begins a prefix that is made, and has a count of its own.
        comm: Communicator of the problem.

    Raises:
        ValueError: The prefix is no string or empty, or not the same on all processes.

    Note:
        Collective; raises on all processes.
    """
    given = comm.allgather(prefix)
    for rank, other in enumerate(given):
        if other != given[0]:
            raise ValueError(
                f"petsc_options_prefix is {given[0]!r} on process 0 and {other!r} on process "
                f"{rank}: give the same one on all."
            )
    if prefix is not None:
        return require_prefix(prefix)
    count = comm.allreduce(_made[kind], op=MPI.MAX)  # some may live on fewer processes
    _made[kind] = count + 1
    return f"{kind}_{count}_"


def checked_conditions(
    V: dolfinx.fem.FunctionSpace, bcs: Sequence[dolfinx.fem.DirichletBC] | None
) -> tuple[dolfinx.fem.DirichletBC, ...]:
    """Check the space of the unknown and its boundary conditions.

    Args:
        V: The space.
        bcs: Conditions; None for none.

    Returns:
        The conditions.

    Raises:
        TypeError: V is neither scalar nor blocked, or not continuous.
        ValueError: ``bcs`` is a condition alone, or holds something else or one on another space.
    """
    refuse_mixed_space(V)
    check_space(V)
    if isinstance(bcs, dolfinx.fem.DirichletBC):
        raise ValueError("bcs is a Dirichlet condition alone: put it in a list, bcs=[bc].")
    conditions = tuple(bcs or ())
    for i, bc in enumerate(conditions):
        if not isinstance(bc, dolfinx.fem.DirichletBC):
            raise ValueError(f"bcs[{i}] is {bc!r}: give what dolfinx.fem.dirichletbc returns.")
    check_bcs(V, conditions)
    return conditions


def missing(problem: object, name: str) -> AttributeError:
    """Return the error for an attribute that dolfinx's ``NewtonSolver`` asks a problem for."""
    message = f"'{type(problem).__name__}' object has no attribute '{name}'"
    if name not in ("L", "a", "form"):  # Python would ask whether 'A' was meant
        return AttributeError(message)
    text = (
        f"{message}; it drives Newton's method itself: call problem.solve() in the place of "
        "dolfinx.nls.petsc.NewtonSolver"
    )
    return AttributeError(text, name=name, obj=None)


def require_forms(**forms: object) -> None:
    """Refuse block forms, mixed ones and compiled ones.

    Args:
        forms: What should be forms of UFL, by the names of the arguments.

    Raises:
        ValueError: One is something else.
    """
    for name, form in forms.items():
        refuse_blocks(name, form)
        if isinstance(form, dolfinx.fem.Form):
            raise ValueError(
                f"{name} is a compiled form, which cannot be torn any more: give the form of UFL."
            )
        if not isinstance(form, ufl.Form):
            raise ValueError(f"{name} is {form!r}: give a form of UFL.")
        refuse_mixed_form(name, form)
        require_real_data(name, form)


def require_real_data(name: str, form: ufl.Form) -> None:
    """Refuse coefficients and constants that are no real numbers in double precision.

    Args:
        name: Of the argument.
        form: The form.

    Raises:
        TypeError: One has other numbers.
    """
    for f in (*form.coefficients(), *form.constants()):
        dtype = np.dtype(getattr(f, "dtype", np.float64))
        if dtype != np.float64:
            raise TypeError(
                f"{name} contains {f}, of type {dtype}, but forms are real (float64) here: give "
                "its real and imaginary parts as two functions of dtype numpy.float64."
            )


def require_function(u: object) -> None:
    """Refuse several unknowns.

    Raises:
        ValueError: u is no function.
    """
    refuse_blocks("u", u)
    if not isinstance(u, dolfinx.fem.Function):
        raise ValueError(f"u is {u!r}: give a dolfinx.fem.Function.")


def warn_unused(comm: MPI.Comm, unused: Mapping[str, object]) -> None:
    """Log which arguments have no effect here, and refuse forms on several meshes.

    Args:
        comm: Communicator of the problem.
        unused: Arguments by their names; None stands for not given.

    Raises:
        ValueError: There are maps between meshes.
    """
    if unused["entity_maps"]:
        raise ValueError(
            "entity_maps relates several meshes, but only forms on one mesh can be torn: put "
            "coefficients on the mesh of the unknown."
        )
    named = [k for k, value in unused.items() if k != "entity_maps" and value is not None]
    if named:
        warn(
            f"Without effect: {' and '.join(named)}. FETI has a preconditioner and a matrix "
            "(MATIS) of its own; leave it out.",
            comm,
        )
