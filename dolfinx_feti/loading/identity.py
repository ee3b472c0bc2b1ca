# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The identity of a problem: mesh, elements, forms, constants, and in what two problems differ."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx

from dolfinx_feti.fem.content import Content
from dolfinx_feti.runtime.compat import geometry_dofmap

__all__ = [
    "describe",
    "describe_forms",
    "other_forms",
    "other_mesh",
    "other_parameters",
    "plain",
    "plain_parameters",
]

#: How closely the mesh has to agree, relative to its extent: digits that a file of text may lose.
CLOSE = 1e-10


def describe(functions: Sequence[dolfinx.fem.Function]) -> dict[str, Any]:
    """Describe mesh and elements, equally for any number of processes.

    Returns:
        Numbers of cells and vertices; the mean over the cells of their vertices, each weighted by a
        number that follows from its place in the input, so that it depends on their order;
        the extent of the mesh, and the elements.

    Note:
        Collective.
    """
    mesh = functions[0].function_space.mesh
    cells = mesh.topology.index_map(mesh.topology.dim)
    nodes = geometry_dofmap(mesh)[: cells.size_local]
    place = np.asarray(mesh.topology.original_cell_index)[: cells.size_local, None]
    place = place * nodes.shape[1] + np.arange(nodes.shape[1])
    weights = 2.0 * np.modf(place * ((np.sqrt(5.0) - 1.0) / 2.0))[0] - 1.0  # equidistributed
    x = mesh.geometry.x
    sums = mesh.comm.allreduce(np.einsum("ck,ckd->d", weights, x[nodes]), op=MPI.SUM)
    extent = mesh.comm.allreduce(float(np.abs(x).max(initial=0.0)), op=MPI.MAX)
    return {
        "cells": cells.size_global,
        "vertices": mesh.geometry.index_map().size_global,
        "extent": extent,
        "coordinates": (sums / cells.size_global).tolist(),
        "elements": [str(f.function_space.ufl_element()) for f in functions],
    }


def describe_forms(content: Content | None, moving: Sequence[int]) -> dict[str, Any]:
    """Describe forms and the constants in them that the steps leave alone."""
    if content is None:
        return {"forms": None, "moving": list(moving), "constants": {}}
    constants = {
        str(i): np.asarray(c.value).tolist()
        for i, c in enumerate(content.constants)
        if i not in moving
    }
    return {"forms": content.signature(), "moving": list(moving), "constants": constants}


def other_mesh(saved: Mapping[str, Any], present: Mapping[str, Any]) -> list[str]:
    """Say in what mesh and elements differ."""
    differences = [
        f"{name} are {saved[name]} there and {present[name]} here"
        for name in ("cells", "vertices", "elements")
        if saved[name] != present[name]
    ]
    for name in ("extent", "coordinates"):
        if not np.allclose(saved[name], present[name], rtol=0.0, atol=CLOSE * saved["extent"]):
            differences.append(f"the {name} of the mesh or the order of its cells are others")
            break
    return differences


def other_forms(saved: Mapping[str, Any], present: Mapping[str, Any]) -> list[str]:
    """Say in what forms and constants differ."""
    if saved["forms"] != present["forms"]:
        return ["its forms, such as the energy of a material, or numbers in them, are others"]
    return [
        f"a Constant of the forms is {value} there and {present['constants'][i]} here"
        for i, value in saved["constants"].items()
        if value != present["constants"][i]
    ]


def other_parameters(saved: Mapping[str, Any], present: Mapping[str, Any]) -> list[str]:
    """Say which parameters differ."""
    names = sorted(saved.keys() | present.keys())
    values = [
        (name, saved.get(name, "not given"), present.get(name, "not given")) for name in names
    ]
    return [f"{name} is {a} there and {b} here" for name, a, b in values if a != b]


def plain_parameters(parameters: Mapping[str, object]) -> dict[str, Any]:
    """Return parameters as they come back from a file.

    Raises:
        ValueError: A value is something else than what JSON holds.
    """
    for name, value in parameters.items():
        try:
            plain({name: value})
        except TypeError as error:
            raise ValueError(
                f"parameters[{name!r}] is {value!r}: give numbers, strings, or lists of them."
            ) from error
    return plain(parameters)


def plain(record: Mapping[str, object]) -> dict[str, Any]:
    """Return what JSON makes of a record, and of NumPy's numbers and arrays in it.

    Raises:
        TypeError: There is more in it than JSON holds.
    """
    return json.loads(json.dumps(dict(record), default=_plain_number))


def _plain_number(value: object) -> object:
    """Return NumPy's numbers and arrays as Python's."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"{value!r} is no number, string, or list")
