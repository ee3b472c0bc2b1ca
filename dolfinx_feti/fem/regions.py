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


def compile_cells(
    forms: Sequence[ufl.Form], mesh: dolfinx.mesh.Mesh, cache: Path | None = None
) -> tuple[list[tuple[list[int], Kernel]], list[ufl.Form]]:
    """Compile the integrals over cells of forms on a mesh, a kernel for each region and degree.

    The C code is kept in ``cache``, or in the package's own folder.

    Returns:
        Kernels, each with the numbers of its forms, and of each form what is left to dolfinx: other
        integrals, and those that only FFCx can compile.

    Note:
        Collective.
    """
    groups: dict[tuple[int | None, int], dict[int, list[ufl.Integral]]] = {}
    known: dict[tuple[int | None, int], Indices] = {}
    rest = []
    for i, form in enumerate(map(ufl.algorithms.expand_derivatives, forms)):
        data, cells = _cells_of_numbers(form, mesh)
        others = []
        for integral in form.integrals():
            numbers = _numbers(integral)
            if numbers is None or (cells is None and numbers != [None]):
                others.append(integral)
                continue
            for number in numbers:
                key = number, 0 if number is None else data
                groups.setdefault(key, {}).setdefault(i, []).append(integral)
                if number is not None and cells is not None:
                    known[key] = _owned(cells.get(number, ()), mesh)
        rest.append(ufl.Form(others))
    kernels = []
    for key, group in groups.items():
        inside = [ufl.Form([_over("everywhere", i) for i in each]) for each in group.values()]
        created = create_kernels(inside, mesh, known.get(key), cache)
        if created is not None:
            known_as = list(group)
            kernels += [([known_as[i] for i in forms], kernel) for forms, kernel in created]
            continue
        for i, integrals in group.items():
            part = "everywhere" if key[0] is None else key[0]
            rest[i] += ufl.Form([_over(part, integral) for integral in integrals])
    return kernels, rest


def _over(part: int | str, integral: ufl.Integral) -> ufl.Integral:
    """Return the same integral over another part of the domain."""
    return integral.reconstruct(subdomain_id=part)


def _numbers(integral: ufl.Integral) -> list[int | None] | None:
    """Return the numbers of an integral over cells, [None] for all; None for another one."""
    rule = integral.metadata().get("quadrature_rule", "default")
    if integral.integral_type() != "cell" or rule != "default":
        return None
    numbers = integral.subdomain_id()
    if numbers == "everywhere":
        return [None]
    numbers = numbers if isinstance(numbers, tuple) else (numbers,)
    integers = all(isinstance(number, (int, np.integer)) for number in numbers)
    return list(dict.fromkeys(map(int, numbers))) if integers else None


def _cells_of_numbers(
    form: ufl.Form, mesh: dolfinx.mesh.Mesh
) -> tuple[int, dict[int, Indices] | None]:
    """Return the identity of the data of the measures and the cells of each number.

    The latter are None if only dolfinx knows: there are several data, or cells that occur twice.
    """
    given = [i.subdomain_data() for i in form.integrals() if i.integral_type() == "cell"]
    data = {id(known): known for known in given if known is not None}
    if len(data) != 1:
        return 0, None
    ((key, known),) = data.items()
    if isinstance(known, dolfinx.mesh.MeshTags) and known.dim == mesh.topology.dim:
        return key, {int(number): known.find(number) for number in np.unique(known.values)}
    if not isinstance(known, list) or len(dict(known)) < len(known):
        return key, None
    once = all(len(np.unique(cells)) == len(cells) for _, cells in known)
    return key, dict(known) if once else None


def _owned(cells: Sequence[int] | Indices, mesh: dolfinx.mesh.Mesh) -> Indices:
    """Return those of the cells that this process owns."""
    found = np.asarray(cells, dtype=np.int32)
    owned = mesh.topology.index_map(mesh.topology.dim).size_local
    return found[(found >= 0) & (found < owned)]
