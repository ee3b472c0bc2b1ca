# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checks of user input, made before any work; they raise on all processes or on none."""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np

import basix
import dolfinx
import ufl


def check_scalar_type() -> None:
    """Require a PETSc with real numbers in double precision.

    Raises:
        TypeError: PETSc is complex or in single precision.
    """
    if np.dtype(PETSc.ScalarType) != np.float64:
        raise TypeError(
            f"PETSc's scalars are {np.dtype(PETSc.ScalarType)}, but dolfinx_feti needs real double "
            "precision (float64): point PETSC_DIR and PETSC_ARCH to such a build. There, a complex "
            "unknown is a real one of two components; or solve it by dolfinx, with MUMPS."
        )


def check_space(V: dolfinx.fem.FunctionSpace) -> None:
    """Require a continuous element, scalar or blocked, on a mesh in double precision.

    Raises:
        TypeError: Another element or mesh.
    """
    if V.mesh.geometry.x.dtype != np.float64:
        raise TypeError(
            f"The mesh has coordinates of type {V.mesh.geometry.x.dtype}, but dolfinx_feti needs "
            "float64: create it with dtype=numpy.float64."
        )
    element = V.ufl_element()
    parts = element.sub_elements or [element]  # of a blocked element one for each component
    scalar = len(parts) == element.block_size and parts[0].reference_value_shape == ()
    continuous = element.basix_sobolev_space == basix.SobolevSpace.H1 and not element.discontinuous
    if not scalar or not continuous:
        raise TypeError(
            f"The space has the element {element}, but tearing needs a continuous element, scalar "
            "or blocked: use ('Lagrange', k) or ('Lagrange', k, (dim,)), perhaps enriched by "
            "bubbles (basix.ufl.enriched_element). Solve methods that need H(div), H(curl) or "
            "discontinuous unknowns by dolfinx, with MUMPS."
        )


def check_forms(V: dolfinx.fem.FunctionSpace | None, **forms: tuple[ufl.Form, int]) -> None:
    """Require forms of given ranks, by the name of the argument, whose arguments are in V.

    Raises:
        ValueError: Another number of arguments, or another space.
    """
    for name, (form, rank) in forms.items():
        arguments = form.arguments()
        if len(arguments) != rank:
            raise ValueError(
                f"{name} has {len(arguments)} test and trial functions, but takes {rank}: a and J "
                "are bilinear, L and the residual F are linear in v."
            )
        if any(a.ufl_function_space() != V for a in arguments):
            raise ValueError(
                f"{name} has a test or trial function on another function space than u: take all "
                "from one space V, that of u if it is given."
            )


def check_condensed(fields: Sequence[dolfinx.fem.Function], u: dolfinx.fem.Function) -> None:
    """Require different scalar fields on the mesh of u, with dofs that no two cells share.

    Raises:
        TypeError: One is no function, or has another element.
        ValueError: One is u, is given twice, or lives on another mesh.
    """
    for i, p in enumerate(fields):
        if not isinstance(p, dolfinx.fem.Function):
            raise TypeError(
                f"condense[{i}] is {p!r}: give a dolfinx.fem.Function, or several of them."
            )
        if p is u or any(p is other for other in fields[:i]):
            raise ValueError(
                f"condense[{i}] is '{p.name}', which is the unknown or given twice: give each "
                "field beside the unknown once."
            )
        Q, mesh = p.function_space, u.function_space.mesh
        if Q.mesh._cpp_object != mesh._cpp_object:
            raise ValueError(
                f"condense is '{p.name}' on another mesh than the unknown: create it on the mesh "
                "of the unknown."
            )
        dofmap = Q.dofmap
        cells = mesh.topology.index_map(mesh.topology.dim).size_global
        own = cells * dofmap.list.shape[1] == dofmap.index_map.size_global
        if dofmap.bs != 1 or p.ufl_shape or not own:
            raise TypeError(
                f"condense is '{p.name}' with the element {Q.ufl_element()}, but only scalar "
                "fields whose dofs no two cells share can be condensed cell by cell: use a "
                "discontinuous element, such as ('DG', 0), ('DG', 1), or ('DPC', 1) on hexahedra, "
                "and a list of several fields in the place of a vector."
            )
