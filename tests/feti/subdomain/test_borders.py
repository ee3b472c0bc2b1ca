# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Arrays that compiled code takes are checked: types, order, lengths and bounds.

Products with columns in panels agree with the same columns as a dense matrix.
"""

import numpy as np
import pytest
from cases import each
from collective import COMM, agree, equal, raises

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.coarse.assembly import BlockPattern, CoarseAssembler, add_element
from dolfinx_feti.feti.coarse.basis import SubdomainColumns
from dolfinx_feti.feti.coarse.dofmap import CoarseDofMap
from dolfinx_feti.feti.primal.assembled_product import SharedBlock, add_block, load_block_code
from dolfinx_feti.feti.subdomain.factors.multifrontal import Fronts, load_fronts
from dolfinx_feti.feti.subdomain.factors.packed import TILE, PackedMatrix
from dolfinx_feti.feti.subdomain.factors.work_space import WorkSpace, pack
from dolfinx_feti.feti.subdomain.failures import RemediedFactorError
from dolfinx_feti.feti.subdomain.panels import Panels, load_panels, rows_product
from dolfinx_feti.runtime.petsc_library import CSRMatrix

#: Two panels, of two columns on rows 0 and 2, and of one on row 1.
PANELS = {"starts": [0, 2, 3], "rows": [0, 2, 1], "widths": [2, 1], "values": [1.0, 2, 3, 4, 5]}


def create_panels(n=3, real=np.float64, integer=np.int32, **wrong):
    """Return panels of n rows from PANELS, with some arrays replaced by wrong ones."""
    parts = {name: np.array(wrong.get(name, part)) for name, part in PANELS.items()}
    kinds = {name: real if name == "values" else integer for name in parts}
    return Panels(load_panels(COMM), n, **{k: parts[k].astype(kinds[k]) for k in parts})


SINGLE = np.float32
#: Products of panels with factors of a wrong shape, and the message.
WRONG_SHAPES = {
    "premultiply-order": (lambda W: W.premultiply(np.eye(2)), "a matrix of shape"),
    "premultiply-columns": (lambda W: W.premultiply(np.eye(3)[:, :2]), "a matrix of shape"),
    "premultiply-strided": (lambda W: W.premultiply(np.eye(6)[:3, ::2]), "not contiguous"),
    "premultiply-complex": (lambda W: W.premultiply(np.eye(3).astype(complex)), "give float32"),
    "transposed-rows": (lambda W: W.multiply_transposed(np.ones((2, 3))), "do not fit panels"),
    "transposed-symmetric": (
        lambda W: W.multiply_transposed(np.ones((3, 2)), is_symmetric=True),
        "do not fit panels",
    ),
    "rows": (lambda W: rows_product(W.code, np.ones((2, 3), SINGLE), np.ones(2)), "3 columns"),
}


@each(("call", "message"), WRONG_SHAPES)
def test_panels_refuse_factors_of_a_wrong_shape(call, message):
    """Compiled code would read beyond them."""
    with raises(ValueError, message):
        call(create_panels())


#: The same with numbers of another type than those of the panels.
WRONG_TYPES = {
    "premultiply": lambda W: W.premultiply(np.eye(3, dtype=SINGLE)),
    "transposed": lambda W: W.multiply_transposed(np.ones((3, 1), dtype=SINGLE)),
    "single-panels": lambda W: create_panels(real=SINGLE).premultiply(np.eye(3)),
    "long-indices": lambda W: create_panels(integer=np.int64).premultiply(np.eye(3)),
    "rows": lambda W: rows_product(W.code, np.ones((2, 3), SINGLE), np.ones(3, SINGLE)),
}


@each("call", WRONG_TYPES)
def test_panels_refuse_factors_of_another_type(call):
    """Compiled code would take their bytes for numbers of the panels' type."""
    with raises(TypeError, "ctype"):
        call(create_panels())


