# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The cell integrals of forms by region: all cells, or those of one number, as in ``dx(3)``.

The data of a measure, ``subdomain_data``, determine the cells of each number. As in dolfinx, all
integrals over one region are one integrand, and an integral over several numbers belongs to the
region of each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.runtime.arrays import Indices

#: UFL's name for a measure without a number.
EVERYWHERE = "everywhere"

NO_CELLS: Indices = np.zeros(0, dtype=np.int32)


@dataclass(frozen=True, slots=True)
class Region:
    """Cells, and the integrals over them.

    Attributes:
        cells: Owned cells, (n_cells,); None for all of them.
        integrals: Integrals of each form over the cells, by the index of the form.
    """

    cells: Indices | None
    integrals: dict[int, list[ufl.Integral]] = field(default_factory=dict)

    def forms(self) -> list[ufl.Form]:
        """Return a form of all cells for each form with integrals over the region."""
        forms = []
        for integrals in self.integrals.values():
            everywhere = [part.reconstruct(subdomain_id=EVERYWHERE) for part in integrals]
            forms.append(ufl.Form(everywhere))
        return forms


@dataclass(frozen=True, slots=True)
class _MeasureData:
    """The data of the measures of a form.

    Attributes:
        identity: ``id`` of the data, which the form keeps alive; equal for forms with the same
            data, and 0 without any.
        cells: Owned cells of each number; None if only dolfinx knows them.
    """

    identity: int
    cells: Mapping[int, Indices] | None


def split_by_region(
    forms: Sequence[ufl.Form], mesh: dolfinx.mesh.Mesh
) -> tuple[list[Region], list[ufl.Form]]:
    """Split the integrals of forms into regions, and other integrals.

    Args:
        forms: Forms without unevaluated derivatives.
        mesh: Their mesh.

    Returns:
        The regions, and for each form a form of its other integrals, which may be empty: integrals
        over facets and vertices, with another quadrature rule than the default, or over cells that
        only dolfinx can determine.
    """
    regions: dict[tuple[int | str, int], Region] = {}  # by number and identity of the data
    others = [ufl.Form([]) for _ in forms]
    for i, form in enumerate(forms):
        data = _measure_data(form, mesh)
        for integral in form.integrals():
            if not _is_default_cell_integral(integral):
                others[i] += ufl.Form([integral])
                continue
            numbers = _numbers(integral)
            if numbers == [EVERYWHERE]:
                region = regions.setdefault((EVERYWHERE, 0), Region(None))
                region.integrals.setdefault(i, []).append(integral)
            elif numbers and data.cells is not None:
                for number in numbers:
                    cells = data.cells.get(int(number), NO_CELLS)
                    region = regions.setdefault((number, data.identity), Region(cells))
                    part = integral.reconstruct(subdomain_id=number)
                    region.integrals.setdefault(i, []).append(part)
            else:
                others[i] += ufl.Form([integral])
    return list(regions.values()), others


def _is_default_cell_integral(integral: ufl.Integral) -> bool:
    """Return True for an integral over cells with basix's default quadrature rule."""
    rule = integral.metadata().get("quadrature_rule", "default")
    return bool(integral.integral_type() == "cell" and rule == "default")


def _numbers(integral: ufl.Integral) -> list[int | str]:
    """Return the numbers of an integral, each once, or ["everywhere"].

    The list is empty for anything else that UFL allows, such as texts.
    """
    numbers = integral.subdomain_id()
    if not isinstance(numbers, tuple):
        numbers = (numbers,)
    if all(isinstance(number, (int, np.integer)) for number in numbers):
        return list(dict.fromkeys(map(int, numbers)))
    return [EVERYWHERE] if numbers == (EVERYWHERE,) else []


def _measure_data(form: ufl.Form, mesh: dolfinx.mesh.Mesh) -> _MeasureData:
    """Return the data of the measures of a form's integrals over cells."""
    data = [integral.subdomain_data() for integral in form.integrals_by_type("cell")]
    different = {id(each): each for each in data if each is not None}
    if len(different) != 1:
        return _MeasureData(0, None)
    ((identity, tags),) = different.items()
    topology = mesh.topology
    if isinstance(tags, dolfinx.mesh.MeshTags) and tags.dim == topology.dim:
        tags = [(int(number), tags.find(number)) for number in np.unique(tags.values)]
    if not isinstance(tags, list):
        return _MeasureData(identity, None)
    is_number_repeated = len({number for number, _ in tags}) < len(tags)
    if is_number_repeated:
        return _MeasureData(identity, None)
    n_owned = topology.index_map(topology.dim).size_local
    cells = {}
    for number, listed in tags:
        numbered = np.asarray(listed, dtype=np.int32)
        if len(np.unique(numbered)) < len(numbered):  # dolfinx integrates such a cell twice
            return _MeasureData(identity, None)
        cells[number] = numbered[(numbered >= 0) & (numbered < n_owned)]
    return _MeasureData(identity, cells)
