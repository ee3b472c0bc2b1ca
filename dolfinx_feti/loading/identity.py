# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The identity of a problem: mesh, elements and parameters, and in what two problems differ."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx

from dolfinx_feti.runtime.compat import geometry_dofmap

__all__ = ["describe", "other_parameters", "other_problem", "plain", "plain_record"]

#: How closely the mesh has to agree, relative to its extent: digits that a file of text may lose.
CLOSE = 1e-10


def describe(functions: Sequence[dolfinx.fem.Function]) -> dict[str, Any]:
    """Describe mesh and elements, equally for any number of processes.

    Args:
        functions: Functions on one mesh.

    Returns:
        Numbers of cells and vertices; the mean over the cells of their vertices, each weighted by a
        number that follows from its place in the input, so that it depends on their order;
        the extent of the mesh, and the elements.

    Raises:
        ValueError: A process has no cell, which the libraries that write states do not know how
            to handle.

    Note:
        Collective.
    """
    mesh = functions[0].function_space.mesh
    cells = mesh.topology.index_map(mesh.topology.dim)
    if mesh.comm.allreduce(cells.size_local, op=MPI.MIN) == 0:
        raise ValueError(
            f"{cells.size_global} cells on {mesh.comm.size} processes leave one without a cell: "
            "checkpoints need fewer processes or a finer mesh."
        )
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


def other_problem(saved: Mapping[str, Any], present: Mapping[str, Any]) -> list[str]:
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


def other_parameters(saved: Mapping[str, Any], present: Mapping[str, Any]) -> list[str]:
    """Say which parameters differ."""
    names = sorted(saved.keys() | present.keys())
    values = [
        (name, saved.get(name, "not given"), present.get(name, "not given")) for name in names
    ]
    return [f"{name} is {a} there and {b} here" for name, a, b in values if a != b]


def plain(parameters: Mapping[str, object]) -> dict[str, Any]:
    """Return parameters as they come back from a file.

    Raises:
        ValueError: A value is something else than what JSON holds.
    """
    for name, value in parameters.items():
        try:
            plain_record({name: value})
        except TypeError as error:
            raise ValueError(
                f"parameters[{name!r}] is {value!r}: give numbers, strings, or lists of them."
            ) from error
    return plain_record(parameters)


def plain_record(record: Mapping[str, object]) -> dict[str, Any]:
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
