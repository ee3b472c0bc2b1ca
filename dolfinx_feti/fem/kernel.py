# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Cell integrals of several forms in one visit of each cell, of eight cells at a time.

dolfinx calls FFCx's code cell by cell. Here every operation is one on eight cells, which a
processor does in one to four instructions, and a tangent is contracted in two steps,

.. math:: T_{qa}[i, kL] = \sum_J A_q[iJ, kL]\, ∂_J φ_a, \qquad
          K[ai, bk] = \sum_{q L} T_{qa}[i, kL]\, ∂_L φ_b,

with the factors A_q at the quadrature points (``integrand``), weighted, and gradients in the
reference configuration. Where A_q is symmetric at all points of eight cells, to rounding, K is, and
one half is copied.

Values agree with dolfinx's to rounding, and what is no number there is none here.

Forms that differ in functions, constants and meshes alone have one signature, and their code is
generated once in a run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import basix
import dolfinx
import ufl

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.integrand import (
    VALUE,
    Point,
    Slot,
    State,
    UnsupportedError,
    scalar_element,
)
from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.native import load, pointer

__all__ = ["Kernel", "create_kernel", "separate"]

Array = npt.NDArray[np.float64]

#: Bytes of a vector of eight numbers, and most that the points of a rule may take of the stack.
VECTOR, STACK = 64, 2 * 1024**2

#: Number of a factor under the slots of the arguments.
Factors = dict[tuple[Slot, ...], int]

#: Shapes of forms, which of their coefficients and constants are gathered, and the code.
Generated = tuple[tuple[tuple[int, ...], ...], list[int], list[int], str]

#: By signatures, and by the places of each form's coefficients and constants among those of all.
_generated: dict[object, Generated] = {}

SOURCE = Path(__file__).with_name("kernel.c")
STATE = """int, const double *, const int *, const double *const *, const int *const *,
           const double *"""
DECLARATION = f"""
int evaluate({STATE}, double *const *);
int add({STATE}, int, const int *, const int *, const int64_t *, double *);
"""


@dataclass(frozen=True, slots=True)
class Kernel:
    """Compiled code for the cell integrals of forms.

    Attributes:
        shapes: Dofs of a cell for each argument of each form.
        mesh: The mesh.
        functions: Coefficients that are gathered.
        constants: Constants.
        code: The compiled module.
    """

    shapes: tuple[tuple[int, ...], ...]
    mesh: dolfinx.mesh.Mesh
    functions: Sequence[dolfinx.fem.Function]
    constants: Sequence[dolfinx.fem.Constant]
    code: Any

    def evaluate(self) -> list[Array]:
        """Integrate over each owned cell at the present state.

        Returns:
            For each form (cells, …), with the dofs of a cell for each argument, in the order of the
            element.
        """
        arguments = self._state()
        results = [np.empty((arguments[0], *shape)) for shape in self.shapes]
        out = self._pointers("double *", results)
        self._require(self.code.lib.evaluate(*arguments, out))
        return results

    def add_to(
        self,
        values: Array,
        indptr: npt.NDArray[np.int64],
        node: npt.NDArray[np.int32],
        place: npt.NDArray[np.int32],
    ) -> None:
        """Add the only form, which is bilinear, to a matrix.

        Args:
            values: Entries of the matrix, row by row.
            indptr: Where each row begins.
            node: Blocks of dofs of each cell, (cells, k).
            place: Where the columns of a block are in the rows of another, (cells, k, k).
        """
        arrays = (pointer(self.code, a) for a in (node, place, indptr, values))
        self._require(self.code.lib.add(*self._state(), node.shape[1], *arrays))

    def _state(self) -> tuple[Any, ...]:
        """Return what is gathered: number of cells, geometry, coefficients, constants."""
        topology = self.mesh.topology
        constants = [np.ravel(c.value) for c in self.constants]
        return (
            topology.index_map(topology.dim).size_local,
            pointer(self.code, self.mesh.geometry.x),
            pointer(self.code, compat.geometry_dofmap(self.mesh)),
            self._pointers("double *", [f.x.array for f in self.functions]),
            self._pointers("int *", [f.function_space.dofmap.list for f in self.functions]),
            pointer(self.code, np.concatenate([np.zeros(0), *constants])),
        )

    def _pointers(self, kind: str, arrays: Sequence[npt.NDArray[Any]]) -> Any:
        """Return an array of pointers, which keeps what they point to alive."""
        ffi = self.code.ffi
        owners = [ffi.from_buffer(a) for a in arrays]
        return ffi.gc(ffi.new(f"{kind}[]", [ffi.cast(kind, o) for o in owners]), lambda _: owners)

    @staticmethod
    def _require(failed: int) -> None:
        if failed:
            raise MemoryError("no memory for eight cells")


