# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""From UFL's forms to tapes, and to the code in C around them, which knows elements alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import basix
import dolfinx
import ufl

from dolfinx_feti.fem.kernels.contraction import Factors, braces, contraction
from dolfinx_feti.fem.kernels.integrand import Point, State, UnsupportedError, scalar_element

__all__ = ["Generated", "generate"]

Array = npt.NDArray[np.float64]

#: Bytes of a vector of eight numbers; of the stack that points take at a time, and most that all
#: points of a rule would take.
VECTOR, STACK, MOST = 64, 256 * 1024, 2 * 1024**2

#: Of the functions that are generated: coordinates, coefficients, tapes, registers, entries.
PARAMETERS = "const V *X, const V *const *W, const Program *program, V *R, V *out"


@dataclass(frozen=True, slots=True)
class Generated:
    """What is made of forms.

    Attributes:
        shapes: Dofs of a cell for each argument of each form.
        functions: Which of their coefficients are gathered.
        constants: Which of their constants are read.
        tapes: The tape of each quadrature rule.
        vectors: Vectors that their registers take.
        text: What follows from their factors, in C.
    """

    shapes: tuple[tuple[int, ...], ...]
    functions: list[int]
    constants: list[int]
    tapes: list[npt.NDArray[np.int32]]
    vectors: int
    text: str


def generate(
    forms: Sequence[ufl.Form],
    mesh: dolfinx.mesh.Mesh,
    functions: Sequence[dolfinx.fem.Function],
    constants: Sequence[dolfinx.fem.Constant],
) -> Generated:
    """Write the code for forms with these coefficients and constants.

    Raises:
        UnsupportedError: Only FFCx can compile an integrand.
    """
    gdim, cell = mesh.geometry.dim, mesh.basix_cell()
    state, points = State(), dict[int, Point]()
    terms: dict[int, list[tuple[int, Factors]]] = {}
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
            degree = _degree(integral)
            point = points.setdefault(degree, Point(state))
            found = point.add(integral.integrand(), len(form.arguments()))
            terms.setdefault(degree, []).append((number, found))
    spaces = [[scalar_element(a.ufl_function_space()) for a in f.arguments()] for f in forms]
    shapes = tuple(tuple(e.dim * block for e, block in row) for row in spaces)
    first = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes)])
    coordinate = mesh.ufl_domain().ufl_coordinate_element().sub_elements[0]
    stages: list[str] = []
    tapes = []
    vectors = 0
    for number, (degree, point) in enumerate(points.items()):
        program = point.tape.program(point.factors)
        rule, chunk = _rule(cell, degree, VECTOR * _vectors(state, point, gdim))
        tapes.append(program.code)
        vectors = max(vectors, program.vectors)
        body = _at_points(state, point, number)
        for form, factors in terms[degree]:
            body += contraction(factors, point.factors, first[form], shapes[form])
        tables = _tables(rule, coordinate, state, point)
        stages.append(_stage(number, len(rule[1]), chunk, tables, body))
    used = [scalar_element(f.function_space) for f in state.functions]
    sizes = {
        "NODES": coordinate.dim,
        "GDIM": gdim,
        "INVERSE": f"inverse{gdim}",
        "COEFFICIENTS": len(used),
        "FORMS": len(forms),
        "SIZE": int(first[-1]),
        "BLOCK_OF_ROWS": spaces[0][0][1] if spaces[0] else 1,
    }
    lists = {
        "NODES_OF": [e.dim for e, _ in used] + [0],
        "BLOCK_OF": [block for _, block in used] + [0],
        "FIRST": first.tolist(),
    }
    head = [f"#define {name} {n}" for name, n in sizes.items()]
    head += [f"static const int {name}[] = {braces(n)};" for name, n in lists.items()]
    calls = [f"stage{number}(X, W, program, R, out);" for number in range(len(stages))]
    signature = (
        "static void tabulate(const V *X, const V *const *W, const Program *program, V *R, V *out)"
    )
    text = "\n".join([*head, *stages, signature, "{", *calls, "}", ""])
    gathered = [functions.index(f) for f in state.functions]
    read = [constants.index(c) for c in state.constants]
    return Generated(shapes, gathered, read, tapes, vectors, text)


def _degree(integral: ufl.Integral) -> int:
    """Return the quadrature degree, as FFCx chooses it."""
    known = integral.metadata()
    stated = int(known.get("quadrature_degree", -1))
    return stated if stated >= 0 else int(np.max(known["estimated_polynomial_degree"]))


