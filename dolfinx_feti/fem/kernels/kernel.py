# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Cell integrals of several forms in one visit of each cell, of eight cells at a time.

A region is all cells, or those with one number in the data of the measure: its integrals are one
integrand, as in dolfinx. Forms are data, the C code depends on the dimension and the number of
quadrature points alone. Values agree with dolfinx's to rounding, and NaN are NaN.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl

from dolfinx_feti.fem.kernels.program import Program, generate
from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.arrays import Array, Indices, Numbers
from dolfinx_feti.runtime.native import load, pointer, processor_flags

_log = logging.getLogger(__name__)

#: By signatures, and by the places of each form's coefficients and constants among those of all;
#: None where only FFCx can compile an integrand.
_generated: dict[object, list[Program] | None] = {}

#: NaN are left alone, and what is called last is jumped to, at any level of optimisation.
FLAGS = "-O3 -fno-math-errno -fno-trapping-math -fno-tree-loop-distribute-patterns -Wno-psabi"

NO_CELLS = np.zeros(0, dtype=np.int32)

SOURCE = Path(__file__).with_name("kernel.c")
DECLARATION = """
typedef struct {
    int size, forms, elements, functions, chunks, affine, vectors, products, out, m;
    const int *begin, *nodes, *gradients, *tables, *element, *block, *phi, *w, *tape, *contractions,
              *cells, *const *dof;
    const double *weight, *table, *literals, *constants, *const *values;
} Program;
int evaluate(const Program *, double *const *);
int add(const Program *, int, int, const int *, const int *, const int64_t *, double *);
"""