def separate(form: ufl.Form) -> tuple[ufl.Form, ufl.Form]:
    """Separate the integrals over all cells, by a rule of basix, from the others."""
    inside = [
        integral.integral_type() == "cell"
        and integral.subdomain_id() == "everywhere"
        and integral.metadata().get("quadrature_rule", "default") == "default"
        for integral in form.integrals()
    ]
    parts = tuple(
        ufl.Form([i for i, chosen in zip(form.integrals(), inside, strict=True) if chosen is part])
        for part in (True, False)
    )
    return parts[0], parts[1]


def create_kernel(
    forms: Sequence[ufl.Form], mesh: dolfinx.mesh.Mesh, compiler: Compiler
) -> Kernel | None:
    """Compile forms of integrals over all cells.

    Args:
        forms: The forms, see :func:`separate`.
        mesh: Their mesh.
        compiler: Whose flags for the C compiler are taken.

    Returns:
        The kernel; None where only FFCx can compile an integrand.

    Note:
        Collective.
    """
    functions = list(dict.fromkeys(f for form in forms for f in form.coefficients()))
    constants = list(dict.fromkeys(c for form in forms for c in form.constants()))
    alone = all(form.ufl_domains() == (mesh.ufl_domain(),) for form in forms) and all(
        isinstance(f, dolfinx.fem.Function)
        and f.function_space.mesh._cpp_object == mesh._cpp_object
        for f in functions
    )
    if mesh.topology.dim != mesh.geometry.dim or not alone:
        return None
    key = tuple(
        (
            form.signature(),
            *map(functions.index, form.coefficients()),
            *map(constants.index, form.constants()),
        )
        for form in forms
    )
    try:
        if key not in _generated:
            _generated[key] = _generate(forms, mesh, functions, constants)
    except UnsupportedError:
        return None
    shapes, used, held, text = _generated[key]
    code = load(SOURCE, DECLARATION, compiler.comm, generated=text, flags=compiler.flags())
    return Kernel(shapes, mesh, [functions[i] for i in used], [constants[i] for i in held], code)


