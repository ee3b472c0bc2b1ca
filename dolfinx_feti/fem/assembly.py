# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Assembly of the torn matrix: one form, one call, all subdomains of the process.

.. math:: K_i[a, b] = ⟨φ_b, A'(U)\, φ_a⟩_{Ω_{0,i}}

(eq. 27, on a subdomain). The bilinear form is the user's, with test and trial functions replaced by
those of the torn space; coefficients, constants, measures and normals stay. Dirichlet conditions
(eq. 7, Augustin_eq:Dirichlet) never enter K: the matrix carries the list of their dofs (``torn``).
"""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy.sparse

import dolfinx
import dolfinx.fem.petsc
import ufl

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.decomposition import TornSpace
from dolfinx_feti.torn import create_torn_matrix, set_near_kernel

Vector = npt.NDArray[np.float64]

__all__ = [
    "assemble",
    "assemble_owned",
    "attach_near_kernel",
    "create_local_matrix",
    "create_matis",
    "dirichlet_mask",
    "torn_form",
]


def torn_form(
    form: ufl.Form, spaces: Sequence[TornSpace], compiler: Compiler | None = None
) -> dolfinx.fem.Form:
    """Compile a form with its arguments on torn spaces.

    Args:
        form: Form with cell and exterior-facet integrals.
        spaces: Torn space of each argument, by argument number.
        compiler: How; with dolfinx's options if not given.

    Raises:
        ValueError: The form has other integrals; those over interior facets couple subdomains.

    Note:
        Collective.
    """
    kinds = {integral.integral_type() for integral in form.integrals()}
    for kind in sorted(kinds - {"cell", "exterior_facet"}):
        raise ValueError(
            f"The form has {kind.replace('_', '-')} integrals, which have no torn counterpart "
            "(those over interior facets, dS, couple subdomains): use a form with dx and ds only."
        )
    replaced = {
        argument: ufl.Argument(spaces[argument.number()].V_torn, argument.number())
        for argument in form.arguments()
    }
    compiler = compiler or Compiler(spaces[0].V.mesh.comm)
    return compiler.form(ufl.replace(form, replaced))


def create_local_matrix(rows: TornSpace, columns: TornSpace, n_cells: int) -> PETSc.Mat:
    """Allocate a sequential matrix with the pattern of cell-wise assembly on torn spaces.

    Args:
        rows: Torn space of the test function.
        columns: Torn space of the trial function.
        n_cells: Number of owned cells.

    Returns:
        AIJ matrix with explicit zeros; the caller destroys it.
    """
    left, right = (_incidence(space, n_cells) for space in (rows, columns))
    graph = scipy.sparse.csr_array(left.T @ right)
    graph.sort_indices()
    bs = (rows.V_torn.dofmap.index_map_bs, columns.V_torn.dofmap.index_map_bs)
    blocks = (np.ones((graph.nnz, *bs), dtype=np.int8), graph.indices, graph.indptr)
    shape = (graph.shape[0] * bs[0], graph.shape[1] * bs[1])
    pattern = scipy.sparse.bsr_array(blocks, shape=shape).tocsr()
    csr = (
        pattern.indptr.astype(PETSc.IntType),
        pattern.indices.astype(PETSc.IntType),
        np.zeros(pattern.nnz),
    )
    K = PETSc.Mat().createAIJ(pattern.shape, bsize=bs, csr=csr, comm=PETSc.COMM_SELF)
    maps = [_identity_map(n, b) for n, b in zip(pattern.shape, bs, strict=True)]
    K.setLGMap(*maps)
    return K


def assemble(K: PETSc.Mat, form: dolfinx.fem.Form) -> None:
    """Fill a local matrix with a compiled torn form; older values are overwritten."""
    K.zeroEntries()
    dolfinx.fem.petsc.assemble_matrix(K, form)  # type: ignore[arg-type]
    K.assemble()


def assemble_owned(form: dolfinx.fem.Form) -> Vector:
    """Assemble a compiled linear form (eq. 28); return its owned entries, (owned,).

    Note:
        Collective.
    """
    b = dolfinx.fem.assemble_vector(form)
    b.scatter_reverse(dolfinx.la.InsertMode.add)
    return b.array[: b.index_map.size_local * b.block_size].copy()


def create_matis(
    space: TornSpace,
    K: PETSc.Mat,
    bcs: Sequence[dolfinx.fem.DirichletBC],
    stiffness: npt.NDArray[np.float64] | None = None,
) -> PETSc.Mat:
    """Wrap the local matrix of a torn space as the torn matrix of the whole problem.

    Args:
        space: The torn space.
        K: Its local matrix.
        bcs: Dirichlet conditions on V or on its components.
        stiffness: Stiffness of each torn dof for the stiffness scaling, (n_torn,).
    """
    V = space.V
    bs = V.dofmap.index_map_bs
    index_map = V.dofmap.index_map
    sizes = (index_map.size_local * bs, index_map.size_global * bs)
    owned = np.flatnonzero(dirichlet_mask(V, bcs))
    dirichlet = owned + index_map.local_range[0] * bs
    return create_torn_matrix(
        K, space.to_global, sizes, comm=V.mesh.comm, dirichlet=dirichlet, stiffness=stiffness
    )


def dirichlet_mask(
    V: dolfinx.fem.FunctionSpace, bcs: Sequence[dolfinx.fem.DirichletBC]
) -> npt.NDArray[np.bool_]:
    """Mark the owned dofs of V with a Dirichlet condition, (owned,)."""
    mask = np.zeros(V.dofmap.index_map.size_local * V.dofmap.index_map_bs, dtype=bool)
    for bc in bcs:
        dofs, _ = bc._cpp_object.dof_indices()
        mask[dofs[dofs < len(mask)]] = True
    return mask


def attach_near_kernel(A: PETSc.Mat, V: dolfinx.fem.FunctionSpace, u: Vector | None = None) -> None:
    """Attach constants and, for displacements, the rotations of the deformed body.

    Args:
        A: Torn matrix on V.
        V: Space with block size bs; rotations are included if bs is the spatial dimension.
        u: Displacement at the dofs, (owned blocks, bs); zero if not given.
    """
    gdim, bs = V.mesh.geometry.dim, V.dofmap.index_map_bs
    n = V.dofmap.index_map.size_local
    x = V.tabulate_dof_coordinates()[:n, :gdim].copy()
    if bs == gdim and u is not None:
        x += u
    modes = [np.broadcast_to(direction, (n, bs)) for direction in np.eye(bs)]
    if bs == gdim:
        modes += [x @ spin.T for spin in _spins(gdim)]
    vectors = []
    for mode in modes:
        vector = A.createVecRight()
        vector.array[:] = np.ravel(mode)
        vectors.append(vector)
    set_near_kernel(A, vectors, x)


def _spins(gdim: int) -> list[Vector]:
    """Return a basis of the skew matrices, each (gdim, gdim)."""
    spins: list[Vector] = []
    for i in range(gdim):
        for j in range(i):
            spin = np.zeros((gdim, gdim))
            spin[i, j], spin[j, i] = 1.0, -1.0
            spins.append(spin)
    return spins


def _incidence(space: TornSpace, n_cells: int) -> scipy.sparse.csr_array:
    """Return the incidence of owned cells and torn dof blocks, (n_cells, n_blocks)."""
    table = space.V_torn.dofmap.list[:n_cells]
    indptr = np.arange(n_cells + 1) * table.shape[1]
    entries = (np.ones(table.size, dtype=np.int32), table.ravel(), indptr)
    return scipy.sparse.csr_array(entries, shape=(n_cells, len(space.dof)))


def _identity_map(n: int, bs: int) -> PETSc.LGMap:
    blocks = np.arange(n // bs, dtype=PETSc.IntType)
    return PETSc.LGMap().create(blocks, bsize=bs, comm=PETSc.COMM_SELF)
