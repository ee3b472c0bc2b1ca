# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Cell integrals of several forms in one visit of each cell, of eight cells at a time.

Every operation is one on eight cells, which a processor does in one to four instructions. Many
points are visited a few at a time; where a rule has few, several groups of eight cells are visited
at once. Values agree with dolfinx's to rounding, and what is no number there is none here. Forms
are data: the C code depends on the dimension and the number of quadrature points alone.
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

__all__ = ["Kernel", "create_kernels"]

_log = logging.getLogger(__name__)

#: By signatures, and by the places of each form's coefficients and constants among those of all;
#: None where only FFCx can compile an integrand.
_generated: dict[object, list[Program] | None] = {}

#: NaN are left alone, and what is called last is jumped to, at any level of optimisation.
FLAGS = "-O3 -fno-math-errno -fno-trapping-math -fno-tree-loop-distribute-patterns -Wno-psabi"

SOURCE = Path(__file__).with_name("kernel.c")
STATE = "int, const int *, const double *const *, const int *const *, const Program *"
DECLARATION = f"""
typedef struct {{
    int size, forms, elements, functions, chunks, affine, vectors, products, out;
    const int *begin, *nodes, *gradients, *element, *block, *phi, *w, *tape, *contractions;
    const double *weight, *const *table, *literals, *constants;
}} Program;
int evaluate({STATE}, double *const *);
int add({STATE}, int, int, const int *, const int *, const int64_t *, double *);
"""


@dataclass(frozen=True, slots=True)
class Kernel:
    """Code and data for the cell integrals of forms.

    Attributes:
        program: What is made of the forms.
        mesh: The mesh.
        functions: Coefficients that are gathered.
        constants: Constants.
        code: The compiled module.
        cells: The cells; None for all that this process owns.
    """

    program: Program
    mesh: dolfinx.mesh.Mesh
    functions: Sequence[dolfinx.fem.Function]
    constants: Sequence[dolfinx.fem.Constant]
    code: Any
    cells: Indices | None = None

    @property
    def rows(self) -> Indices | slice:
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
        results = [np.empty((arguments[0], *shape)) for shape in self.program.shapes.values()]
        self._require(self.code.lib.evaluate(*arguments, self._pointers("double *", results)))
        return results

    def add_to(self, values: Array, indptr: Numbers, node: Indices, place: Indices) -> None:
        """Add the only form, which is bilinear, to a matrix.

        Args:
            values: Entries of the matrix, row by row.
            indptr: Where each row begins.
            node: Blocks of dofs of each cell, (cells, k).
            place: Where the columns of a block are in the rows of another, (cells, k, k).
        """
        arrays = (pointer(self.code, a) for a in (node, place, indptr, values))
        (shape,), n = self.program.shapes.values(), node.shape[1]
        self._require(self.code.lib.add(*self._state(), n, shape[0] // n, *arrays))

    def _state(self) -> tuple[Any, ...]:
        """Return the cells, what is gathered, and the program with the values of the constants."""
        topology, cells, ffi = self.mesh.topology, self.cells, self.code.ffi
        values = np.concatenate([np.zeros(0), *(np.ravel(c.value) for c in self.constants)])
        arrays = {**self.program.arrays, "constants": values}
        owners = {name: pointer(self.code, a) for name, a in arrays.items()}
        owners["table"] = self._pointers("double *", self.program.tables)
        program = ffi.new("Program *", {**self.program.numbers, **owners})
        x, nodes = self.mesh.geometry.x, compat.geometry_dofmap(self.mesh)
        dofs = [nodes, *(f.function_space.dofmap.list for f in self.functions)]
        return (
            topology.index_map(topology.dim).size_local if cells is None else len(cells),
            ffi.NULL if cells is None else pointer(self.code, cells),
            self._pointers("double *", [x, *(f.x.array for f in self.functions)]),
            self._pointers("int *", dofs),
            ffi.gc(program, lambda _: owners),
        )

    def _pointers(self, kind: str, arrays: Sequence[npt.NDArray[Any]]) -> Any:
        """Return an array of pointers, which keeps what they point to alive."""
        ffi = self.code.ffi
        owners = [pointer(self.code, a) for a in arrays]
        return ffi.gc(ffi.new(f"{kind}[]", owners), lambda _: owners)

    @staticmethod
    def _require(failed: int) -> None:
        if failed:
            raise MemoryError("no memory for the cells of a visit")


def create_kernels(
    forms: Sequence[ufl.Form], mesh: dolfinx.mesh.Mesh, cells: Indices | None = None
) -> list[tuple[list[int], Kernel]] | None:
    """Compile forms of integrals over cells.

    Args:
        forms: The forms.
        mesh: Their mesh.
        cells: Owned cells that are integrated over; all if not given.

    Returns:
        Kernels, one for each quadrature degree, with the numbers of their forms; None where only
        FFCx can compile an integrand.

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
            _generated[key] = generate(forms, mesh, functions, constants)
        except Exception as error:  # FFCx is asked, and says what it does not know
            _log.debug("FFCx compiles cell integrals: %r", error)
            _generated[key] = None
    programs = _generated[key]
    if programs is None:
        return None
    flags = [*FLAGS.split(), *processor_flags()]
    return [
        (
            list(program.shapes),
            Kernel(
                program,
                mesh,
                [functions[i] for i in program.functions],
                [constants[i] for i in program.constants],
                load(SOURCE, DECLARATION, mesh.comm, generated=program.text, flags=flags),
                cells,
            ),
        )
        for program in programs
    ]


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
