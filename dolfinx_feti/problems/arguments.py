# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The arguments that dolfinx's problem classes take, from 0.9 to 0.11: served, or answered."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

import basix
import dolfinx
import ufl
from ufl.finiteelement import AbstractFiniteElement

from dolfinx_feti.fem.checks import check_space
from dolfinx_feti.runtime.petsc_options import require_prefix
from dolfinx_feti.scalars.equations import is_real

#: What to do in place of a problem in several fields: with a pressure, with a flux, with others.
INSTEAD = {
    "pressure": "Condense a discontinuous pressure of an elastic solid, "
    "NonlinearProblem([F_u, F_p], u, bcs=bcs, condense=p) or LinearProblem(a, L, bcs=bcs, "
    "condense=p), with bcs on the space of u alone and p in F_p, as in (J - 1 - p/kappa)*q: see "
    "docs/elements.md. A pressure that is continuous, or has no term of its own, as in Stokes' "
    "equations, is solved by dolfinx, with MUMPS or a field split.",
    "flux": "Solve it by dolfinx, with MUMPS or a field split; or, if the vector is a flux −k ∇p, "
    "solve −div(k ∇p) = f for p alone, in ('Lagrange', k), and interpolate the flux.",
    "other": "Solve it by dolfinx, with MUMPS or a field split.",
}

#: How many problems of each kind have been given a prefix.
_made: Counter[str] = Counter()


def agreed_prefix(prefix: str | None, kind: str, comm: MPI.Comm) -> str:
    """Check a prefix of options, or make one of this kind that no other problem has. Collective.

    Raises:
        ValueError: The prefix is no string or empty, or not the same on all processes.
    """
    first, *others = comm.allgather(prefix)
    for rank, other in enumerate(others, start=1):
        if other != first:
            raise ValueError(
                f"petsc_options_prefix is {first!r} on process 0 and {other!r} on process {rank}: "
                "give the same one on all."
            )
    if prefix is not None:
        return require_prefix(prefix)
    count = comm.allreduce(_made[kind], op=MPI.MAX)  # some may live on fewer processes
    _made[kind] = count + 1
    return f"{kind}_{count}_"


def checked_conditions(
    V: dolfinx.fem.FunctionSpace, bcs: Sequence[dolfinx.fem.DirichletBC] | None
) -> tuple[dolfinx.fem.DirichletBC, ...]:
    """Check the space of the unknown, and return its boundary conditions.

    Raises:
        TypeError: V is neither scalar nor blocked, or not continuous.
        ValueError: ``bcs`` is a condition alone, or holds something else or one on another space.
    """
    element = V.ufl_element()
    parts = list(element.sub_elements)
    if parts and getattr(element, "block_size", 1) == 1:
        raise TypeError(f"The space has a mixed element of {len(parts)}{_instead(parts)}")
    check_space(V)
    if isinstance(bcs, dolfinx.fem.DirichletBC):
        raise ValueError("bcs is a Dirichlet condition alone: put it in a list, bcs=[bc].")
    conditions = tuple(bcs or ())
    for i, bc in enumerate(conditions):
        if not isinstance(bc, dolfinx.fem.DirichletBC):
            raise ValueError(f"bcs[{i}] is {bc!r}: give what dolfinx.fem.dirichletbc returns.")
        space = bc._cpp_object.function_space
        if space != V._cpp_object and not V._cpp_object.contains(space):
            raise ValueError(
                f"bcs[{i}] lives on another function space than the unknown: make it with the "
                "unknown's own space V, or with V.sub(i) for one component."
            )
    return conditions


def require_forms(**forms: object) -> None:
    """Refuse block forms, mixed ones and compiled ones, by the names of the arguments.

    Raises:
        ValueError: One is no form of UFL.
        TypeError: One has coefficients or constants of other numbers than float64.
    """
    for name, form in forms.items():
        _refuse_blocks(name, form)
        if isinstance(form, dolfinx.fem.Form):
            raise ValueError(
                f"{name} is a compiled form, which cannot be torn any more: give the form of UFL."
            )
        if not isinstance(form, ufl.Form):
            raise ValueError(f"{name} is {form!r}: give a form of UFL.")
        tests = [v for v in form.arguments() if v.number() == 0]
        if len(tests) > 1:
            parts = [v.ufl_function_space().ufl_element() for v in tests]
            raise ValueError(f"{name} has {len(parts)} test functions{_instead(parts)}")
        for f in (*form.coefficients(), *form.constants()):
            dtype = np.dtype(getattr(f, "dtype", np.float64))
            if dtype != np.float64:
                raise TypeError(
                    f"{name} contains {f}, of type {dtype}, but forms are real (float64) here: "
                    "give its real and imaginary parts as two functions of dtype numpy.float64."
                )


def _refuse_blocks(name: str, given: object) -> None:
    """Refuse several forms or functions."""
    if not isinstance(given, Sequence) or isinstance(given, str):
        return
    if len(given) == 1:
        raise ValueError(f"{name} is a list of one: take it out of the list.")
    if name == "J":
        raise ValueError("J is a block: give the derivative of F_u in u alone, or leave it out.")
    functions = all(isinstance(part, dolfinx.fem.Function) for part in given)
    if functions and any(is_real(f.function_space) for f in given):
        raise ValueError(
            f"{name} is a block of {len(given)} with scalars on real spaces: give them by "
            "scalars=, or all by residuals, NonlinearProblem([F_u, F_s], [u, s])."
        )
    parts = [element for element in map(_element, given) if element is not None]
    raise ValueError(f"{name} is a block of {len(given)}{_instead(parts)}")


def _element(part: object) -> AbstractFiniteElement | None:
    """Return the element of a function, or of the test function of a form or a row of blocks."""
    while isinstance(part, list | tuple):
        part = next((entry for entry in part if entry is not None), None)
    if isinstance(part, ufl.Form):
        part = next(iter(part.arguments()), None)
    return part.ufl_element() if isinstance(part, ufl.Argument | ufl.Coefficient) else None


def _instead(parts: Sequence[AbstractFiniteElement]) -> str:
    """Say what to do in place of a problem in several fields."""
    ranks = sorted(len(part.reference_value_shape) for part in parts)
    kind = "pressure" if ranks == [0, 1] else "other"
    fluxes = {basix.SobolevSpace.HDiv, basix.SobolevSpace.HCurl}
    if fluxes.intersection(part.basix_sobolev_space for part in parts):
        kind = "flux"
    return f", but only a problem on one continuous space is torn. {INSTEAD[kind]}"


def require_function(u: object) -> None:
    """Refuse several unknowns, and what is no function."""
    _refuse_blocks("u", u)
    if not isinstance(u, dolfinx.fem.Function):
        raise ValueError(f"u is {u!r}: give a dolfinx.fem.Function.")
