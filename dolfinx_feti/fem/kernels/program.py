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
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np
import numpy.typing as npt

import basix
import basix.ufl
import dolfinx
import ufl

from dolfinx_feti.fem.kernels.integrand import Point, Slot, UnsupportedError, place, scalar_element
from dolfinx_feti.fem.kernels.tape import HEADER
from dolfinx_feti.runtime.arrays import Array

__all__ = ["Program", "generate"]

#: Most points of an instruction, most groups of eight cells that have them, bytes of a number each.
POINTS, GROUPS, VECTOR = 22, 12, 64


@dataclass(frozen=True, slots=True)
class Program:
    """What is made of forms whose integrals have one quadrature degree.

    Attributes:
        shapes: Dofs of a cell for each argument, under the number of each form.
        functions: Which of their coefficients are gathered.
        constants: Which of their constants are read.
        text: Sizes of loops and instructions, in C.
        numbers: Integers of C's structure.
        arrays: Its arrays.
        tables: Basis functions of each element and their derivatives.
    """

    shapes: dict[int, tuple[int, ...]]
    functions: list[int]
    constants: list[int]
    text: str
    numbers: dict[str, int]
    arrays: dict[str, npt.NDArray[Any]]
    tables: list[Array]


def generate(
    forms: Sequence[ufl.Form],
    mesh: dolfinx.mesh.Mesh,
    functions: Sequence[dolfinx.fem.Function],
    constants: Sequence[dolfinx.fem.Constant],
) -> list[Program]:
    """Write the programs, one for each quadrature degree, for forms with these coefficients.

    Raises:
        UnsupportedError: Only FFCx can compile an integrand.
    """
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
                raise UnsupportedError("points of a quadrature element")
            point = points.setdefault(_degree(integral), Point(mesh))
            point.add(number, integral.integrand(), len(form.arguments()))
    programs = []
    for degree, point in points.items():
        numbers = sorted({number for number, _ in point.terms})
        known = [functions.index(f) for f in point.functions]
        read = [constants.index(c) for c in point.constants]
        shapes = {
            i: tuple(e.dim * block for e, block in map(_element, forms[i].arguments()))
            for i in numbers
        }
        programs.append(Program(shapes, known, read, *_contents(mesh, degree, point, shapes)))
    return programs


def _degree(integral: ufl.Integral) -> int:
    """Return the quadrature degree, as FFCx chooses it."""
    known = integral.metadata()
    stated = int(known.get("quadrature_degree", -1))
    return stated if stated >= 0 else int(np.max(known["estimated_polynomial_degree"]))


def _element(f: ufl.Argument | dolfinx.fem.Function) -> tuple[basix.ufl._ElementBase, int]:
    return scalar_element(f.ufl_function_space())


def _contents(
    mesh: dolfinx.mesh.Mesh, degree: int, point: Point, shapes: Mapping[int, tuple[int, ...]]
) -> tuple[str, dict[str, int], dict[str, npt.NDArray[Any]], list[Array]]:
    """Return what C is compiled with and what it reads, see :class:`Program`."""
    cell, gdim = mesh.basix_cell(), mesh.geometry.dim
    x, weights = map(np.asarray, basix.make_quadrature(cell, degree))
    chunks = -(-len(weights) // POINTS)
    n = -(-len(weights) // chunks)
    groups = max(1, min(POINTS // n, GROUPS))
    rest = chunks * n - len(weights)  # points without weight fill the last chunk
    x, weights = np.concatenate([x, np.repeat(x[-1:], rest, axis=0)]), np.pad(weights, (0, rest))

    one = Slot(place(point.elements, basix.ufl.element("DG", cell.name, 0)), 1, 0, 0)
    factors = {value for _, found in point.terms for value in found.values()}
    tape, register, registers = point.tape.program(factors, VECTOR * n * groups)
    begin = [0, *accumulate(map(math.prod, shapes.values()))]
    first = dict(zip(shapes, begin, strict=False))
    contractions: list[int] = []
    terms = 1  # most derivatives of a component in a block
    for number, found in point.terms:
        width = shapes[number][-1] if shapes[number] else 1
        slots = {(one, one, *s)[-2:]: register[value] for s, value in found.items()}
        for block in _blocks(slots, first[number], width):
            contractions += block
            terms = max(terms, block[6])
    nodes = [e.dim for e in point.elements]
    used = [(point.elements[0], 3), *map(_element, point.functions)]
    sizes = [registers * n * groups, *(n * groups * (1 + gdim) * m for m in nodes)]
    sizes += [e.dim * block * groups for e, block in used]
    sizes += [max(nodes) * terms * n * groups, begin[-1] * groups]
    places = list(accumulate(sizes))  # of what follows the tape's registers
    straight = point.elements[0].degree == 1 and len(basix.topology(cell)[gdim][0]) == gdim + 1
    numbers = {
        "size": begin[-1],
        "forms": len(shapes),
        "elements": len(nodes),
        "functions": len(used),
        "chunks": chunks,
        "affine": int(straight),
        "products": places[-3],
        "out": places[-2],
        "vectors": places[-1],
    }
    lists = {
        "begin": begin,
        "nodes": nodes,
        "gradients": [e in point.gradients for e in range(len(nodes))],
        "element": [point.elements.index(e) for e, _ in used],
        "block": [block for _, block in used],
        "phi": places[: len(nodes)],
        "w": places[len(nodes) : -3],
        "tape": tape,
        "contractions": [*contractions, -1],
    }
    arrays: dict[str, npt.NDArray[Any]] = {
        name: np.array(values, dtype=np.int32) for name, values in lists.items()
    }
    tables = [np.moveaxis(np.asarray(e.tabulate(1, x)), 0, -1).copy() for e in point.elements]
    text = f"enum {{ GDIM = {gdim}, N = {n}, GROUPS = {groups} }};{HEADER}"
    arrays |= {"weight": weights, "literals": np.array([*point.tape.literals.values()])}
    return text, numbers, arrays, tables


def _blocks(factors: Mapping[tuple[Slot, ...], int], first: int, width: int) -> Iterator[list[int]]:
    """Yield the blocks of a form, as ``contract`` in C reads them.

    Args:
        factors: The register of each factor, under the slots of rows and columns.
        first: Where the form begins among the entries of a cell.
        width: Its columns.
    """
    symmetric = all(factors.get((u, v)) == value for (v, u), value in factors.items())
    blocks: dict[tuple[int, int], dict[int, list[int]]] = {}
    for (v, u), value in factors.items():
        columns = blocks.setdefault((v.component, u.component), {})
        columns.setdefault(u.direction, []).extend((v.direction, value))
    for (i, k), columns in blocks.items():
        if symmetric and i > k:
            continue
        mirrored = first + k * width + i if symmetric else -1
        v, u = next(iter(factors))
        block = [v.element, u.element, first + i * width + k, mirrored, v.block * width, u.block]
        block += [len(columns), *columns]
        for pairs in columns.values():
            block += [len(pairs) // 2, *pairs]
        yield block