#: A path of three nodes of one row each.
GRAPH = {"size": [1, 1, 1], "ptr": [0, 1, 3, 4], "adjacent": [1, 0, 2, 1], "rows": [0, 1, 2]}


def create_path_fronts(glued=(False, False, True), integer=np.int32, **wrong):
    """Return the fronts of the path, with some arrays of its graph replaced by wrong ones."""
    parts = {name: np.array(wrong.get(name, part), integer) for name, part in GRAPH.items()}
    graph = (parts["ptr"], parts["adjacent"])
    number = np.arange(3, dtype=np.int32)
    code = load_fronts(COMM)
    return Fronts(code, parts["rows"], number, parts["size"], graph, np.array(glued))


def path_matrix(integer=np.int32, real=np.float64):
    """Return the matrix of the path in arrays of these types."""
    indptr = [0, 2, 5, 7]
    indices = [0, 1, 0, 1, 2, 1, 2]
    values = [2.0, -1, -1, 2, -1, -1, 2]
    return CSRMatrix(np.array(indptr, integer), np.array(indices, integer), np.array(values, real))


def analyse(**wrong):
    """Call the analysis of fronts itself."""
    graph_arrays = {"ptr": [0, 1, 2], "adjacent": [1, 0], "size": [1, 1], "order": [0, 1], **wrong}
    arrays = {name: np.array(values, dtype=np.int32) for name, values in graph_arrays.items()}
    sizes = {"nodes": len(arrays["size"]), "interior_nodes": len(arrays["order"])}
    code = load_fronts(COMM)
    created = code.ffi.new("assembly_tree **")
    status = code.lib.multifrontal_analyse(
        code.struct("subdomain_graph", **arrays, **sizes), created
    )
    if status == 0:
        code.lib.multifrontal_free(created[0])
    code.require_done(status)


INVALID = "graph of the subdomain, or the order of its nodes, is invalid"
TOO_LARGE = [[2**30, 2**30], [2**30, 2**30 - 1], [19 * 10**8, 1]]
#: What is built, the error, and wrong values of its arrays.
REFUSED = [
    (create_panels, ValueError, "panels do not fit", {"n": [2]}),
    (
        create_panels,
        ValueError,
        "panels do not fit",
        {"starts": [[0, 2], [1, 2, 3], [0, 3, 2], [0, 2, 4]]},
    ),
    (create_panels, ValueError, "panels do not fit", {"rows": [[0, -1, 1], [0, 3, 1]]}),
    (create_panels, ValueError, "panels do not fit", {"widths": [[2], [2, -1], [2, 2]]}),
    (create_panels, ValueError, "panels do not fit", {"values": [[1.0, 2, 3, 4]]}),
    (create_path_fronts, FactorError, INVALID, {"size": [[1, 1], [1, 1, 0], [1, 1, 2]]}),
    (
        create_path_fronts,
        FactorError,
        INVALID,
        {"ptr": [[0, 1, 3], [0, 1, 3, 5], [0, 3, 1, 4], [1, 1, 3, 4]]},
    ),
    (
        create_path_fronts,
        FactorError,
        INVALID,
        {"adjacent": [[1, 0, 3, 1], [1, 0, -1, 1], [1, 0, 2]]},
    ),
    (create_path_fronts, FactorError, INVALID, {"rows": [[0, 1]], "glued": [[False, True]]}),
    (analyse, FactorError, INVALID, {"adjacent": [[2, 0], [-1, 0]], "size": [[1, 0]]}),
    (analyse, FactorError, INVALID, {"order": [[1, 1], [0, 2], [0, -1], [0, 1, 1]]}),
    # more than 2³¹ dofs, or 2⁶⁰ entries, are refused before memory is asked for
    (analyse, RemediedFactorError, "too large .* more subdomains", {"size": TOO_LARGE}),
]


@pytest.mark.parametrize(("build", "kind", "message", "wrong"), REFUSED)
def test_arrays_that_do_not_fit_together_are_refused(build, kind, message, wrong):
    """Each wrong array is found before compiled code reads it."""
    build()
    for name, values in wrong.items():
        for value in values:
            with raises(kind, message):
                build(**{name: value})