def _generate(
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
            degree = _degree(integral)
            point = points.setdefault(degree, Point(state))
            found = point.add(integral.integrand(), len(form.arguments()))
            terms.setdefault(degree, []).append((number, found))
    spaces = [[scalar_element(a.ufl_function_space()) for a in f.arguments()] for f in forms]
    shapes = tuple(tuple(e.dim * block for e, block in row) for row in spaces)
    first = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes)])
    coordinate = mesh.ufl_domain().ufl_coordinate_element().sub_elements[0]
    stages = []
    for number, (degree, point) in enumerate(points.items()):
        rule: Any = basix.make_quadrature(cell, degree)
        gradients = sum(state.elements[e].dim * gdim for e in point.gradients)
        if VECTOR * len(rule[1]) * (gradients + 2 * len(point.factors)) > STACK:
            raise UnsupportedError
        body = [*_tables(rule, coordinate, state, point), *_at_points(point, gdim)]
        for form, factors in terms[degree]:
            body += _contraction(factors, first[form], shapes[form])
        stages.append(_stage(number, len(rule[1]), body))
    used = [scalar_element(f.function_space) for f in state.functions]
    sizes = {
        "NODES": coordinate.dim,
        "GDIM": gdim,
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
    head += [f"static const int {name}[] = {_braces(n)};" for name, n in lists.items()]
    calls = [f"stage{number}(X, W, c, out);" for number in range(len(stages))]
    signature = "static void tabulate(const V *X, const V *const *W, const double *c, V *out)"
    text = "\n".join([*head, *stages, signature, "{", *calls, "}", ""])
    gathered = [functions.index(f) for f in state.functions]
    return shapes, gathered, [constants.index(c) for c in state.constants], text


def _degree(integral: ufl.Integral) -> int:
    """Return the quadrature degree, as FFCx chooses it."""
    known = integral.metadata()
    stated = int(known.get("quadrature_degree", -1))
    return stated if stated >= 0 else int(np.max(known["estimated_polynomial_degree"]))


def _stage(number: int, points: int, body: Sequence[str]) -> str:
    signature = f"static void stage{number}(const V *X, const V *const *W, const double *c, V *out)"
    return "\n".join([signature, "{", f"enum {{ POINTS = {points} }};", *body, "}"])


def _tables(rule: tuple[Any, Any], coordinate: Any, state: State, point: Point) -> list[str]:
    """Return the weights, and the basis functions of geometry, ψ, and fields, φ, at all points."""
    points, weights = rule
    psi = coordinate.tabulate(1, points)
    lines = [_table("weight", weights), _table("dpsi", np.moveaxis(psi[1:], 0, -1))]
    if any("psi[q][n]" in line for line in point.statements):
        lines.append(_table("psi", psi[0]))
    values = {slot.element for slot in point.slots if slot.direction == VALUE}
    for e in sorted(values | point.gradients):
        element = state.elements[e]
        phi = np.asarray(element.tabulate(1, points))
        lines.append(f"enum {{ N{e} = {element.dim} }};")
        if e in values:
            lines.append(_table(f"phi{e}", phi[0]))
        if e in point.gradients:
            lines.append(_table(f"dphi{e}", np.moveaxis(phi[1:], 0, -1)))
            lines.append(f"V B{e}[POINTS][N{e}][GDIM];")
    return lines


def _at_points(point: Point, gdim: int) -> list[str]:
    """Return the loop that computes gradients ∂φ and factors A at all points."""
    return [
        f"V A[POINTS][{len(point.factors) + 1}];",
        "for (int q = 0; q < POINTS; ++q) {",
        "V J[GDIM * GDIM], K[GDIM * GDIM];",
        "jacobian(NODES, GDIM, X, dpsi[q][0], J);",
        f"const V det = inverse{gdim}(J, K);",
        "(void)det;",
        *(f"gradients(N{e}, GDIM, dphi{e}[q][0], K, B{e}[q][0]);" for e in sorted(point.gradients)),
        *point.statements,
        *(f"A[q][{i}] = BROADCAST({name});" for i, name in enumerate(point.factors)),
        "}",
    ]


def _contraction(factors: Factors, first: int, shape: tuple[int, ...]) -> list[str]:
    """Return the loops that add one form to what is computed of it from ``first`` on."""
    match len(shape):
        case 0:
            return [
                f"for (int q = 0; q < POINTS; ++q) out[{first}] += A[q][{i}];"
                for i in factors.values()
            ]
        case 1:
            return _vector(factors, first)
    return _matrix(factors, first, shape[1])


def _vector(factors: Factors, first: int) -> list[str]:
    """r[ai] = Σ_qJ P_q[iJ] ∂_J φ_a."""
    rows: dict[int, list[str]] = {}
    for (v,), i in factors.items():
        rows.setdefault(v.component, []).append(f"A[q][{i}] * {v.basis('a')}")
    lines = []
    for (v,), _ in list(factors.items())[:1]:
        lines.append(f"for (int a = 0; a < N{v.element}; ++a) {{")
        for component, products in rows.items():
            lines += [
                "{",
                "V s = {0.0};",
                f"for (int q = 0; q < POINTS; ++q) s += {' + '.join(products)};",
                f"out[{first} + a * {v.block} + {component}] += s;",
                "}",
            ]
        lines.append("}")
    return lines


def _matrix(factors: Factors, first: int, width: int) -> list[str]:
    """T_qa[i, kL] = Σ_J A_q[iJ, kL] ∂_J φ_a, then K[ai, bk] = Σ_qL T_qa[i, kL] ∂_L φ_b."""
    if not factors:
        return []
    v, u = next(iter(factors))
    halves: dict[tuple[int, Slot], list[str]] = {}
    for (row, column), i in factors.items():
        halves.setdefault((row.component, column), []).append(f"A[q][{i}] * {row.basis('a')}")
    wholes: dict[tuple[int, int], list[str]] = {}
    for t, (i, column) in enumerate(halves):
        basis = column.basis("b")
        wholes.setdefault((i, column.component), []).append(f"T[q][{t}] * {basis}")
    square = v.element == u.element and v.block == u.block
    lines = ["{", f"const int half = {_symmetry(factors) if square else 0};"]
    lines += [f"for (int a = 0; a < N{v.element}; ++a) {{", f"V T[POINTS][{len(halves)}];"]
    lines.append("for (int q = 0; q < POINTS; ++q) {")
    lines += [f"T[q][{t}] = {' + '.join(p)};" for t, p in enumerate(halves.values())]
    lines += ["}", f"for (int b = half ? a : 0; b < N{u.element}; ++b) {{"]
    lines += [f"V s{j} = {{0.0}};" for j in range(len(wholes))]
    lines.append("for (int q = 0; q < POINTS; ++q) {")
    lines += [f"s{j} += {' + '.join(p)};" for j, p in enumerate(wholes.values())]
    lines.append("}")
    for j, (i, k) in enumerate(wholes):
        at, to = f"a * {v.block} + {i}", f"b * {u.block} + {k}"
        lines.append(f"out[{first} + ({at}) * {width} + {to}] += s{j};")
        if square:
            lines.append(f"if (half && a != b) out[{first} + ({to}) * {width} + {at}] += s{j};")
    return [*lines, "}", "}", "}"]


def _symmetry(factors: Factors) -> str:
    """Return the question whether A_st = A_ts at all points, to rounding."""
    pairs = [(i, factors.get((u, v))) for (v, u), i in factors.items() if v != u]
    if not pairs or any(other is None for _, other in pairs):
        return str(int(not pairs))
    array = f"(const int[][2]){_braces(pairs)}"
    return f"symmetric(POINTS, sizeof A[0] / sizeof(V), A[0], {len(pairs)}, {array})"


def _table(name: str, values: Array) -> str:
    """Return the definition of a table."""
    size = "".join(f"[{n}]" for n in values.shape)
    return f"static const double {name}{size} = {_braces(values.tolist())};"


def _braces(values: object) -> str:
    """Return numbers, or rows of them, in C."""
    return repr(values).translate(str.maketrans("[]()", "{}{}"))
