# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Assembly of the torn matrix, of residuals and energies, and of arrays cell by cell.

.. math:: K_i[a, b] = ⟨φ_b, A'(U)\, φ_a⟩_{Ω_{0,i}}

(eq. 27, on a subdomain). Dirichlet conditions (eq. 7, Augustin_eq:Dirichlet) never enter K: the
matrix carries the list of their dofs (``torn``). dolfinx and PETSc read the same memory. What
``condensation`` solves is an array for each of several forms, see :func:`cell_tensors`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
import scipy.sparse

import dolfinx
import ufl

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.decomposition import TornSpace
from dolfinx_feti.fem.kernels.kernel import Kernel, compile_cells
from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.arrays import Array, Indices, Mask
from dolfinx_feti.runtime.events import event
from dolfinx_feti.torn.matrix import create_torn_matrix


@dataclass(frozen=True, slots=True)
class SplitForm:
    """A form in two parts: kernels, one for each region of cells, and what dolfinx assembles."""

    kernels: tuple[Kernel, ...]
    rest: dolfinx.fem.Form | None  # None for nothing


def split_form(
    form: ufl.Form, mesh: dolfinx.mesh.Mesh, compiler: Compiler, spaces: Sequence[TornSpace] = ()
) -> SplitForm:
    """Compile a form, with the arguments of what dolfinx assembles on torn spaces. Collective."""
    kernels, (rest,) = compile_cells([form], mesh, compiler.cache)
    compiled = None if rest.empty() else dolfinx_form(rest, spaces, compiler)
    return SplitForm(tuple(kernel for _, kernel in kernels), compiled)


def torn_form(form: ufl.Form, space: TornSpace, compiler: Compiler) -> SplitForm:
    """Compile a bilinear form, with both arguments in V, for a torn space. Collective."""
    require_no_coupling(form)
    return split_form(form, space.V.mesh, compiler, (space, space))


def dolfinx_form(
    form: ufl.Form, spaces: Sequence[TornSpace], compiler: Compiler
) -> dolfinx.fem.Form:
    """Compile a form with each argument, by its number, on a torn space, if given. Collective."""
    arguments = form.arguments() if spaces else ()
    torn = {a: ufl.Argument(spaces[a.number()].V_torn, a.number()) for a in arguments}
    return compiler.form(ufl.replace(form, torn))


def require_no_coupling(form: ufl.Form) -> None:
    """Refuse, by a ValueError, integrals over more than cells, exterior facets and points."""
    kinds = {integral.integral_type() for integral in form.integrals()}
    if "vertex" in kinds and not compat.has_vertex_integrals():
        raise ValueError(
            "The form has integrals over vertices, dP, which dolfinx assembles from 0.10 on: "
            "install that, or add the forces to the vector that problem.solver.solve takes."
        )
    for kind in sorted(kinds - {"cell", "exterior_facet", "vertex"}):
        raise ValueError(
            f"The form has {kind.replace('_', '-')} integrals, which have no torn counterpart "
            "(those over interior facets, dS, couple subdomains): use a form with dx and ds only, "
            "and dP over vertices. Values on a surface inside, as of a membrane, are integrated "
            "from one side, by a ds with the cells of dolfinx_feti.fem.facets.one_side. Jumps and "
            "gradients across facets cannot be torn: solve such a problem by dolfinx, with MUMPS."
        )


@dataclass(frozen=True, slots=True)
class LocalMatrix:
    """A matrix of this process, filled by dolfinx and read by PETSc: both have the same entries.

    What changes the entries by way of ``csr`` calls PETSc's ``stateIncrease``.
    """

    csr: dolfinx.la.MatrixCSR
    mat: PETSc.Mat  # sequential AIJ, which the owner destroys
    node: Indices  # torn nodes (blocks of dofs) of each owned cell, (cells, k)
    place: Indices  # where the columns of a node are in the rows of another, (cells, k, k)