@pytest.mark.parametrize("name", ["indptr", "indices", "values"])
def test_fronts_refuse_matrices_of_another_pattern(name):
    """An array that is too short is found before it is read."""
    K = path_matrix()
    shorter = K._replace(**{name: getattr(K, name)[:-1]})
    with raises(RemediedFactorError, "pattern of the matrix has changed"):
        create_path_fronts().factor(shorter, WorkSpace())


@pytest.mark.parametrize(
    "types", [{"integer": np.int64}, {"real": np.float32}], ids=["long", "single"]
)
def test_fronts_refuse_matrices_of_another_type(types):
    """Long indices and single precision are not converted."""
    with raises(TypeError, "ctype"):
        create_path_fronts().factor(path_matrix(**types), WorkSpace())


def test_fronts_refuse_an_addend_of_another_size():
    """It has as many rows as the last front."""
    with raises(ValueError, r"addend has shape \(3, 3\)"):
        create_path_fronts().factor_sum(path_matrix(), np.eye(3), WorkSpace())


@pytest.mark.parametrize(
    ("shape", "error"),
    [((1,), IndexError), ((3,), ValueError), ((3, 2), ValueError)],
    ids=["short", "long", "wide"],
)
def test_fronts_refuse_right_hand_sides_of_another_size(shape, error):
    """The size is that of the interior."""
    (factor, _) = create_path_fronts().factor(path_matrix(), WorkSpace())
    with raises(error, "bounds|shape"):
        factor.solve(np.ones(shape))


WRONG_BLOCKS = {
    "row-beyond": ([0, 3], np.ones(3), "Rows 0 … 3 are not those of a matrix of order 3"),
    "negative-row": ([-1, 2], np.ones(3), "Rows -1 … 2 are not those"),
    "entries": ([0, 2], np.ones(4), "4 entries does not fit 2 rows"),
    "strided": ([0, 2], np.ones(6)[::2], "not contiguous"),
}


@each(("rows", "entries", "message"), WRONG_BLOCKS)
def test_shared_blocks_with_wrong_rows_or_entries_are_refused(rows, entries, message):
    """A block has rows of the matrix, and a packed triangle of contiguous entries."""
    code = load_block_code(COMM)
    A = np.zeros((3, 3), np.float32, order="F")
    add_block(code, A, SharedBlock(np.array([0, 2], np.int32), np.arange(3.0)))
    with raises(ValueError, message):
        add_block(code, A, SharedBlock(np.array(rows, np.int32), entries))


def test_shared_blocks_are_added_to_matrices_in_fortran_order():
    """One in C order is refused."""
    block = SharedBlock(np.array([0], np.int32), np.ones(1))
    with raises(ValueError, "not contiguous in F order"):
        add_block(load_block_code(COMM), np.zeros((3, 3), np.float32), block)


@pytest.mark.parametrize(
    ("real", "integer"), [(np.float64, np.int32), (np.float32, np.int64)], ids=["double", "long"]
)
def test_shared_blocks_of_another_type_are_refused(real, integer):
    """The matrix is in single precision, rows are 32-bit integers."""
    A = np.zeros((3, 3), real, order="F")
    with raises(TypeError, "ctype"):
        add_block(load_block_code(COMM), A, SharedBlock(np.array([0], integer), np.ones(1)))


