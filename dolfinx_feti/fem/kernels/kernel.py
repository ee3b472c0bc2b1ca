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
one half is copied. Many points are visited a few at a time, which bounds what they take of the
stack.

Values agree with dolfinx's to rounding, and what is no number there is none here.

Forms that differ in functions, constants and meshes alone have one signature, and their code is
generated once in a run.
"""

from __future__ import annotations

import logging
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
from dolfinx_feti.fem.kernels.contraction import Factors, braces, contraction
from dolfinx_feti.fem.kernels.integrand import Point, State, UnsupportedError, scalar_element
from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.native import load, pointer

__all__ = ["Kernel", "create_kernel"]

Array = npt.NDArray[np.float64]

#: Bytes of a vector of eight numbers; of the stack that points take at a time, and most that all
#: points of a rule would take.
VECTOR, STACK, MOST = 64, 256 * 1024, 2 * 1024**2

_log = logging.getLogger(__name__)

#: Shapes of forms, which of their coefficients and constants are gathered, and the code.
Generated = tuple[tuple[tuple[int, ...], ...], list[int], list[int], str]

#: By signatures, and by the places of each form's coefficients and constants among those of all;
#: None where only FFCx can compile an integrand.
_generated: dict[object, Generated | None] = {}

SOURCE = Path(__file__).with_name("kernel.c")
STATE = """int, const int *, const double *, const int *, const double *const *, const int *const *,
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
        cells: The cells; None for all that this process owns.
    """

    shapes: tuple[tuple[int, ...], ...]
    mesh: dolfinx.mesh.Mesh
    functions: Sequence[dolfinx.fem.Function]
    constants: Sequence[dolfinx.fem.Constant]
    code: Any
    cells: npt.NDArray[np.int32] | None = None

    @property
    def rows(self) -> npt.NDArray[np.int32] | slice:
        """The kernel's cells in a table of all cells."""
        topology = self.mesh.topology
        owned = topology.index_map(topology.dim).size_local
        return slice(owned) if self.cells is None else self.cells

    def evaluate(self) -> list[Array]:
        """Integrate over each cell at the present state.

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
        """Return what is gathered: cells, geometry, coefficients, constants."""
        topology, cells = self.mesh.topology, self.cells
        constants = [np.ravel(c.value) for c in self.constants]
        return (
            topology.index_map(topology.dim).size_local if cells is None else len(cells),
            self.code.ffi.NULL if cells is None else pointer(self.code, cells),
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


def create_kernel(
    forms: Sequence[ufl.Form],
    mesh: dolfinx.mesh.Mesh,
    compiler: Compiler,
    cells: npt.NDArray[np.int32] | None = None,
) -> Kernel | None:
    """Compile forms of integrals over cells.

    Args:
        forms: The forms, see :func:`~dolfinx_feti.fem.regions.separate`.
        mesh: Their mesh.
        compiler: Whose flags for the C compiler are taken.
        cells: Owned cells that are integrated over; all if not given.

    Returns:
        The kernel; None where only FFCx can compile an integrand.

    Note:
        Collective.
    """
    functions = list(dict.fromkeys(f for form in forms for f in form.coefficients()))
    constants = list(dict.fromkeys(c for form in forms for c in form.constants()))
    alone = all(form.ufl_domains() == (mesh.ufl_domain(),) for form in forms)
    gathered = alone and all(_is_gathered(f, mesh) for f in functions)
    if mesh.topology.dim != mesh.geometry.dim or not gathered:
        return None
    key = tuple(
        (
            form.signature(),
            *map(functions.index, form.coefficients()),
            *map(constants.index, form.constants()),
        )
        for form in forms
    )
    if key not in _generated:
        try:
            _generated[key] = _generate(forms, mesh, functions, constants)
        except Exception as error:  # FFCx is asked, and says what it does not know
            _log.debug("FFCx compiles cell integrals: %r", error)
            _generated[key] = None
    generated = _generated[key]
    if generated is None:
        return None
    shapes, used, held, text = generated
    code = load(SOURCE, DECLARATION, compiler.comm, generated=text, flags=compiler.flags())
    gathers = [functions[i] for i in used], [constants[i] for i in held]
    return Kernel(shapes, mesh, *gathers, code, cells)


def _is_gathered(f: ufl.Coefficient, mesh: dolfinx.mesh.Mesh) -> bool:
    """Whether a function's dofs in a cell are blocks of doubles, one for each of its element.

    Those of a vector in a mixed space, of which a dof map has single dofs, are not.
    """
    if not isinstance(f, dolfinx.fem.Function) or f.x.array.dtype != np.float64:
        return False
    V, element = f.function_space, f.function_space.ufl_element()
    bs = 0 if element.is_mixed else element.block_size
    blocks = V.dofmap.list.shape[1]
    return bool(
        V.mesh._cpp_object == mesh._cpp_object
        and V.dofmap.bs == bs
        and blocks * bs == V.element.space_dimension
    )


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
    stages = []
    for number, (degree, point) in enumerate(points.items()):
        rule, chunk = _rule(cell, degree, VECTOR * _vectors(state, point, gdim))
        body = _at_points(state, point, gdim)
        for form, factors in terms[degree]:
            body += contraction(factors, point.factors, first[form], shapes[form])
        tables = _tables(rule, coordinate, state, point)
        stages.append(_stage(number, len(rule[1]), chunk, tables, body))
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
    head += [f"static const int {name}[] = {braces(n)};" for name, n in lists.items()]
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
    signature = f"static void stage{number}(const V *X, const V *const *W, const double *c, V *out)"
    lines = [signature, "{", f"enum {{ POINTS = {chunk} }};"]
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
    tables = {"weight": weights, "dpsi": np.moveaxis(psi[1:], 0, -1)}
    if any("psi[q][n]" in line for line in point.statements):
        tables["psi"] = psi[0]
    for e in sorted(point.values | point.gradients):
        phi = np.asarray(state.elements[e].tabulate(1, points))
        if e in point.values:
            tables[f"phi{e}"] = phi[0]
        if e in point.gradients:
            tables[f"dphi{e}"] = np.moveaxis(phi[1:], 0, -1)
    return tables


def _at_points(state: State, point: Point, gdim: int) -> list[str]:
    """Return the loop that computes gradients ∂φ and factors A at all points."""
    gradients = sorted(point.gradients)
    return [
        *(
            f"enum {{ N{e} = {state.elements[e].dim} }};"
            for e in sorted(point.values | point.gradients)
        ),
        *(f"V B{e}[POINTS][N{e}][GDIM];" for e in gradients),
        f"V A[POINTS][{len(point.factors) + 1}];",
        "for (int q = 0; q < POINTS; ++q) {",
        "V J[GDIM * GDIM], K[GDIM * GDIM];",
        "jacobian(NODES, GDIM, X, dpsi[q][0], J);",
        f"const V det = inverse{gdim}(J, K);",
        "(void)det;",
        *(f"gradients(N{e}, GDIM, dphi{e}[q][0], K, B{e}[q][0]);" for e in gradients),
        *point.statements,
        *(f"A[q][{i}] = BROADCAST({name});" for i, name in enumerate(point.factors)),
        "}",
    ]


def _table(name: str, values: Array) -> str:
    """Return the definition of a table."""
    size = "".join(f"[{n}]" for n in values.shape)
    return f"static const double {name}{size} = {braces(values.tolist())};"
