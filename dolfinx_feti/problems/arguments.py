# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checks of the arguments that dolfinx's problem classes take, from 0.9 to 0.11.

A function ``require_…`` raises an error or returns nothing; one called ``checked_…`` returns its
argument in the form that the package uses.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl
from ufl.finiteelement import AbstractFiniteElement

from dolfinx_feti.fem.user_forms.checks import check_space
from dolfinx_feti.problems.unknowns.alternatives import alternative_for
from dolfinx_feti.problems.unknowns.mixed_of_one import MixedOfOne
from dolfinx_feti.runtime.petsc_options import require_prefix

#: Number of default prefixes with each beginning so far. PETSc's database of options, in which they
#: have to differ, is global to the process, and so is this counter.
_default_prefixes: Counter[str] = Counter()


def checked_prefix(prefix: str | None, name: str, comm: MPI.Comm) -> str:
    """Return the prefix of options: the user's, or a unique one if none is given. Collective.

    Args:
        prefix: The user's prefix, or None.
        name: Beginning of the default prefix.
        comm: Communicator of the problem.

    Raises:
        ValueError: The prefix is not a string, is empty, or differs between processes.
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
    # processes may have created different numbers of problems, on communicators of a few of them
    count = comm.allreduce(_default_prefixes[name], op=MPI.MAX)
    _default_prefixes[name] = count + 1
    return f"{name}_{count}_"


def require_torn_space(V: dolfinx.fem.FunctionSpace, forms: object = ()) -> None:
    """Check that a space can be torn.

    Args:
        V: The space.
        forms: Forms of the problem, in sequences or not, by which the message about a mixed element
            chooses its advice.

    Raises:
        TypeError: The space is neither scalar nor blocked, or not continuous.
    """
    element = V.ufl_element()
    sub_elements = list(element.sub_elements)
    if sub_elements and getattr(element, "block_size", 1) == 1:
        raise TypeError(
            f"The space has a mixed element of {len(sub_elements)}"
            f"{alternative_for(sub_elements, forms)}"  # ", but …" with what helps
        )
    check_space(V)


def checked_conditions(
    V: dolfinx.fem.FunctionSpace,
    bcs: Sequence[dolfinx.fem.DirichletBC] | None,
    *,
    fields: Sequence[dolfinx.fem.Function] = (),
    mixed: MixedOfOne | None = None,
) -> tuple[dolfinx.fem.DirichletBC, ...]:
    """Return the boundary conditions of a problem as a tuple.

    Args:
        V: Space of the unknown that is torn.
        bcs: The user's conditions.
        fields: Condensed fields, which take no conditions.
        mixed: The user's unknown, if it has a mixed element with one part, of which V is the space:
            conditions are on the mixed space.

    Raises:
        ValueError: ``bcs`` is a single condition instead of a list, or contains another object or a
            condition on another space.
    """
    if isinstance(bcs, dolfinx.fem.DirichletBC):
        raise ValueError("bcs is a Dirichlet condition alone: put it in a list, bcs=[bc].")
    conditions = tuple(bcs or ())
    if mixed is not None:
        V = mixed.w.function_space
    for i, bc in enumerate(conditions):
        _require_condition(f"bcs[{i}]", bc, V, fields)
    return conditions


def _require_condition(
    name: str,
    bc: dolfinx.fem.DirichletBC,
    V: dolfinx.fem.FunctionSpace,
    fields: Sequence[dolfinx.fem.Function],
) -> None:
    """Check a Dirichlet condition on V.

    Raises:
        ValueError: It is no condition, is on another space, or has dofs that V does not have.
    """
    if not isinstance(bc, dolfinx.fem.DirichletBC):
        raise ValueError(f"{name} is {bc!r}: give what dolfinx.fem.dirichletbc returns.")
    space = bc._cpp_object.function_space
    if space != V._cpp_object and not V._cpp_object.contains(space):
        for p in fields:
            Q = p.function_space._cpp_object
            if space == Q or Q.contains(space):
                raise ValueError(
                    f"{name} prescribes '{p.name}', which is condensed cell by cell and takes no "
                    "conditions: leave it out. To prescribe values of a field, put a known "
                    "Function into the forms in its place."
                )
        raise ValueError(
            f"{name} lives on another function space than the unknown: make it with the unknown's "
            "own space V, or with V.sub(i) for one component."
        )
    dofs = bc.dof_indices()[0]
    index_map = V.dofmap.index_map
    size = (index_map.size_local + index_map.num_ghosts) * V.dofmap.index_map_bs
    if dofs.max(initial=0) >= size:
        raise ValueError(
            f"{name} prescribes dof {dofs.max()}, but the space has {size} on this process: give "
            "dofs of this space as dolfinx.fem.locate_dofs_topological returns them, one number "
            "for all components of a node."
        )


def require_form(name: str, form: object) -> None:
    """Check that an argument is a single form of UFL in float64.

    Args:
        name: What the message calls it.
        form: The argument.

    Raises:
        ValueError: It is no form of UFL, is compiled, or has several test functions.
        TypeError: It has coefficients or constants of other numbers than float64.
    """
    _require_single(name, form)
    if isinstance(form, dolfinx.fem.Form):
        raise ValueError(
            f"{name} is a compiled form, which cannot be torn any more: give the form of UFL."
        )
    if not isinstance(form, ufl.Form):
        raise ValueError(f"{name} is {form!r}: give a form of UFL.")
    tests = [v for v in form.arguments() if v.number() == 0]
    if len(tests) > 1:
        elements = [v.ufl_function_space().ufl_element() for v in tests]
        raise ValueError(f"{name} has {len(tests)} test functions{alternative_for(elements, form)}")
    for f in (*form.coefficients(), *form.constants()):
        dtype = np.dtype(getattr(f, "dtype", np.float64))
        if dtype != np.float64:
            raise TypeError(
                f"{name} contains {f}, of type {dtype}, but forms are real (float64) here: "
                "give its real and imaginary parts as two functions of dtype numpy.float64."
            )


def _require_single(name: str, argument: object) -> None:
    """Check that an argument is not a sequence of forms or functions.

    Raises:
        ValueError: It is one.
    """
    if not isinstance(argument, Sequence) or isinstance(argument, str):
        return
    elements = [element for element in map(_element_of, argument) if element is not None]
    raise ValueError(f"{name} is a block of {len(argument)}{alternative_for(elements, argument)}")


def _element_of(entry: object) -> AbstractFiniteElement | None:
    """Return the element of a function, or of the test function of a form or a row of forms.

    None is returned for other objects.
    """
    while isinstance(entry, list | tuple):
        entry = next((block for block in entry if block is not None), None)
    if isinstance(entry, ufl.Form):
        entry = next(iter(entry.arguments()), None)
    if isinstance(entry, ufl.Argument | ufl.Coefficient):
        return entry.ufl_element()
    return None


def require_callable(before_assembly: object) -> None:
    """Check that ``before_assembly`` can be called.

    Raises:
        ValueError: It cannot be called.
    """
    if not callable(before_assembly):
        raise ValueError(
            f"before_assembly is {before_assembly!r}: give a function of u, such as "
            "lambda u: update_stress(u)."
        )


def require_function(u: object) -> None:
    """Check that an unknown is a single Function.

    Raises:
        ValueError: It is another object, or a sequence.
    """
    _require_single("u", u)
    if not isinstance(u, dolfinx.fem.Function):
        raise ValueError(f"u is {u!r}: give a dolfinx.fem.Function.")