@dataclass(frozen=True, slots=True)
class Kernel:
    """Code and data for the cell integrals of forms, over all owned cells or those of a list."""

    program: Program
    mesh: dolfinx.mesh.Mesh
    functions: Sequence[dolfinx.fem.Function]
    constants: Sequence[dolfinx.fem.Constant]
    code: Any
    cells: Indices | None = None

    @property
    def rows(self) -> Indices | slice:
        """The kernel's cells in a table of all cells."""
        return slice(self._count) if self.cells is None else self.cells

    @property
    def _count(self) -> int:
        topology = self.mesh.topology
        owned = topology.index_map(topology.dim).size_local
        return owned if self.cells is None else len(self.cells)

    def evaluate(self) -> list[Array]:
        """Integrate over each cell at the present state.

        Each form has (cells, …), the dofs of a cell for each argument in the element's order.
        """
        results = [np.empty((self._count, *shape)) for shape in self.program.shapes.values()]
        self._run("evaluate", self._pointers("double", results))
        return results

    def add_to(self, values: Array, indptr: Numbers, node: Indices, place: Indices) -> None:
        """Add the only form, which is bilinear, to the values of a matrix with rows from indptr on.

        Cells have k nodes, (cells, k), and columns of nodes a place in rows, (cells, k, k).
        """
        arrays = (pointer(self.code, a) for a in (node, place, indptr, values))
        (shape,), n = self.program.shapes.values(), node.shape[1]
        self._run("add", n, shape[0] // n, *arrays)

    def _run(self, name: str, *arguments: object) -> None:
        """Call a function of C with the present state."""
        constants = np.concatenate([np.zeros(0), *(np.ravel(c.value) for c in self.constants)])
        values = [self.mesh.geometry.x, *(f.x.array for f in self.functions)]
        spaces = [f.function_space for f in self.functions]
        dofs = [compat.geometry_dofmap(self.mesh), *(V.dofmap.list for V in spaces)]
        state = {**self.program.fields, "m": self._count, "constants": constants}
        state |= {} if self.cells is None else {"cells": self.cells}
        fields = {k: v if isinstance(v, int) else pointer(self.code, v) for k, v in state.items()}
        fields["values"] = self._pointers("double", values)
        fields["dof"] = self._pointers("int", dofs)
        program = self.code.ffi.new("Program *", fields)
        if getattr(self.code.lib, name)(program, *arguments):
            raise MemoryError("no memory for the cells of a visit")

    def _pointers(self, kind: str, arrays: Sequence[npt.NDArray[Any]]) -> Any:
        return self.code.ffi.new(f"{kind} *[]", [pointer(self.code, a) for a in arrays])


def compile_cells(
    forms: Sequence[ufl.Form], mesh: dolfinx.mesh.Mesh, cache: Path | None = None
) -> tuple[list[tuple[list[int], Kernel]], list[ufl.Form]]:
    """Compile the integrals over cells of forms on a mesh, a kernel for each region and degree.

    Returns kernels, each with the numbers of its forms, and of each form what is left to dolfinx:
    other integrals, and those that only FFCx can compile. Collective.
    """
    groups: dict[tuple[int | str, int], dict[int, list[ufl.Integral]]] = {}
    known: dict[tuple[int | str, int], Indices | None] = {}
    rest = [ufl.Form([]) for _ in forms]
    for i, form in enumerate(map(ufl.algorithms.expand_derivatives, forms)):
        data, cells = _cells_of_numbers(form, mesh)
        for integral in form.integrals():
            numbers = _numbers(integral)
            if not numbers or (cells is None and numbers != ["everywhere"]):
                rest[i] += ufl.Form([integral])
                continue
            for number in numbers:
                key = number, 0 if number == "everywhere" else data
                part = integral.reconstruct(subdomain_id=number)
                groups.setdefault(key, {}).setdefault(i, []).append(part)
                known[key] = None if number == "everywhere" else (cells or {}).get(number, NO_CELLS)
    kernels = []
    for key, group in groups.items():
        numbered = list(group)
        inside = [
            ufl.Form([integral.reconstruct(subdomain_id="everywhere") for integral in integrals])
            for integrals in group.values()
        ]
        created = create_kernels(inside, mesh, known[key], cache)
        if created is not None:
            kernels += [([numbered[i] for i in each], kernel) for each, kernel in created]
            continue
        for i, integrals in group.items():
            rest[i] += ufl.Form(integrals)
    return kernels, rest


def _numbers(integral: ufl.Integral) -> list[int | str]:
    """Return the numbers of an integral over cells, or "everywhere"; none of another one."""
    rule, numbers = integral.metadata().get("quadrature_rule", "default"), integral.subdomain_id()
    if integral.integral_type() != "cell" or rule != "default":
        return []
    numbers = numbers if isinstance(numbers, tuple) else (numbers,)
    if all(isinstance(number, (int, np.integer)) for number in numbers):
        return list(dict.fromkeys(map(int, numbers)))
    return ["everywhere"] if numbers == ("everywhere",) else []


def _cells_of_numbers(
    form: ufl.Form, mesh: dolfinx.mesh.Mesh
) -> tuple[int, dict[int | str, Indices] | None]:
    """Return the identity of the data of the measures and the owned cells of each number.

    The latter are None if only dolfinx knows: there are several data, or cells that occur twice.
    """
    given = [integral.subdomain_data() for integral in form.integrals_by_type("cell")]
    data = {id(known): known for known in given if known is not None}
    if len(data) != 1:
        return 0, None
    ((key, known),) = data.items()
    topology = mesh.topology
    if isinstance(known, dolfinx.mesh.MeshTags) and known.dim == topology.dim:
        known = [(int(number), known.find(number)) for number in np.unique(known.values)]
    if not isinstance(known, list) or len(dict(known)) < len(known):
        return key, None
    cells = {number: np.asarray(found, dtype=np.int32) for number, found in known}
    if any(len(np.unique(found)) < len(found) for found in cells.values()):
        return key, None
    n = topology.index_map(topology.dim).size_local
    return key, {number: found[(found >= 0) & (found < n)] for number, found in cells.items()}


def create_kernels(
    forms: Sequence[ufl.Form],
    mesh: dolfinx.mesh.Mesh,
    cells: Indices | None = None,
    cache: Path | None = None,
) -> list[tuple[list[int], Kernel]] | None:
    """Compile forms of integrals over all owned cells, or those of a list. Collective.

    Returns kernels, one for each quadrature degree, with the numbers of their forms; None where
    only FFCx can compile an integrand. The code is kept in the cache, or the package's own.
    """
    functions = list(dict.fromkeys(f for form in forms for f in form.coefficients()))
    constants = list(dict.fromkeys(c for form in forms for c in form.constants()))
    alone = all(form.ufl_domains() == (mesh.ufl_domain(),) for form in forms)
    gathered = alone and all(_is_gathered(f, mesh) for f in functions)
    if mesh.topology.dim != mesh.geometry.dim or not gathered:
        return None
    places = [
        [*map(functions.index, form.coefficients()), *map(constants.index, form.constants())]
        for form in forms
    ]
    key = tuple((form.signature(), *place) for form, place in zip(forms, places, strict=True))
    if key not in _generated:
        try:
            _generated[key] = generate(forms, mesh, functions, constants)
        except Exception as error:  # FFCx is asked, and says what it does not know
            _log.debug("FFCx compiles cell integrals: %r", error)
            _generated[key] = None
    programs, flags = _generated[key], [*FLAGS.split(), *processor_flags()]

    def kernel(program: Program) -> Kernel:
        text = program.text
        code = load(SOURCE, DECLARATION, mesh.comm, generated=text, flags=flags, cache=cache)
        return Kernel(program, mesh, functions, constants, code, cells)

    return None if programs is None else [(list(each.shapes), kernel(each)) for each in programs]


def _is_gathered(f: ufl.Coefficient, mesh: dolfinx.mesh.Mesh) -> bool:
    """Whether a function's dofs in a cell are blocks of doubles; those in a mixed space are not."""
    if not isinstance(f, dolfinx.fem.Function) or f.x.array.dtype != np.float64:
        return False
    V, element = f.function_space, f.function_space.ufl_element()
    bs = 0 if element.is_mixed else element.block_size
    whole = V.dofmap.bs == bs and V.dofmap.list.shape[1] * bs == V.element.space_dimension
    return bool(whole and V.mesh._cpp_object == mesh._cpp_object)