def create_csr(spaces: tuple[TornSpace, TornSpace], compiler: Compiler) -> dolfinx.la.MatrixCSR:
    """Allocate dolfinx's matrix on torn spaces of rows and columns, of blocks of one size.

    All dofs of a cell are coupled, whether a form is integrated over that cell or not. Collective.
    """
    v, u = _first(ufl.TestFunction(spaces[0].V)), _first(ufl.TrialFunction(spaces[1].V))
    form = v * u * ufl.dx(metadata={"quadrature_degree": 0})
    pattern = dolfinx.fem.create_sparsity_pattern(dolfinx_form(form, spaces, compiler))
    pattern.finalize()
    mode = dolfinx.la.BlockMode.expanded  # type: ignore[attr-defined]
    return dolfinx.la.matrix_csr(pattern, mode)  # with rows of dofs, as PETSc has them


@event("FETIPattern")
def create_local_matrix(space: TornSpace, compiler: Compiler) -> LocalMatrix:
    """Allocate the local matrix of a torn space. Collective."""
    csr = create_csr((space, space), compiler)
    topology, dofmap = space.V.mesh.topology, space.V_torn.dofmap
    bs, n = dofmap.index_map_bs, len(csr.indptr) - 1
    indptr, indices = (a.astype(PETSc.IntType, copy=False) for a in (csr.indptr, csr.indices))
    mat = PETSc.Mat().createAIJWithArrays((n, n), (indptr, indices, csr.data), comm=PETSc.COMM_SELF)
    mat.setBlockSizes(bs, bs)  # an argument for it has no effect
    node = dofmap.list[: topology.index_map(topology.dim).size_local]
    first = scipy.sparse.csr_array((csr.indices, csr.indices, csr.indptr), (n, n))[::bs]
    pairs = np.repeat(np.arange(n // bs) * n, np.diff(first.indptr)) + first.indices
    place = np.searchsorted(pairs, node[:, :, None].astype(np.int64) * n + node[:, None, :] * bs)
    return LocalMatrix(csr, mat, node, (place - first.indptr[node][:, :, None]).astype(np.int32))


def assemble(K: LocalMatrix, form: SplitForm) -> None:
    """Fill a local matrix with a compiled torn form; older values are overwritten."""
    K.csr.data[:] = 0.0
    if form.rest is not None:
        dolfinx.fem.assemble_matrix(K.csr, form.rest)  # type: ignore[arg-type]
    for kernel in form.kernels:
        kernel.add_to(np.asarray(K.csr.data, dtype=np.float64), K.csr.indptr, K.node, K.place)
    K.mat.stateIncrease()


def assemble_vector(form: SplitForm, V: dolfinx.fem.FunctionSpace) -> dolfinx.la.Vector:
    """Assemble a linear form tested in V over the cells of this process, with ghosts."""
    if form.rest is None:
        b = dolfinx.la.vector(V.dofmap.index_map, V.dofmap.index_map_bs)
    else:
        b = dolfinx.fem.assemble_vector(form.rest)
    bs = V.dofmap.index_map_bs
    for kernel in form.kernels:
        (r,) = kernel.evaluate()
        dofs = V.dofmap.list[kernel.rows][:, :, None] * bs + np.arange(bs, dtype=np.int32)
        b.array[:] += np.bincount(dofs.ravel(), r.ravel(), minlength=len(b.array))
    return b


def integrate(form: SplitForm) -> float:
    """Return the integral over the cells of this process."""
    total = 0.0 if form.rest is None else float(dolfinx.fem.assemble_scalar(form.rest))
    return total + sum(float(kernel.evaluate()[0].sum()) for kernel in form.kernels)


def assemble_owned(form: dolfinx.fem.Form) -> Array:
    """Assemble a compiled linear form (eq. 28); return its owned entries, (owned,). Collective."""
    b = dolfinx.fem.assemble_vector(form)
    b.scatter_reverse(dolfinx.la.InsertMode.add)
    return b.array[: b.index_map.size_local * b.block_size].copy()


def create_matis(
    space: TornSpace,
    K: PETSc.Mat,
    bcs: Sequence[dolfinx.fem.DirichletBC],
    stiffness: Array | None = None,
    symmetric: bool | None = None,
) -> PETSc.Mat:
    """Wrap the local matrix of a torn space, see :func:`~dolfinx_feti.create_torn_matrix`."""
    bs, index_map = space.V.dofmap.index_map_bs, space.V.dofmap.index_map
    sizes, comm = (index_map.size_local * bs, index_map.size_global * bs), space.V.mesh.comm
    A = create_torn_matrix(
        K, space.to_global, sizes, comm=comm, stiffness=stiffness, symmetric=symmetric
    )
    prescribe(A, dirichlet_mask(space.V, bcs))
    return A


def prescribe(A: PETSc.Mat, dirichlet: Mask) -> None:
    """Let a torn matrix have these Dirichlet dofs, (owned,), and no others. Collective."""
    dofs = np.flatnonzero(dirichlet) + A.getOwnershipRange()[0]
    A.compose("dirichlet", PETSc.IS().createGeneral(dofs.astype(PETSc.IntType), comm=A.comm))


def dirichlet_mask(V: dolfinx.fem.FunctionSpace, bcs: Sequence[dolfinx.fem.DirichletBC]) -> Mask:
    """Mark the owned dofs of V with a Dirichlet condition, (owned,)."""
    mask = np.zeros(V.dofmap.index_map.size_local * V.dofmap.index_map_bs, dtype=bool)
    for bc in bcs:
        dofs, _ = bc._cpp_object.dof_indices()
        mask[dofs[dofs < len(mask)]] = True
    return mask


def cell_tensors(
    forms: Sequence[ufl.Form], mesh: dolfinx.mesh.Mesh, compiler: Compiler
) -> Callable[[], list[Array]]:
    """Compile forms that couple no cells, of which some may be zero. Collective.

    The result integrates them at the present state in one visit of each cell, and returns for each
    form (cells, …) with the dofs of a cell for each argument, in the order of the element.
    """
    for form in forms:
        require_no_coupling(form)
    cells = mesh.topology.index_map(mesh.topology.dim).size_local
    widths = [[_width(a.ufl_function_space()) for a in form.arguments()] for form in forms]
    shapes = [(cells, *width) for width in widths]
    kernels, parts = compile_cells(forms, mesh, compiler.cache)
    rest = {
        i: _assembler(form, shapes[i], compiler) for i, form in enumerate(parts) if not form.empty()
    }

    def assemble() -> list[Array]:
        values = [np.zeros(shape) for shape in shapes]
        for numbers, kernel in kernels:
            for i, part in zip(numbers, kernel.evaluate(), strict=True):
                values[i][kernel.rows] += part
        for i, assemble_rest in rest.items():
            values[i] += assemble_rest()
        return values

    return assemble


def _assembler(form: ufl.Form, shape: tuple[int, ...], compiler: Compiler) -> Callable[[], Array]:
    """Compile a form for dolfinx, with dofs of its own for each cell, in the cell's order."""
    spaces = [_broken(a.ufl_function_space(), shape[0]) for a in form.arguments()]
    compiled = dolfinx_form(form, spaces, compiler)
    if len(spaces) < 2:
        return lambda: dolfinx.fem.assemble_vector(compiled).array.reshape(shape)
    csr = create_csr((spaces[0], spaces[1]), compiler)  # rows have the columns of their cell

    def matrix() -> Array:
        csr.data[:] = 0.0
        dolfinx.fem.assemble_matrix(csr, compiled)  # type: ignore[arg-type]
        return np.asarray(csr.data).reshape(shape)

    return matrix


def _width(V: dolfinx.fem.FunctionSpace) -> int:
    """Return the number of dofs of a cell."""
    return int(V.dofmap.list.shape[1]) * V.dofmap.bs


def _broken(V: dolfinx.fem.FunctionSpace, cells: int) -> TornSpace:
    """Give each owned cell dofs of its own; one by one, as dolfinx's rectangular matrices need."""
    width = _width(V)
    table = np.zeros((len(V.dofmap.list), width), dtype=np.int32)
    table[:cells] = np.arange(cells * width, dtype=np.int32).reshape(cells, width)
    torn = compat.create_function_space(V, table, cells * width, block_size=1)
    return TornSpace(V, torn, table[:0].ravel(), table[:0].ravel().astype(np.int64))


def _first(argument: ufl.Argument) -> ufl.core.expr.Expr:
    """Return the first component of an argument."""
    return argument[(0,) * len(argument.ufl_shape)] if argument.ufl_shape else argument