def _vectors(state: State, point: Point, gdim: int) -> int:
    """Count what a stage holds at each point: gradients, factors, and half of their products."""
    gradients = sum(state.elements[e].dim * gdim for e in point.gradients)
    return gradients + 2 * len(point.factors) + 1


def _rule(cell: Any, degree: int, each: int) -> tuple[tuple[Array, Array], int]:
    """Return a quadrature rule, and how many of its points are visited at a time.

    Where these are not all, points without weight fill it up.

    Args:
        cell: The reference cell.
        degree: Degree of the rule.
        each: Bytes of the stack that a point takes.

    Raises:
        UnsupportedError: There are too many points.
    """
    points, weights = map(np.asarray, basix.make_quadrature(cell, degree))
    if each * len(weights) > MOST:
        raise UnsupportedError(f"{len(weights)} points")
    parts = -(-len(weights) // max(1, STACK // each))
    chunk = -(-len(weights) // parts)
    missing = parts * chunk - len(weights)
    points = np.concatenate([points, np.repeat(points[-1:], missing, axis=0)])
    return (points, np.concatenate([weights, np.zeros(missing)])), chunk


def _stage(number: int, points: int, chunk: int, tables: dict[str, Array], body: list[str]) -> str:
    """Return the function of a quadrature rule."""
    lines = [f"static void stage{number}({PARAMETERS})", "{", f"enum {{ POINTS = {chunk} }};"]
    if points == chunk:
        lines += [_table(name, values) for name, values in tables.items()]
        return "\n".join([*lines, *body, "}"])
    lines += [_table(f"all_{name}", values) for name, values in tables.items()]
    lines.append(f"for (int first = 0; first < {points}; first += POINTS) {{")
    for name, values in tables.items():
        size = "".join(f"[{n}]" for n in values.shape[1:])
        lines.append(f"const double (*const {name}){size} = all_{name} + first;")
    return "\n".join([*lines, *body, "}", "}"])


def _tables(rule: tuple[Any, Any], coordinate: Any, state: State, point: Point) -> dict[str, Array]:
    """Return the weights, and the basis functions of geometry, ψ, and fields, φ, at all points."""
    points, weights = rule
    psi = coordinate.tabulate(1, points)
    tables = {"weight": weights, "psi": psi[0], "dpsi": np.moveaxis(psi[1:], 0, -1)}
    for e in sorted(point.values | point.gradients):
        phi = np.asarray(state.elements[e].tabulate(1, points))
        if e in point.values:
            tables[f"phi{e}"] = phi[0]
        if e in point.gradients:
            tables[f"dphi{e}"] = np.moveaxis(phi[1:], 0, -1)
    return tables


def _at_points(state: State, point: Point, number: int) -> list[str]:
    """Return the code that computes gradients ∂φ and, by a tape, factors A at all points."""
    gradients, width = sorted(point.gradients), len(point.factors) + 1
    seen = [e in point.values | point.gradients for e in range(len(state.elements))]
    phi = [f"phi{e}[0]" if e in point.values else "NULL" for e in range(len(seen))]
    B = [f"B{e}[0][0]" if e in gradients else "NULL" for e in range(len(seen))]
    dofs = [f"N{e}" if here else "0" for e, here in enumerate(seen)]
    return [
        *(f"enum {{ N{e} = {state.elements[e].dim} }};" for e, here in enumerate(seen) if here),
        *(f"V B{e}[POINTS][N{e}][GDIM];" for e in gradients),
        f"V A[POINTS][{width}], det[POINTS];",
        "for (int q = 0; q < POINTS; ++q) {",
        "V J[GDIM * GDIM], K[GDIM * GDIM];",
        "jacobian(NODES, GDIM, X, dpsi[q][0], J);",
        "det[q] = INVERSE(J, K);",
        *(f"gradients(N{e}, GDIM, dphi{e}[q][0], K, B{e}[q][0]);" for e in gradients),
        "}",
        f"const double *const phi[] = {{{', '.join(phi)}}};",
        f"const V *const B[] = {{{', '.join(B)}}};",
        f"const int dofs[] = {{{', '.join(dofs)}}};",
        "const Cells cells = {GDIM, NODES, X, W, program->c, weight, det, psi[0], phi, B, dofs};",
        f"((Run *)program->run)(program->tape[{number}], &cells, POINTS, R, {width}, A[0]);",
    ]


def _table(name: str, values: Array) -> str:
    """Return the definition of a table."""
    size = "".join(f"[{n}]" for n in values.shape)
    return f"static const double {name}{size} = {braces(values.tolist())};"
