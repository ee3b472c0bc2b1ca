# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checks of the user's spaces and forms before any work.

Forms and spaces are equal on all processes, so that a check fails on all of them or on none.
"""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np

import basix
import dolfinx
import ufl
from ufl.corealg.traversal import traverse_unique_terminals


def check_scalar_type() -> None:
    """Check that PETSc has real numbers in double precision.

    Raises:
        TypeError: PETSc is complex or in single precision.
    """
    if np.dtype(PETSc.ScalarType) != np.float64:
        raise TypeError(
            f"PETSc's scalars are {np.dtype(PETSc.ScalarType)}, but dolfinx_feti needs real double "
            "precision (float64): point PETSC_DIR and PETSC_ARCH to such a build. With it, write a "
            "complex unknown as a real one with two components. Or solve the complex problem by "
            "dolfinx, with MUMPS."
        )


def check_space(V: dolfinx.fem.FunctionSpace) -> None:
    """Check a space: a continuous element, scalar or blocked, on a mesh in double precision.

    Raises:
        TypeError: It has another element or mesh.
    """
    if V.mesh.geometry.x.dtype != np.float64:
        raise TypeError(
            f"The mesh has coordinates of type {V.mesh.geometry.x.dtype}, but dolfinx_feti needs "
            "float64: create it with dtype=numpy.float64."
        )
    element = V.ufl_element()
    parts = element.sub_elements or [element]  # a blocked element has one for each component
    has_scalar_parts = len(parts) == element.block_size and parts[0].reference_value_shape == ()
    is_continuous = element.basix_sobolev_space == basix.SobolevSpace.H1
    if not has_scalar_parts or not is_continuous or element.discontinuous:
        raise TypeError(
            f"The space has the element {element}, but tearing needs a continuous element, scalar "
            "or blocked: use ('Lagrange', k) or ('Lagrange', k, (dim,)), perhaps enriched by "
            "bubbles (basix.ufl.enriched_element). Solve methods that need H(div), H(curl) or "
            "discontinuous unknowns by dolfinx, with MUMPS."
        )


def check_forms(V: dolfinx.fem.FunctionSpace | None, **forms: tuple[ufl.Form, int]) -> None:
    """Check the ranks of forms, and that their arguments are in one space.

    Args:
        V: The space; None if the forms determine none, which only forms without arguments pass.
        forms: A form and its rank, by the name of the user's argument.

    Raises:
        ValueError: A form has another number of arguments, or one in another space.
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


def check_trial_functions(**forms: object) -> None:
    """Check that energies and residuals are not written in a TrialFunction, as linear forms are.

    Args:
        forms: A form or a sequence of forms, by the name of the user's argument; anything else is
            not checked here.

    Raises:
        ValueError: A form has a TrialFunction, but no TestFunction.
    """
    for name, one_or_several in forms.items():
        listed = one_or_several if isinstance(one_or_several, Sequence) else [one_or_several]
        for form in listed:
            if not isinstance(form, ufl.Form):
                continue
            numbers = {argument.number() for argument in form.arguments()}
            if numbers == {1}:
                raise ValueError(
                    f"{name} contains a TrialFunction: write it in the unknown instead, the "
                    "dolfinx.fem.Function u that is passed beside it. A nonlinear problem takes an "
                    "energy, or a residual with a TestFunction; it derives the tangent itself."
                )


def shares_no_dofs(Q: dolfinx.fem.FunctionSpace) -> bool:
    """Return True if no two cells of any process share a dof of the space. Not collective.

    If cells share no dofs, there are as many dofs as cells times dofs of a cell. Every process has
    these numbers of the whole mesh.
    """
    topology = Q.mesh.topology
    dofmap = Q.dofmap
    cells = topology.index_map(topology.dim).size_global
    return bool(cells * dofmap.list.shape[1] == dofmap.index_map.size_global)


def check_meshes(V: dolfinx.fem.FunctionSpace, **forms: ufl.Form) -> None:
    """Check that coefficients, coordinates and integrals of forms are on the mesh of the unknown.

    Args:
        V: Space of the unknown.
        forms: Forms by the name of the user's argument.

    Raises:
        ValueError: One is on another mesh.
    """
    mesh = V.mesh
    for name, form in forms.items():
        for f in form.coefficients():
            if isinstance(f, dolfinx.fem.Function) and not _is_same(f.function_space.mesh, mesh):
                raise ValueError(
                    f"{name} contains the Function '{f.name}' on another mesh than the unknown: "
                    "create it on the mesh of the unknown, and fill it by interpolate, or by "
                    "interpolate_nonmatching if the meshes do not match."
                )
        domains = set(form.ufl_domains())
        for integral in form.integrals():
            for terminal in traverse_unique_terminals(integral.integrand()):
                if isinstance(terminal, ufl.classes.GeometricQuantity):
                    domains.add(terminal.ufl_domain())
        if domains - {mesh.ufl_domain()}:
            raise ValueError(
                f"{name} has an integral or a coordinate of another mesh than the unknown: give "
                "the mesh to the measures, ufl.Measure('dx', mesh), and to SpatialCoordinate and "
                "FacetNormal."
            )


def _is_same(one: dolfinx.mesh.Mesh, other: dolfinx.mesh.Mesh) -> bool:
    """Return True if two meshes are one C++ object, which may have several Python objects."""
    return bool(one._cpp_object == other._cpp_object)


def check_condensed(fields: Sequence[dolfinx.fem.Function], u: dolfinx.fem.Function) -> None:
    """Check that fields can be condensed: on the mesh of u, with dofs that no two cells share.

    Raises:
        TypeError: One is no Function, or has another element.
        ValueError: One is u, occurs twice, or is on another mesh.
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
        Q = p.function_space
        if not _is_same(Q.mesh, u.function_space.mesh):
            raise ValueError(
                f"condense[{i}] is '{p.name}' on another mesh than the unknown: create it on the "
                "mesh of the unknown."
            )
        if not shares_no_dofs(Q):
            raise TypeError(
                f"condense[{i}] is '{p.name}' with the element {Q.ufl_element()}, but only fields "
                "whose dofs no two cells share can be condensed cell by cell: use a discontinuous "
                "element, such as ('DG', 0), ('DG', 1), or ('DPC', 1) on hexahedra."
            )
