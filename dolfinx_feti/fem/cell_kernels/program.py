# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""From UFL's forms to the data of ``kernel.c``: a tape, tables of basis functions, contractions.

.. math:: r[a i] = \sum_q \sum_J P_q[iJ]\, ∂_J φ_a, \qquad
          K[a i, b k] = \sum_q \sum_L \Bigl(\sum_J A_q[iJ, kL]\, ∂_J φ_a\Bigr)\, ∂_L φ_b .

J and L are derivatives along an axis, or none: then φ itself is meant. Row a i, with node a and
component i, has the number a · bs + i. A *contraction* computes the entries of one pair of
components (i, k). If A_st and A_ts are one value of the tape for all slots of an integrand, its
part of K is symmetric. Then there are contractions with i ≤ k only, which also give the entries of
(k, i).

Residuals and energies are contractions, too: a missing argument is replaced by the constant 1,
which has one node. The test function numbers the rows of a tangent. It numbers the columns of a
residual, a matrix with one row.
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

from dolfinx_feti.fem.cell_kernels.integrand import (
    GEOMETRY_COMPONENTS,
    PointIntegrands,
    Slot,
    scalar_element,
)
from dolfinx_feti.fem.cell_kernels.tape import HEADER, Code, UnsupportedIntegrandError
from dolfinx_feti.runtime.arrays import Array

#: Upper bound of the points that one instruction computes: its sums stay in the 32 registers of a
#: processor with AVX-512, with ten for operands. (With the 16 registers of AVX2, the compiler
#: stores some of them.) Rules with more points are cut into chunks. The tangent of an artery in
#: P2–P0 takes as long with 11 points, and 35 % longer with 44.
MAX_POINTS = 22

#: Upper bound of the groups of eight cells in one visit, which bounds the work space of a visit.
#: Only rules with one point reach it. With 6 groups a tangent in P1–P0 with one point takes 8 %
#: longer; with 22 groups it takes as long.
MAX_GROUPS = 12

#: Bytes of a vector: one double of each of eight cells, the type V in ``tape.h``.
VECTOR_BYTES = 64


@dataclass(frozen=True, slots=True)
class Program:
    """Forms with one quadrature degree as data for ``kernel.c``.

    Attributes:
        shapes: Number of dofs of a cell for each argument of a form, by the index of the form.
        text: Code in C that replaces ``/* generated */`` in ``kernel.c``: sizes of loops, and the
            names of the instructions.
        members: Members of the structure ``Program`` (``program.h``) that do not change between
            calls. ``Kernel`` adds ``n_cells``, ``cells``, ``constants``, ``values`` and ``dofmap``
            at each call.
    """

    shapes: dict[int, tuple[int, ...]]
    text: str
    members: dict[str, int | npt.NDArray[Any]]


@dataclass(frozen=True, slots=True)
class _Rule:
    """A quadrature rule, padded by points without weight to chunks of one size.

    Attributes:
        points: In the reference cell, (chunks · chunk_size, dimension).
        weights: (chunks · chunk_size,).
        chunks: Number of chunks.
        chunk_size: Points of a chunk.
        groups: Groups of eight cells that are visited together.
    """

    points: Array
    weights: Array
    chunks: int
    chunk_size: int
    groups: int

    @property
    def vectors(self) -> int:
        """Vectors of a register: one for each point of a chunk in each group."""
        return self.chunk_size * self.groups


@dataclass(frozen=True, slots=True)
class _WorkSpace:
    """Offsets of the parts of a visit's work space, in vectors.

    Attributes:
        basis: Offsets of the basis functions of each element, (elements,).
        dofs: Offsets of the dofs of each function, (functions,).
        products: Offset of the products of rows with factors.
        entries: Offset of the entries of all forms.
        size: Size of the work space.
    """

    basis: list[int]
    dofs: list[int]
    products: int
    entries: int
    size: int


@dataclass(frozen=True, slots=True)
class _FunctionElement:
    """A scalar element of a function, and the number of components that share it."""

    index: int  #: In ``PointIntegrands.elements``
    nodes: int
    components: int


