# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A cell kernel: the integrals of several forms over cells, computed together.

The forms are data (``program``), which ``kernel.c`` reads. The machine code depends only on the
dimension and the number of quadrature points. ``kernel.c`` visits some groups of eight cells at a
time: it computes basis functions and coefficients at the quadrature points once, then all forms.
Values agree with those of FFCx's code to rounding. A value that is NaN in one code is NaN in the
other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx

from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.arrays import Array, Indices
from dolfinx_feti.runtime.native import load, pointer, processor_flags

if TYPE_CHECKING:  # not at run time: it imports the private parts of FFCx
    from dolfinx_feti.fem.cell_kernels.program import Program

#: Flags of the C compiler:
#:
#: - ``-O3`` also turns the call at the end of each instruction into a jump (``tape.h``),
#: - ``-fno-math-errno`` and ``-fno-trapping-math`` allow vectors of square roots and comparisons;
#:   no code reads ``errno`` or the floating point flags,
#: - ``-fno-tree-loop-distribute-patterns`` keeps short loops that set or copy vectors from becoming
#:   calls of ``memset`` and ``memcpy``,
#: - ``-Wno-psabi`` silences notes on vectors as arguments, which only inlined functions have.
#:
#: Infinity and NaN must have effects, so ``-ffast-math`` is not allowed.
FLAGS = "-O3 -fno-math-errno -fno-trapping-math -fno-tree-loop-distribute-patterns -Wno-psabi"

SOURCE = Path(__file__).with_name("kernel.c")
DECLARATIONS = "\n".join(
    path.read_text(encoding="utf-8")
    for path in (SOURCE.parents[1] / "csr_matrix.h", SOURCE.with_name("program.h"))
)


@dataclass(frozen=True, slots=True)
class Kernel:
    """Code and data for the cell integrals of some forms, over owned cells.

    Attributes:
        program: The forms as data.
        forms: Indices of the forms in the list that kernels were generated for. :meth:`evaluate`
            returns a result for each, in this order.
        mesh: The mesh.
        functions: Coefficients, whose present values are used.
        constants: Constants, whose present values are used.
        module: Loaded module of ``kernel.c``.
        cells: The cells, (n_cells,); None for all owned ones.
    """

    program: Program
    forms: tuple[int, ...]
    mesh: dolfinx.mesh.Mesh
    functions: Sequence[dolfinx.fem.Function]
    constants: Sequence[dolfinx.fem.Constant]
    module: Any
    cells: Indices | None = None

    @property
    def rows(self) -> Indices | slice:
        """Index of the kernel's cells in an array with a row for each owned cell."""
        return slice(self._n_cells) if self.cells is None else self.cells

    @property
    def _n_cells(self) -> int:
        """Number of the kernel's cells."""
        if self.cells is not None:
            return len(self.cells)
        topology = self.mesh.topology
        return int(topology.index_map(topology.dim).size_local)

    def evaluate(self) -> list[Array]:
        """Integrate over each cell at the present state.

        Returns:
            Entries of each form, (n_cells, …): one axis for each argument, of the dofs of a cell in
            the order of the element.
        """
        shapes = self.program.shapes.values()
        results = [np.empty((self._n_cells, *shape)) for shape in shapes]
        self._call("evaluate", self._pointers("double", results))
        return results

    def add_to(self, matrix: Any) -> None:
        """Add the only form of the kernel, which is bilinear, to a matrix in compressed rows.

        Args:
            matrix: ``CsrMatrix`` of the kernel's module, see ``assembly.LocalMatrix.c_struct``; its
                values are changed in place.
        """
        assert len(self.forms) == 1, "a kernel of one form"
        self._call("add_to_matrix", matrix)

    def _call(self, name: str, argument: object) -> None:
        """Call a function of ``kernel.c`` with the present state.

        Args:
            name: Name of the function.
            argument: Its second argument, after the program.

        Raises:
            MemoryError: There is no memory for the work space of a visit.
        """
        # pointers do not keep arrays alive: the state has to outlive the call
        state = self._state()
        members = {
            member: pointer(self.module, value) if isinstance(value, np.ndarray) else value
            for member, value in state.items()
        }
        # function 0 of a program is the position x; the coefficients follow
        values = [self.mesh.geometry.x]
        dofmaps = [compat.geometry_dofmap(self.mesh)]
        for f in self.functions:
            values.append(f.x.array)
            dofmaps.append(f.function_space.dofmap.list)
        members["values"] = self._pointers("double", values)
        members["dofmap"] = self._pointers("int", dofmaps)
        program = self.module.ffi.new("Program *", members)
        if getattr(self.module.lib, name)(program, argument):
            raise MemoryError(
                "There is no memory for the integrals over some dozens of cells: run fewer "
                "processes on this machine."
            )

    def _state(self) -> dict[str, int | npt.NDArray[Any]]:
        """Return the members of ``Program``: those of the generator, constants, and cells."""
        state: dict[str, int | npt.NDArray[Any]] = dict(self.program.members)
        state["n_cells"] = self._n_cells
        state["constants"] = np.concatenate(
            [np.zeros(0), *(np.ravel(c.value) for c in self.constants)]
        )
        if self.cells is not None:
            state["cells"] = self.cells
        return state

    def _pointers(self, c_type: str, arrays: Sequence[npt.NDArray[Any]]) -> Any:
        """Return an array of pointers to arrays, which have to outlive it."""
        pointers = [pointer(self.module, array) for array in arrays]
        return self.module.ffi.new(f"{c_type} *[]", pointers)


def load_code(program: Program, comm: MPI.Comm, cache: Path | None) -> Any:
    """Load the machine code of a program; it is compiled unless the cache has it. Collective.

    Args:
        program: The program.
        comm: All processes of the mesh.
        cache: Folder of machine code; None for the one of the package.
    """
    flags = [*FLAGS.split(), *processor_flags()]
    return load(SOURCE, DECLARATIONS, comm, generated=program.text, flags=flags, cache=cache)
