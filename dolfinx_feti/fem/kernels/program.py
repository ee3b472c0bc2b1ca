# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""From UFL's forms to what ``kernel.c`` reads: tapes, tables of basis functions, and blocks.

.. math:: r[ai] = \sum_{q J} P_q[iJ]\, ∂_J φ_a, \qquad
          K[ai, bk] = \sum_{q L} \Bigl(\sum_J A_q[iJ, kL]\, ∂_J φ_a\Bigr)\, ∂_L φ_b.

A block is one pair of components i, k. Where A_st and A_ts are one value of the tape for all slots,
K is symmetric, and half of it is mirrored. An argument that a form has not is a constant.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np
import numpy.typing as npt

import basix
import basix.ufl
import dolfinx
import ufl

from dolfinx_feti.fem.kernels.integrand import Point, Slot, place, scalar_element
from dolfinx_feti.fem.kernels.tape import HEADER

#: Most points of an instruction, most groups of eight cells that have them, bytes of a number each.
POINTS, GROUPS, VECTOR = 22, 12, 64


@dataclass(frozen=True, slots=True)
class Program:
    """What is made of forms whose integrals have one quadrature degree."""

    shapes: dict[int, tuple[int, ...]]  # dofs of a cell for each argument, of each form's number
    text: str  # sizes of loops and instructions, in C
    fields: dict[str, int | npt.NDArray[Any]]  # of C's structure


def generate(
    forms: Sequence[ufl.Form],
    mesh: dolfinx.mesh.Mesh,
    functions: Sequence[dolfinx.fem.Function],
    constants: Sequence[dolfinx.fem.Constant],
) -> list[Program]:
    """Write the programs, one for each quadrature degree, for forms with these coefficients."""
    points: dict[int, Point] = {}
    for number, form in enumerate(forms):
        data = ufl.algorithms.compute_form_data(
            form,
            do_apply_integral_scaling=True,
            do_apply_default_restrictions=False,
            do_append_everywhere_integrals=False,
        )
        for integral in (i for group in data.integral_data for i in group.integrals):
            if any(e.has_custom_quadrature for e in ufl.algorithms.extract_elements(integral)):
                raise NotImplementedError("points of a quadrature element")
            known = integral.metadata()  # as FFCx reads it
            degree = int(known.get("quadrature_degree", -1))
            if degree < 0:
                degree = int(np.max(known["estimated_polynomial_degree"]))
            point = points.setdefault(degree, Point(mesh, functions, constants))
            point.add(number, integral.integrand(), len(form.arguments()))
    return [_program(forms, mesh, functions, degree, point) for degree, point in points.items()]


def _program(
    forms: Sequence[ufl.Form],
    mesh: dolfinx.mesh.Mesh,
    functions: Sequence[dolfinx.fem.Function],
    degree: int,
    point: Point,
) -> Program:
    """Write the program of one quadrature degree."""
    cell, gdim = mesh.basix_cell(), mesh.geometry.dim
    x, weights = map(np.asarray, basix.make_quadrature(cell, degree))
    chunks = -(-len(weights) // POINTS)
    n = -(-len(weights) // chunks)
    groups = max(1, min(POINTS // n, GROUPS))
    rest = chunks * n - len(weights)  # points without weight fill the last chunk
    x, weights = np.concatenate([x, np.repeat(x[-1:], rest, axis=0)]), np.pad(weights, (0, rest))

    factors = {value for _, found in point.terms for value in found.values()}
    tape, register, registers = point.tape.program(factors, VECTOR * n * groups)
    shapes: dict[int, tuple[int, ...]] = {}
    begin = [0]
    one = Slot(place(point.elements, basix.ufl.element("DG", cell.name, 0)), 1, 0, 0)
    contractions: list[int] = []
    for number, found in point.terms:  # form after form
        if number not in shapes:
            arguments = map(scalar_element, forms[number].arguments())
            shapes[number] = tuple(e.dim * block for e, block in arguments)
            begin.append(begin[-1] + math.prod(shapes[number]))
        slots = {(one, one, *s)[-2:]: register[value] for s, value in found.items()}
        contractions += _blocks(slots, begin[-2], (1, *shapes[number])[-1])

    used = [(point.elements[0], 3), *map(scalar_element, functions)]
    element = [place(point.elements, e) for e, _ in used]
    nodes = [e.dim for e in point.elements]
    basis = [(1 + gdim) * m for m in nodes]
    sizes = [registers * n * groups, *(n * groups * b for b in basis)]
    sizes += [e.dim * block * groups for e, block in used]
    sizes += [max(basis) * n * groups, begin[-1] * groups]
    places = list(accumulate(sizes))  # of what follows the tape's registers
    tables = [np.moveaxis(np.asarray(e.tabulate(1, x)), 0, -1).ravel() for e in point.elements]
    straight = point.elements[0].degree == 1 and len(basix.topology(cell)[gdim][0]) == gdim + 1
    data: dict[str, Any] = {
        "size": begin[-1],
        "forms": len(shapes),
        "elements": len(nodes),
        "functions": len(used),
        "chunks": chunks,
        "affine": int(straight),
        "products": places[-3],
        "out": places[-2],
        "vectors": places[-1],
        "weight": weights,
        "table": np.concatenate(tables),
        "literals": np.array([*point.tape.literals.values()]),
        "tape": tape,
        "begin": begin,
        "nodes": nodes,
        "gradients": [e in point.gradients for e in range(len(nodes))],
        "tables": [0, *accumulate(map(len, tables))],
        "element": element,
        "block": [block for _, block in used],
        "phi": places[: len(nodes)],
        "w": places[len(nodes) : -3],
        "contractions": [*contractions, -1],
    }
    lists = {k: np.array(v, dtype=np.int32) for k, v in data.items() if isinstance(v, list)}
    text = f"enum {{ GDIM = {gdim}, N = {n}, GROUPS = {groups} }};{HEADER}"
    return Program(shapes, text, {**data, **lists})


def _blocks(factors: Mapping[tuple[Slot, ...], int], first: int, width: int) -> list[int]:
    """Return the blocks of a form for C, from registers under the slots of rows and columns."""
    symmetric = all(factors.get((u, v)) == value for (v, u), value in factors.items())
    blocks: dict[tuple[int, int], dict[int, list[int]]] = {}
    for (v, u), value in factors.items():
        columns = blocks.setdefault((v.component, u.component), {})
        columns.setdefault(u.direction, []).extend((v.direction, value))
    found: list[int] = []
    for (i, k), columns in blocks.items():
        if symmetric and i > k:
            continue
        mirrored = first + k * width + i if symmetric else -1
        v, u = next(iter(factors))
        found += [v.element, u.element, first + i * width + k, mirrored, v.block * width, u.block]
        found += [len(columns), *columns]
        for pairs in columns.values():
            found += [len(pairs) // 2, *pairs]
    return found