@dataclass(frozen=True, slots=True)
class _Entries:
    """Numbering of the entries of all forms in a cell, form by form.

    Attributes:
        shapes: Number of dofs of each argument, by the index of the form.
        first: First entry of each form, by the index of the form.
        count: Number of entries of all forms.
    """

    shapes: dict[int, tuple[int, ...]]
    first: dict[int, int]
    count: int


@dataclass(frozen=True, slots=True)
class _Contraction:
    """The entries of one pair of components (i, k) of an integrand.

    The entry of row node a and column node b is ``first + a * row_stride + b * column_stride``.

    Attributes:
        row_element: Element of rows, its index in ``PointIntegrands.elements``.
        column_element: Element of columns.
        first: Entry of the first nodes.
        mirrored: Entry of the first nodes of the pair (k, i), which gets the transposed entries;
            None if the integrand is not symmetric.
        row_stride: Entries from one row node to the next.
        column_stride: Entries from one column node to the next.
        factors: Derivative s of rows, and offset in bytes of the register of A_st, for each
            factor, by the derivative t of columns. A derivative is a ``Slot.direction``.
    """

    row_element: int
    column_element: int
    first: int
    mirrored: int | None
    row_stride: int
    column_stride: int
    factors: Mapping[int, Sequence[tuple[int, int]]]

    def words(self) -> list[int]:
        """Return the integers that ``contract`` in ``kernel.c`` reads.

        These are the members of ``struct Contraction``, the derivatives t, and for each t the
        number of its factors and the pairs (s, offset).
        """
        words = [
            self.row_element,
            self.column_element,
            self.first,
            -1 if self.mirrored is None else self.mirrored,
            self.row_stride,
            self.column_stride,
            len(self.factors),
            *self.factors,
        ]
        for pairs in self.factors.values():
            words.append(len(pairs))
            for derivative, offset in pairs:
                words += [derivative, offset]
        return words


def generate_programs(
    forms: Sequence[ufl.Form],
    mesh: dolfinx.mesh.Mesh,
    functions: Sequence[dolfinx.fem.Function],
    constants: Sequence[dolfinx.fem.Constant],
) -> list[Program]:
    """Generate one program for each quadrature degree.

    Args:
        forms: Forms of integrals over cells.
        mesh: Their mesh.
        functions: All coefficients of the forms.
        constants: All constants of the forms.

    Raises:
        UnsupportedIntegrandError: Only FFCx can compile an integrand.
    """
    points: dict[int, PointIntegrands] = {}  # by degree
    for index, form in enumerate(forms):
        data = ufl.algorithms.compute_form_data(
            form,
            do_apply_integral_scaling=True,
            do_apply_default_restrictions=False,
            do_append_everywhere_integrals=False,
        )
        for group in data.integral_data:
            for integral in group.integrals:
                degree = _degree(integral)
                if degree not in points:
                    points[degree] = PointIntegrands(mesh, functions, constants)
                points[degree].add(index, integral.integrand(), len(form.arguments()))
    return [_program(forms, mesh, functions, degree, point) for degree, point in points.items()]


def _degree(integral: ufl.Integral) -> int:
    """Return the quadrature degree of an integral after UFL's analysis, as FFCx chooses it.

    Raises:
        UnsupportedIntegrandError: Its points are those of a quadrature element.
    """
    if any(e.has_custom_quadrature for e in ufl.algorithms.extract_elements(integral)):
        raise UnsupportedIntegrandError("points of a quadrature element")
    metadata = integral.metadata()
    degree = int(metadata.get("quadrature_degree", -1))
    if degree >= 0:
        return degree
    return int(np.max(metadata["estimated_polynomial_degree"]))


def _program(
    forms: Sequence[ufl.Form],
    mesh: dolfinx.mesh.Mesh,
    functions: Sequence[dolfinx.fem.Function],
    degree: int,
    point: PointIntegrands,
) -> Program:
    """Generate the program of one quadrature degree from the integrands at a point."""
    gdim = mesh.geometry.dim
    rule = _rule(mesh.basix_cell(), degree)
    factors = {value for term in point.terms for value in term.factors.values()}
    code = point.tape.code(factors, VECTOR_BYTES * rule.vectors)
    entries = _number_entries(forms, point)
    contractions = _contractions(point, entries, code.offset, mesh.basix_cell())
    used = _elements_of_functions(point, functions)
    work = _work_space(point.elements, used, code.registers, entries.count, gdim, rule)
    data = {
        **_form_members(point, code, entries, contractions),
        **_rule_members(rule),
        **_element_members(point, mesh, rule),
        **_function_members(used),
        **_work_members(work),
    }
    members = {
        name: np.array(value, dtype=np.int32) if isinstance(value, list) else value
        for name, value in data.items()
    }
    sizes = f"enum {{ GDIM = {gdim}, N = {rule.chunk_size}, GROUPS = {rule.groups} }};"
    return Program(entries.shapes, sizes + HEADER, members)


