# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Cell integrals by region: all cells, or those with one number in the data of the measure.

As in dolfinx, the integrals of a number are one integrand, whose quadrature degree UFL estimates;
an integral over several numbers belongs to each of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.runtime.arrays import Indices

__all__ = ["Region", "separate"]


@dataclass(frozen=True, slots=True)
class Region:
    """The integrals of a form over a part of the cells.

    Attributes:
        name: Number of the part and identity of the data that have it; None for all cells.
        cells: Its owned cells; None for all.
        inside: The integrals as if they were over all cells, so that parts of one material have
            one signature.
        form: The integrals as they are.
    """

    name: tuple[int, int] | None
    cells: Indices | None
    inside: ufl.Form
    form: ufl.Form


def separate(form: ufl.Form, mesh: dolfinx.mesh.Mesh) -> tuple[list[Region], ufl.Form]:
    """Separate the integrals over cells, by a rule of basix, from the others.

    Args:
        form: The form.
        mesh: Its mesh.

    Returns:
        The regions, and the form of all other integrals.
    """
    data = _data(form)
    groups: dict[int | None, list[ufl.Integral]] = {}
    others = []
    for integral in form.integrals():
        numbers = _numbers(integral)
        if numbers is None or (numbers != (None,) and not _tells(data, mesh)):
            others.append(integral)
            continue
        for number in numbers:
            one = integral if number is None else integral.reconstruct(subdomain_id=number)
            groups.setdefault(number, []).append(one)
    regions = [
        Region(
            None if number is None else (number, id(data[0])),
            None if number is None else _cells(data[0], number, mesh),
            ufl.Form([integral.reconstruct(subdomain_id="everywhere") for integral in integrals]),
            ufl.Form(integrals),
        )
        for number, integrals in groups.items()
    ]
    return regions, ufl.Form(others)


def _data(form: ufl.Form) -> list[object]:
    """Return the data of the measures of cells, each once."""
    given = [i.subdomain_data() for i in form.integrals() if i.integral_type() == "cell"]
    return list({id(data): data for data in given if data is not None}.values())


def _numbers(integral: ufl.Integral) -> tuple[int | None, ...] | None:
    """Return the numbers of an integral over cells, (None,) for all; None for another one."""
    rule = integral.metadata().get("quadrature_rule", "default")
    if integral.integral_type() != "cell" or rule != "default":
        return None
    known = integral.subdomain_id()
    if known == "everywhere":
        return (None,)
    numbers = known if isinstance(known, tuple) else (known,)
    integers = all(isinstance(number, (int, np.integer)) for number in numbers)
    return tuple(dict.fromkeys(map(int, numbers))) if integers else None


def _tells(data: list[object], mesh: dolfinx.mesh.Mesh) -> bool:
    """Whether the data of a form say which cells have a number, each cell once."""
    if len(data) != 1:
        return False
    (known,) = data
    if isinstance(known, dolfinx.mesh.MeshTags):
        return bool(known.dim == mesh.topology.dim)
    if not isinstance(known, list):
        return False
    numbers = [number for number, _ in known]
    once = all(len(np.unique(cells)) == len(cells) for _, cells in known)
    return once and len(set(numbers)) == len(numbers)


def _cells(data: object, number: int, mesh: dolfinx.mesh.Mesh) -> Indices:
    """Return the owned cells with a number."""
    if isinstance(data, dolfinx.mesh.MeshTags):
        found = data.find(number)
    else:
        assert isinstance(data, list)
        found = np.asarray(dict(data).get(number, ()))
    owned = mesh.topology.index_map(mesh.topology.dim).size_local
    return found[(found >= 0) & (found < owned)].astype(np.int32)
