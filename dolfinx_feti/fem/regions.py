# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Cell integrals by region: all cells, or those with one number in the data of the measure.

As in dolfinx, the integrals of a number are one integrand, whose quadrature degree UFL estimates;
an integral over several numbers belongs to each of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.fem.kernels.kernel import Kernel, create_kernels
from dolfinx_feti.runtime.arrays import Indices

#: No cells.
NONE = np.zeros(0, dtype=np.int32)


def compile_cells(
    forms: Sequence[ufl.Form], mesh: dolfinx.mesh.Mesh, cache: Path | None = None
) -> tuple[list[tuple[list[int], Kernel]], list[ufl.Form]]:
    """Compile the integrals over cells of forms on a mesh, a kernel for each region and degree.

    Returns kernels, each with the numbers of its forms, and of each form what is left to dolfinx:
    other integrals, and those that only FFCx can compile. Collective.
    """
    groups: dict[tuple[int | str, int], dict[int, list[ufl.Integral]]] = {}
    known: dict[tuple[int | str, int], Indices | None] = {}
    rest = [ufl.Form([]) for _ in forms]
    for i, form in enumerate(map(ufl.algorithms.expand_derivatives, forms)):
        data, cells = _cells_of_numbers(form, mesh)
        for integral in form.integrals():
            numbers = _numbers(integral)
            if not numbers or (cells is None and numbers != ["everywhere"]):
                rest[i] += ufl.Form([integral])
                continue
            for number in numbers:
                key = number, 0 if number == "everywhere" else data
                part = integral.reconstruct(subdomain_id=number)
                groups.setdefault(key, {}).setdefault(i, []).append(part)
                known[key] = None if number == "everywhere" else (cells or {}).get(number, NONE)
    kernels = []
    for key, group in groups.items():
        numbered = list(group)
        inside = [
            ufl.Form([integral.reconstruct(subdomain_id="everywhere") for integral in integrals])
            for integrals in group.values()
        ]
        created = create_kernels(inside, mesh, known[key], cache)
        if created is not None:
            kernels += [([numbered[i] for i in each], kernel) for each, kernel in created]
            continue
        for i, integrals in group.items():
            rest[i] += ufl.Form(integrals)
    return kernels, rest


def _numbers(integral: ufl.Integral) -> list[int | str]:
    """Return the numbers of an integral over cells, or "everywhere"; none of another one."""
    rule, numbers = integral.metadata().get("quadrature_rule", "default"), integral.subdomain_id()
    if integral.integral_type() != "cell" or rule != "default":
        return []
    numbers = numbers if isinstance(numbers, tuple) else (numbers,)
    if all(isinstance(number, (int, np.integer)) for number in numbers):
        return list(dict.fromkeys(map(int, numbers)))
    return ["everywhere"] if numbers == ("everywhere",) else []


def _cells_of_numbers(
    form: ufl.Form, mesh: dolfinx.mesh.Mesh
) -> tuple[int, dict[int | str, Indices] | None]:
    """Return the identity of the data of the measures and the owned cells of each number.

    The latter are None if only dolfinx knows: there are several data, or cells that occur twice.
    """
    given = [integral.subdomain_data() for integral in form.integrals_by_type("cell")]
    data = {id(known): known for known in given if known is not None}
    if len(data) != 1:
        return 0, None
    ((key, known),) = data.items()
    topology = mesh.topology
    if isinstance(known, dolfinx.mesh.MeshTags) and known.dim == topology.dim:
        known = [(int(number), known.find(number)) for number in np.unique(known.values)]
    if not isinstance(known, list) or len(dict(known)) < len(known):
        return key, None
    cells = {number: np.asarray(found, dtype=np.int32) for number, found in known}
    if any(len(np.unique(found)) < len(found) for found in cells.values()):
        return key, None
    n = topology.index_map(topology.dim).size_local
    return key, {number: found[(found >= 0) & (found < n)] for number, found in cells.items()}