def _elements_of_functions(
    point: PointIntegrands, functions: Sequence[dolfinx.fem.Function]
) -> list[_FunctionElement]:
    """Return the element of each function on the tape, that of the position x first."""
    geometry = point.elements[0]
    elements = [_FunctionElement(0, geometry.dim, GEOMETRY_COMPONENTS)]
    for f in functions:
        element, components = scalar_element(f)
        elements.append(_FunctionElement(point.add_element(element), element.dim, components))
    return elements


def _form_members(
    point: PointIntegrands, code: Code, entries: _Entries, contractions: Sequence[_Contraction]
) -> dict[str, Any]:
    """Return the members of ``Program`` that describe the forms."""
    words = [word for contraction in contractions for word in contraction.words()]
    return {
        "entries": entries.count,
        "forms": len(entries.shapes),
        "first_entry": [*entries.first.values(), entries.count],
        "contractions": [*words, -1],
        "tape": code.words,
        "literals": np.array([*point.tape.literals.values()]),
    }


def _rule_members(rule: _Rule) -> dict[str, Any]:
    """Return the members of ``Program`` that describe the quadrature rule."""
    return {"chunks": rule.chunks, "weight": rule.weights}


def _element_members(
    point: PointIntegrands, mesh: dolfinx.mesh.Mesh, rule: _Rule
) -> dict[str, Any]:
    """Return the members of ``Program`` that describe the scalar elements."""
    elements = point.elements
    tables = [
        np.moveaxis(np.asarray(element.tabulate(1, rule.points)), 0, -1).ravel()
        for element in elements
    ]
    gdim = mesh.geometry.dim
    n_vertices = len(basix.topology(mesh.basix_cell())[gdim][0])
    is_straight_simplex = elements[0].degree == 1 and n_vertices == gdim + 1
    return {
        "elements": len(elements),
        "nodes": [element.dim for element in elements],
        "has_gradients": [e in point.with_gradients for e in range(len(elements))],
        "table_start": [0, *accumulate(map(len, tables))],
        "table": np.concatenate(tables),
        "is_affine": int(is_straight_simplex),
    }


def _function_members(used: Sequence[_FunctionElement]) -> dict[str, Any]:
    """Return the members of ``Program`` that describe the functions."""
    return {
        "functions": len(used),
        "element": [element.index for element in used],
        "components": [element.components for element in used],
    }


def _work_members(work: _WorkSpace) -> dict[str, Any]:
    """Return the members of ``Program`` that describe the work space of a visit."""
    return {
        "basis_at": work.basis,
        "dofs_at": work.dofs,
        "products_at": work.products,
        "entries_at": work.entries,
        "work_size": work.size,
    }


def _number_entries(forms: Sequence[ufl.Form], point: PointIntegrands) -> _Entries:
    """Number the entries of all forms that have integrands."""
    shapes: dict[int, tuple[int, ...]] = {}
    first: dict[int, int] = {}
    count = 0
    for term in point.terms:
        if term.form in shapes:
            continue
        arguments = map(scalar_element, forms[term.form].arguments())
        shape = tuple(element.dim * components for element, components in arguments)
        shapes[term.form] = shape
        first[term.form] = count
        count += math.prod(shape)
    return _Entries(shapes, first, count)


