# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Whether a checkpoint is one of this problem, by its mesh, elements, forms and Constants.

Coordinates are compared by their extent and by a mean over the vertices x of all cells,

.. math:: \frac 1 n \sum_{c,k} w_{ck}\, x_{ck}, \qquad w_{ck} ∈ [-1, 1],

whose weights follow from the indices of cell and vertex in the input mesh. They are
equidistributed, so that another order of the cells gives another mean.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx

from dolfinx_feti.fem.user_forms.form_content import FormContent
from dolfinx_feti.runtime.compat import dolfinx_version, geometry_dofmap

__all__ = ["describe_problem", "differences"]

#: Relative difference of coordinates, in the extent of the mesh, that is rounding. A mesh may have
#: been read from text with 12 digits; another mesh differs by the size of a cell. Any value between
#: 1e-12 and 1e-6 separates the two.
MESH_RTOL = 1e-10

#: Inverse of the golden ratio, whose multiples, modulo 1, are equidistributed (Weyl's sequence).
INVERSE_GOLDEN_RATIO = (np.sqrt(5.0) - 1.0) / 2.0


def describe_problem(
    functions: Sequence[dolfinx.fem.Function], content: FormContent | None, changing: Sequence[int]
) -> dict[str, Any]:
    """Return what identifies a problem, as JSON can hold it. Collective.

    Args:
        functions: Functions on one mesh.
        content: Forms and Constants of the problem, if there is one.
        changing: Indices, among the Constants, of those that steps change; their values are left
            out.
    """
    mesh = functions[0].function_space.mesh
    x = mesh.geometry.x
    cells = mesh.topology.index_map(mesh.topology.dim)
    constants = {}
    if content is not None:
        for i, constant in enumerate(content.constants):
            if i not in changing:
                constants[str(i)] = np.asarray(constant.value).tolist()
    return {
        "cells": cells.size_global,
        "vertices": mesh.geometry.index_map().size_global,
        "elements": [str(f.function_space.ufl_element()) for f in functions],
        "extent": mesh.comm.allreduce(float(np.abs(x).max(initial=0.0)), op=MPI.MAX),
        "coordinates": _weighted_mean(mesh),
        "forms": None if content is None else content.signature,
        "dolfinx": dolfinx_version(),
        "constants": constants,
        "changing": list(changing),
    }


def differences(
    there: Mapping[str, Any], here: Mapping[str, Any], *, compare_forms: bool
) -> list[str]:
    """Return the differences of two problems, in words.

    Args:
        there: What :func:`describe_problem` returned when the checkpoint was written.
        here: What it returns now.
        compare_forms: Whether to compare forms and Constants, too.
    """
    messages = [
        f"{name} are {there[name]} there and {here[name]} here"
        for name in ("cells", "vertices", "elements")
        if there[name] != here[name]
    ]
    x_there = [there["extent"], *there["coordinates"]]
    x_here = [here["extent"], *here["coordinates"]]
    if not np.allclose(x_there, x_here, rtol=0.0, atol=MESH_RTOL * there["extent"]):
        messages.append("the extent of the mesh or the order of its cells differs")
    if not compare_forms:
        return messages
    if there["forms"] != here["forms"]:
        messages.append(_difference_of_forms(there, here))
        return messages
    for i, value in there["constants"].items():
        if value != here["constants"][i]:
            messages.append(
                f"a Constant of the forms is {value} there and {here['constants'][i]} here"
            )
    return messages


def _difference_of_forms(there: Mapping[str, Any], here: Mapping[str, Any]) -> str:
    """Return the difference of two problems with different forms, in words.

    The same program can have other forms with another version of dolfinx.
    """
    text = "its forms, such as the energy of a material, or numbers in them, differ"
    version_there = there.get("dolfinx", "of an unknown version")
    version_here = here["dolfinx"]
    if version_there == version_here:
        return text
    return (
        f"{text}. It was written with dolfinx {version_there}, and this is {version_here}: another "
        "version makes other forms of the same program, and if that is all that has changed, pass "
        "allow_changes=True"
    )


def _weighted_mean(mesh: dolfinx.mesh.Mesh) -> list[float]:
    """Return the weighted mean of the coordinates, (3,), see the head of the file. Collective."""
    cells = mesh.topology.index_map(mesh.topology.dim)
    nodes = geometry_dofmap(mesh)[: cells.size_local]
    cell_indices = np.asarray(mesh.topology.original_cell_index)[: cells.size_local, None]
    indices = cell_indices * nodes.shape[1] + np.arange(nodes.shape[1])
    fractions = np.modf(indices * INVERSE_GOLDEN_RATIO)[0]
    weights = 2.0 * fractions - 1.0
    sums = mesh.comm.allreduce(np.einsum("ck,ckd->d", weights, mesh.geometry.x[nodes]), op=MPI.SUM)
    means: list[float] = (sums / cells.size_global).tolist()
    return means
