# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""From UFL's forms to tapes, and to the code in C around them, which knows elements alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import basix
import dolfinx
import ufl

from dolfinx_feti.fem.kernels.contraction import Factors, braces, contraction
from dolfinx_feti.fem.kernels.integrand import Input, Point, State, UnsupportedError, scalar_element
from dolfinx_feti.runtime.arrays import Array, Indices

__all__ = ["Generated", "generate"]


#: Bytes of a vector of eight numbers; of the stack that points take at a time, and most that all
#: points of a rule would take.
VECTOR, STACK, MOST = 64, 256 * 1024, 2 * 1024**2

#: Most points of an instruction, and most groups of eight cells that have them.
POINTS, GROUPS = 22, 12

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
        points: How many points an instruction of each has.
        vectors: Vectors that their registers take.
        text: What follows from their factors, in C.
    """

    shapes: tuple[tuple[int, ...], ...]
    functions: list[int]
    constants: list[int]
    tapes: list[Indices]
    points: list[int]
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
    rules = {d: _rule(cell, d, _vectors(state, point, gdim)) for d, point in points.items()}
    groups = min(rule.groups for rule in rules.values())
    stages: list[str] = []
    tapes, at_once = [], []
    vectors = 0
    for number, (degree, point) in enumerate(points.items()):
        rule = rules[degree].padded(groups)
        at_once.append(groups * rule.points)
        inputs = _inputs(state, point, gdim)
        program = point.tape.program(point.factors, at_once[-1], inputs)
        tapes.append(program.code)
        vectors = max(vectors, program.vectors + len(inputs) * groups * rule.chunk)
        body = _at_points(state, point, number, inputs)
        body.append("for (int start = 0; start < COLUMNS; start += POINTS) {")
        body.append("V *const entries = out + start / POINTS * SIZE;")
        for form, factors in terms[degree]:
            body += contraction(factors, point.factors, first[form], shapes[form])
        body.append("}")
        tables = _tables(rule, groups, coordinate, state, point)
        stages.append(_stage(number, rule, tables, body))
    used = [scalar_element(f.function_space) for f in state.functions]
    sizes = {
        "GROUPS": groups,
        "AFFINE": int(coordinate.degree == 1 and len(basix.topology(cell)[gdim][0]) == gdim + 1),
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
    return Generated(shapes, gathered, read, tapes, at_once, vectors, text)


def _degree(integral: ufl.Integral) -> int:
    """Return the quadrature degree, as FFCx chooses it."""
    known = integral.metadata()
    stated = int(known.get("quadrature_degree", -1))
    return stated if stated >= 0 else int(np.max(known["estimated_polynomial_degree"]))


def _vectors(state: State, point: Point, gdim: int) -> int:
    """Count what a stage holds at each point: gradients, factors, and half of their products."""
    gradients = sum(state.elements[e].dim * gdim for e in point.gradients)
    return gradients + 2 * len(point.factors) + 1


@dataclass(frozen=True, slots=True)
class _Rule:
    """A quadrature rule whose points a cell has in several visits, and groups of cells at a time.

    Attributes:
        x, weights: The points, the last ones perhaps without weight.
        visits: In how many visits a cell has all points.
        groups: How many groups of cells an instruction can serve.
        points, chunk: Points of a cell in an instruction, and in a visit.
    """

    x: Array
    weights: Array
    visits: int
    groups: int
    points: int = 0
    chunk: int = 0

    def padded(self, groups: int) -> _Rule:
        """Fill the rule up with points without weight."""
        chunk = -(-len(self.weights) // self.visits)
        instructions = -(-chunk * groups // POINTS)
        points = -(-chunk // instructions)
        missing = self.visits * points * instructions - len(self.weights)
        x = np.concatenate([self.x, np.repeat(self.x[-1:], missing, axis=0)])
        weights = np.concatenate([self.weights, np.zeros(missing)])
        return _Rule(x, weights, self.visits, groups, points, points * instructions)


def _rule(cell: Any, degree: int, vectors: int) -> _Rule:
    """Return a quadrature rule of which a point takes so many vectors of the stack."""
    x, weights = map(np.asarray, basix.make_quadrature(cell, degree))
    n, each = len(weights), VECTOR * vectors
    if each * n > MOST:
        raise UnsupportedError(f"{n} points")
    visits = -(-n // max(1, STACK // each))
    return _Rule(x, weights, visits, max(1, min(POINTS // n, GROUPS, STACK // (each * n))))


def _stage(number: int, rule: _Rule, tables: dict[str, Array], body: list[str]) -> str:
    """Return the function of a quadrature rule."""
    lines = [f"static void stage{number}({PARAMETERS})", "{"]
    lines.append(f"enum {{ POINTS = {rule.chunk}, COLUMNS = GROUPS * POINTS }};")
    if rule.visits == 1:
        lines += [_table(name, values) for name, values in tables.items()]
        return "\n".join([*lines, *body, "}"])
    lines += [_table(f"all_{name}", values) for name, values in tables.items()]
    lines.append(f"for (int first = 0; first < {len(rule.weights)}; first += POINTS) {{")
    for name, values in tables.items():
        size = "".join(f"[{n}]" for n in values.shape[1:])
        lines.append(f"const double (*const {name}){size} = all_{name} + first;")
    return "\n".join([*lines, *body, "}", "}"])


def _tables(
    rule: _Rule, groups: int, coordinate: Any, state: State, point: Point
) -> dict[str, Array]:
    """Return the weights, and the basis functions of geometry, ψ, and fields, φ, at all points."""
    x, weights = np.tile(rule.x, (groups, 1)), np.tile(rule.weights, groups)
    psi = coordinate.tabulate(1, x)
    tables = {"weight": weights, "dpsi": np.moveaxis(psi[1:], 0, -1)}
    if (Input.COORDINATE, 0) in point.inputs:
        tables["psi"] = psi[0]
    for e in sorted(point.values | point.gradients):
        phi = np.asarray(state.elements[e].tabulate(1, x))
        if e in point.values:
            tables[f"phi{e}"] = phi[0]
        if e in point.gradients:
            tables[f"dphi{e}"] = np.moveaxis(phi[1:], 0, -1)
    return tables


def _inputs(state: State, point: Point, gdim: int) -> dict[tuple[int, ...], int]:
    """Return the place of each input: kind, coefficient, component and direction."""
    places: dict[tuple[int, ...], int] = {}
    for kind, f in sorted(point.inputs):
        components = {Input.WEIGHT: 1, Input.DETERMINANT: 1, Input.COORDINATE: gdim}.get(kind)
        if components is None:
            _, components = scalar_element(state.functions[f].function_space)
        for component in range(components):
            for direction in range(gdim if kind == Input.GRADIENT else 1):
                places[kind, f, component, direction] = len(places)
    return places


def _at_points(
    state: State, point: Point, number: int, inputs: dict[tuple[int, ...], int]
) -> list[str]:
    """Return the code that computes gradients ∂φ, inputs, and, by a tape, factors A at points."""
    gradients, width = sorted(point.gradients), len(point.factors) + 1
    used = [e for e in range(len(state.elements)) if e in point.values | point.gradients]
    lines = [
        *(f"enum {{ N{e} = {state.elements[e].dim} }};" for e in used),
        *(f"V B{e}[N{e}][GDIM][COLUMNS];" for e in gradients),
        f"V A[{width}][COLUMNS], J[GDIM * GDIM], K[GDIM * GDIM] = {{{{0.0}}}}, det = {{0.0}};",
        "for (int q = 0; q < COLUMNS; ++q) {",
        "V *const H = R + q;",
        "if (q % POINTS == 0 || !AFFINE) {",
        "jacobian(NODES, GDIM, X + q / POINTS, GROUPS, dpsi[q][0], J);",
        "det = INVERSE(J, K);",
        "}",
        *(f"gradients(N{e}, GDIM, dphi{e}[q][0], K, &B{e}[0][0][q], COLUMNS);" for e in gradients),
    ]
    for kind, f in sorted(point.inputs):
        to = f"H + {inputs[kind, f, 0, 0]} * COLUMNS"
        if kind == Input.WEIGHT:
            lines.append(f"*({to}) = BROADCAST(weight[q]);")
        elif kind == Input.DETERMINANT:
            lines.append(f"*({to}) = det;")
        elif kind == Input.COORDINATE:
            lines.append(f"INTERPOLATE(NODES, GDIM, 1, X + q / POINTS, psi[q][a], {to});")
        else:
            element, block = scalar_element(state.functions[f].function_space)
            e = state.elements.index(element)
            d, basis = "1", f"phi{e}[q][a]"
            if kind == Input.GRADIENT:
                d, basis = "GDIM", f"B{e}[a][i][q]"
            w = f"W[{f}] + q / POINTS"
            lines.append(f"INTERPOLATE(N{e}, {block}, {d}, {w}, {basis}, {to});")
    return [
        *lines,
        "}",
        "const Data data = {COLUMNS, program->constants, R, A[0]};",
        f"V *const registers = R + {len(inputs)} * COLUMNS;",
        f"((Run *)program->run[{number}])(program->tape[{number}], registers, &data);",
    ]


def _table(name: str, values: Array) -> str:
    """Return the definition of a table."""
    size = "".join(f"[{n}]" for n in values.shape)
    return f"static const double {name}{size} = {braces(values.tolist())};"