def _contractions(
    point: PointIntegrands, entries: _Entries, offset: Mapping[int, int], cell: basix.CellType
) -> list[_Contraction]:
    """Return the contractions of all integrands.

    Args:
        point: The integrands.
        entries: Numbering of the entries.
        offset: Offset in bytes of the register of each factor.
        cell: Type of the cells.
    """
    constant_element = point.add_element(basix.ufl.element("DG", cell.name, 0))
    one = Slot(constant_element, components=1, component=0, direction=0)  # a missing argument
    contractions: list[_Contraction] = []
    for term in point.terms:
        shape = entries.shapes[term.form]
        row_size = shape[-1] if shape else 1
        offsets = {}
        for slots, value in term.factors.items():
            offsets[_row_and_column(slots, one)] = offset[value]
        contractions += _contractions_of_term(offsets, entries.first[term.form], row_size)
    return contractions


def _row_and_column(slots: Sequence[Slot], one: Slot) -> tuple[Slot, Slot]:
    """Return the slots of rows and columns of a factor.

    A residual is treated as a matrix of one row: its test function numbers the columns. An energy
    is a matrix of one entry.

    Args:
        slots: Slots of the arguments of the form, none to two.
        one: Slot of a missing argument.
    """
    match slots:
        case (row, column):
            return row, column
        case (column,):
            return one, column
        case _:
            return one, one


def _rule(cell: basix.CellType, degree: int) -> _Rule:
    """Return basix's default rule of a degree, in chunks."""
    points, weights = (np.asarray(part) for part in basix.make_quadrature(cell, degree))
    chunks = math.ceil(len(weights) / MAX_POINTS)
    chunk_size = math.ceil(len(weights) / chunks)
    groups = max(1, min(MAX_POINTS // chunk_size, MAX_GROUPS))
    padding = chunks * chunk_size - len(weights)
    points = np.concatenate([points, np.repeat(points[-1:], padding, axis=0)])
    return _Rule(points, np.pad(weights, (0, padding)), chunks, chunk_size, groups)


def _work_space(
    elements: Sequence[basix.ufl._ElementBase],
    functions: Sequence[_FunctionElement],
    registers: int,
    entries: int,
    gdim: int,
    rule: _Rule,
) -> _WorkSpace:
    """Place the parts of the work space one after the other, behind the registers of the tape.

    Args:
        elements: Scalar elements.
        functions: Elements of the functions.
        registers: Number of registers.
        entries: Number of entries of all forms in a cell.
        gdim: Dimension of space.
        rule: Quadrature rule.
    """
    end = registers * rule.vectors
    basis = []
    largest_basis = 0
    for element in elements:
        size = element.dim * (1 + gdim) * rule.vectors
        basis.append(end)
        end += size
        largest_basis = max(largest_basis, size)
    dofs = []
    for function in functions:
        dofs.append(end)
        end += function.nodes * function.components * rule.groups
    products = end  # rows have at most as many products as basis functions and derivatives
    end += largest_basis
    first_entry = end
    end += entries * rule.groups
    return _WorkSpace(basis, dofs, products, first_entry, end)


def _contractions_of_term(
    offsets: Mapping[tuple[Slot, Slot], int], first_entry: int, row_size: int
) -> list[_Contraction]:
    """Return the contractions of one integrand.

    Args:
        offsets: Offset in bytes of the register of each factor, by its slots of rows and columns.
        first_entry: First entry of the form in a cell.
        row_size: Entries of a row.
    """
    # symmetric if A_st and A_ts are in one register for all slots s, t
    is_symmetric = all(offsets.get((u, v)) == offset for (v, u), offset in offsets.items())
    # of each pair of components, by the derivative of columns
    factors: dict[tuple[int, int], dict[int, list[tuple[int, int]]]] = {}
    for (v, u), offset in offsets.items():
        of_pair = factors.setdefault((v.component, u.component), {})
        of_pair.setdefault(u.direction, []).append((v.direction, offset))
    contractions: list[_Contraction] = []
    for (i, k), of_pair in factors.items():
        if is_symmetric and i > k:  # the contraction of (k, i) computes these entries, too
            continue
        row, column = next(iter(offsets))  # all have the same elements
        contraction = _Contraction(
            row_element=row.element,
            column_element=column.element,
            first=first_entry + i * row_size + k,
            mirrored=first_entry + k * row_size + i if is_symmetric else None,
            row_stride=row.components * row_size,
            column_stride=column.components,
            factors=of_pair,
        )
        contractions.append(contraction)
    return contractions