def test_element_matrices_of_distant_subdomains_are_refused():
    """An element matrix has blocks of adjacent subdomains only, and the size of them."""
    base = 2 * COMM.rank
    one = create_panels(1, starts=[0, 1], rows=[0], widths=[1], values=[1.0])
    by_subdomain = [
        SubdomainColumns(
            rows=slice(i, i + 1),
            U=np.ones((1, 1)),
            block=slice(i, i + 1),
            W=one,
            first_dofs=np.array([base + i]),
            dofs=slice(i, i + 1),
        )
        for i in (0, 1)
    ]
    dofmap = CoarseDofMap(by_subdomain, COMM)
    assembler = CoarseAssembler(by_subdomain, dofmap)
    apart = BlockPattern(
        first_dof=np.arange(2),
        width=np.ones(2, np.int32),
        ptr=np.arange(3, dtype=np.int32),
        adjacent=np.arange(2, dtype=np.int32),
        column=np.zeros(2, np.int32),
        start=np.arange(3),
    )
    both = np.arange(2, dtype=np.int32)
    with raises(ValueError, "two blocks that are not adjacent"):
        add_element(assembler._code, apart, both, np.ones((2, 2)), np.zeros(2))
    for wrong in (np.ones((2, 2)), np.ones((0, 0))):
        with raises(ValueError, "element matrix 0 is"):
            assembler.add(0, wrong)
    dofmap.destroy()


# ---- products with panels -------------------------------------------------------------------


def panels_and_columns(n):
    """Return panels with n rows, and their columns as a dense matrix.

    There is a whole panel, one on a few rows, one of no rows, one on a single row, and one of no
    columns.
    """
    rng = np.random.default_rng(1815)
    rows = [np.arange(n), np.arange(0, n, 3), np.arange(0), np.array([n - 1]), np.arange(2)]
    widths = [4, 2, 3, 1, 0]
    values = [rng.standard_normal((len(of), k)) for of, k in zip(rows, widths, strict=True)]
    W = np.zeros((n, 0))
    for k, of, part in zip(widths, rows, values, strict=True):
        columns = np.zeros((n, k))
        columns[of] = part
        W = np.hstack([W, columns])
    parts = {"starts": np.cumsum([0, *map(len, rows)]), "rows": np.concatenate(rows)}
    return create_panels(
        n, **parts, widths=widths, values=np.concatenate([*map(np.ravel, values)])
    ), W


@pytest.mark.parametrize("n", [5, TILE, 2 * TILE + 7])
def test_products_with_panels_agree_with_dense_columns(n, monkeypatch):
    """S is in packed format, as Schur complements are; every entry of a result is written."""
    monkeypatch.setattr(np, "empty", lambda shape, dtype=float: np.full(shape, np.nan, dtype))
    panels, W = panels_and_columns(n)
    rng = np.random.default_rng(1815)
    S = rng.standard_normal((n, n))
    Y = rng.standard_normal((n, 3))
    S = S + S.T
    agree(panels.shape == W.shape)
    equal(panels.dense(), W)
    equal(panels.multiply_transposed(Y), W.T @ Y, 1e-13 * n)
    E = panels.multiply_transposed(S @ W, is_symmetric=True)
    equal(E, W.T @ S @ W, 1e-13 * n**2)
    equal(panels.premultiply(S), S @ W, 1e-13 * n)
    single = S.astype(np.float32)
    for rows in (S, single):
        product = rows_product(panels.code, rows, Y[:, 0])
        equal(product, rows.astype(np.float64) @ Y[:, 0], 1e-13 * n)
    equal(panels.squares(), (W**2).sum(axis=0), 1e-13 * n)
    matrix = PackedMatrix(pack(S), n, WorkSpace())
    equal(matrix.multiply_panels(panels), S @ W, 1e-13 * n)


@pytest.mark.parametrize("n", [0, 3])
def test_products_without_panels_are_empty(n):
    """A subdomain may contribute no column."""
    none = create_panels(n, starts=[0], rows=[], widths=[], values=[])
    agree(none.shape == (n, 0) == none.dense().shape == none.premultiply(np.eye(n)).shape)
    agree(none.multiply_transposed(np.ones((n, 2))).shape == (0, 2) and len(none.squares()) == 0)
    matrix = PackedMatrix(pack(np.eye(n)), n, WorkSpace())
    agree(matrix.multiply_panels(none).shape == (n, 0))
