# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What compiled code takes is checked at its border: types, order, lengths and bounds.

And what it gives for columns that fall into panels, against the same columns as a dense matrix.
"""

import numpy as np
import pytest
from collective import COMM, agree, equal, raises

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.coarse.fields import Fields
from dolfinx_feti.feti.coarse.near import NearColumns
from dolfinx_feti.feti.primal.assembled import add_block, load_block_code
from dolfinx_feti.feti.subdomain.factors.dense import TILE, PackedMatrix, pack
from dolfinx_feti.feti.subdomain.factors.multifrontal import Fronts, load_fronts
from dolfinx_feti.feti.subdomain.panels import Panels, load_panels, rows_product
from dolfinx_feti.runtime.petsc_library import Rows

#: Two panels, of two columns on rows 0 and 2, and of one on row 1.
PANELS = {"first": [0, 2, 3], "row": [0, 2, 1], "count": [2, 1], "values": [1.0, 2, 3, 4, 5]}


def panels(n=3, real=np.float64, integer=np.int32, **wrong):
    parts = {name: np.array(wrong.get(name, part)) for name, part in PANELS.items()}
    kinds = {name: real if name == "values" else integer for name in parts}
    return Panels(load_panels(COMM), n, **{k: parts[k].astype(kinds[k]) for k in parts})


def test_factors_of_panels_fit():
    W, wide = panels(), np.eye(6)[:3, ::2]
    for call, error in (
        (lambda: W.product(np.eye(2)), "a matrix of shape"),
        (lambda: W.product(np.eye(3)[:, :2]), "a matrix of shape"),
        (lambda: W.product(wide), "not contiguous"),
        (lambda: W.product(np.eye(3).astype(complex)), "give float32"),
        (lambda: W.overlap(np.ones((2, 3))), "do not fit panels"),
        (lambda: W.overlap(np.ones((3, 2)), symmetric=True), "do not fit panels"),
        (lambda: rows_product(W.code, np.ones((2, 3), np.float32), np.ones(2)), "3 columns"),
    ):
        with raises(ValueError, error):
            call()
    for call in (
        lambda: W.product(np.eye(3, dtype=np.float32)),
        lambda: W.overlap(np.ones((3, 1), dtype=np.float32)),
        lambda: panels(real=np.float32).product(np.eye(3)),
        lambda: panels(integer=np.int64).product(np.eye(3)),
        lambda: rows_product(W.code, np.ones((2, 3), np.float32), np.ones(3, np.float32)),
    ):
        with raises(TypeError, "ctype"):
            call()


#: A path of three nodes of one row each.
GRAPH = {"size": [1, 1, 1], "ptr": [0, 1, 3, 4], "adjacent": [1, 0, 2, 1], "rows": [0, 1, 2]}


def fronts(glued=(False, False, True), integer=np.int32, **wrong):
    parts = {name: np.array(wrong.get(name, part), integer) for name, part in GRAPH.items()}
    graph, number = (parts["ptr"], parts["adjacent"]), np.arange(3, dtype=np.int32)
    code = load_fronts(COMM)
    return Fronts(code, parts["rows"], number, parts["size"], graph, np.array(glued))


def path(integer=np.int32, real=np.float64):
    indptr, indices = [0, 2, 5, 7], [0, 1, 0, 1, 2, 1, 2]
    values = [2.0, -1, -1, 2, -1, -1, 2]
    return Rows(np.array(indptr, integer), np.array(indices, integer), np.array(values, real))


def analyse(**wrong):
    """Call the analysis of fronts itself."""
    given = {"ptr": [0, 1, 2], "adjacent": [1, 0], "size": [1, 1], "order": [0, 1], **wrong}
    ptr, adjacent, size, order = (np.array(given[name], dtype=np.int32) for name in given)
    code = load_fronts(COMM)
    made = code.module.ffi.new("fronts **")
    graph = map(code.to, (size, ptr, adjacent))
    status = code.lib.fronts_analyse(len(size), *graph, len(order), code.to(order), made)
    if status == 0:
        code.lib.fronts_free(made[0])
    code.check(status)


INVALID = "graph of the subdomain, or the order of its nodes, is invalid"
TOO_LARGE = [[2**30, 2**30], [2**30, 2**30 - 1], [19 * 10**8, 1]]
#: What is built, the error, and wrong values of its arrays.
REFUSED = [
    (panels, ValueError, "panels do not fit", {"n": [2]}),
    (panels, ValueError, "panels do not fit", {"first": [[0, 2], [1, 2, 3], [0, 3, 2], [0, 2, 4]]}),
    (panels, ValueError, "panels do not fit", {"row": [[0, -1, 1], [0, 3, 1]]}),
    (panels, ValueError, "panels do not fit", {"count": [[2], [2, -1], [2, 2]]}),
    (panels, ValueError, "panels do not fit", {"values": [[1.0, 2, 3, 4]]}),
    (fronts, FactorError, INVALID, {"size": [[1, 1], [1, 1, 0], [1, 1, 2]]}),
    (fronts, FactorError, INVALID, {"ptr": [[0, 1, 3], [0, 1, 3, 5], [0, 3, 1, 4], [1, 1, 3, 4]]}),
    (fronts, FactorError, INVALID, {"adjacent": [[1, 0, 3, 1], [1, 0, -1, 1], [1, 0, 2]]}),
    (fronts, FactorError, INVALID, {"rows": [[0, 1]], "glued": [[False, True]]}),
    (analyse, FactorError, INVALID, {"adjacent": [[2, 0], [-1, 0]], "size": [[1, 0]]}),
    (analyse, FactorError, INVALID, {"order": [[1, 1], [0, 2], [0, -1], [0, 1, 1]]}),
    # more than 2³¹ dofs, or 2⁶⁰ entries, are refused before memory is asked for
    (analyse, FactorError, "too large .* more subdomains", {"size": TOO_LARGE}),
]


@pytest.mark.parametrize(("build", "kind", "message", "wrong"), REFUSED)
def test_arrays_that_do_not_fit(build, kind, message, wrong):
    build()
    for name, values in wrong.items():
        for value in values:
            with raises(kind, message):
                build(**{name: value})


def test_fronts_take_matrices_of_their_pattern():
    F, K = fronts(), path()
    work = np.empty(F.work)
    (factor, _), wide = F.factor(K, work), np.ones((3, 2))
    for wrong in (
        K._replace(indptr=K.indptr[:-1]),
        K._replace(indices=K.indices[:-1]),
        K._replace(values=K.values[:-1]),
    ):
        with raises(FactorError, "pattern of the matrix has changed"):
            F.factor(wrong, work)
    for wrong, space in (
        (path(np.int64), work),
        (path(real=np.float32), work),
        (K, work.astype("f4")),
    ):
        with raises(TypeError, "ctype"):
            F.factor(wrong, space)
    with raises(ValueError, f"work has {len(work) - 1} entries, but {len(work)}"):
        F.factor(K, work[:-1])
    with raises(ValueError, r"held has shape \(3, 3\)"):
        F.factor(K, work, np.eye(3))
    with raises(ValueError, "not contiguous"):
        F.factor(K, np.empty(2 * len(work))[::2])
    for rhs, error in ((np.ones(1), IndexError), (np.ones(3), ValueError), (wide, ValueError)):
        with raises(error, "bounds|shape"):
            factor.solve(rhs)


def test_shares_have_rows_of_the_matrix():
    code, A = load_block_code(COMM), np.zeros((3, 3), np.float32, order="F")
    add_block(code, A, (np.array([0, 2], np.int32), np.arange(3.0)))
    for rows, entries, error in (
        ([0, 3], np.ones(3), "rows 0 … 3 are not those of a matrix of order 3"),
        ([-1, 2], np.ones(3), "rows -1 … 2 are not those"),
        ([0, 2], np.ones(4), "4 entries does not fit 2 rows"),
        ([0, 2], np.ones(6)[::2], "not contiguous"),
    ):
        with raises(ValueError, error):
            add_block(code, A, (np.array(rows, np.int32), entries))
    with raises(ValueError, "not contiguous in F order"):
        add_block(code, np.zeros((3, 3), np.float32), (np.array([0], np.int32), np.ones(1)))
    for matrix, integer in ((np.zeros((3, 3), order="F"), np.int32), (A, np.int64)):
        with raises(TypeError, "ctype"):
            add_block(code, matrix, (np.array([0], integer), np.ones(1)))


def test_elements_couple_columns_that_are_near():
    """Each owner is looked for among those near it, which end."""
    base = 2 * COMM.rank
    count, one = np.ones(2, np.int32), panels(1, first=[0, 1], row=[0], count=[1], values=[1.0])
    near = NearColumns(Fields([one, one], [np.array([base + i]) for i in (0, 1)]), [1, 1], COMM)
    to, lib = near._code.ffi.from_buffer, near._code.lib
    ptr, adjacent = np.arange(3, dtype=np.int32), np.arange(2, dtype=np.int32)
    place, start = np.zeros(2, np.int32), np.arange(3)
    values, both = np.zeros(2), np.arange(2, dtype=np.int32)
    arrays = [to("int[]", a) for a in (count, ptr, adjacent, place)]
    said = lib.add_element(
        2, to("int[]", both), to("double[]", np.ones(4)), *arrays, to("int64_t[]", start),
        to("double[]", values),
    )  # fmt: skip
    agree(said == 1)
    for wrong in (np.ones((2, 2)), np.ones((0, 0))):
        with raises(Exception, "element matrix 0 is"):
            near.sum([wrong, np.ones((1, 1))])
    near.destroy()


# ---- products with panels -------------------------------------------------------------------


def some_panels(n):
    """A whole panel, one on a few rows, one of no rows, one on a single row, one of no columns."""
    rng = np.random.default_rng(1815)
    rows = [np.arange(n), np.arange(0, n, 3), np.arange(0), np.array([n - 1]), np.arange(2)]
    widths = [4, 2, 3, 1, 0]
    values = [rng.standard_normal((len(of), k)) for of, k in zip(rows, widths, strict=True)]
    W = np.zeros((n, 0))
    for k, of, part in zip(widths, rows, values, strict=True):
        columns = np.zeros((n, k))
        columns[of] = part
        W = np.hstack([W, columns])
    parts = {"first": np.cumsum([0, *map(len, rows)]), "row": np.concatenate(rows)}
    return panels(n, **parts, count=widths, values=np.concatenate([*map(np.ravel, values)])), W


@pytest.mark.parametrize("n", [5, TILE, 2 * TILE + 7])
def test_products_are_those_of_the_dense_columns(n, monkeypatch):
    """S is in packed format, as Schur complements are; every entry of a result is written."""
    monkeypatch.setattr(np, "empty", lambda shape, dtype=float: np.full(shape, np.nan, dtype))
    some, W = some_panels(n)
    rng = np.random.default_rng(1815)
    S, Y = rng.standard_normal((n, n)), rng.standard_normal((n, 3))
    S = S + S.T
    agree(some.shape == W.shape)
    equal(some.dense(), W)
    equal(some.overlap(Y), W.T @ Y, 1e-13 * n)
    E = some.overlap(S @ W, symmetric=True)
    equal(E, W.T @ S @ W, 1e-13 * n**2)
    equal(some.product(S), S @ W, 1e-13 * n)
    single = S.astype(np.float32)
    for rows in (S, single):
        found = rows_product(some.code, rows, Y[:, 0])
        equal(found, rows.astype(np.float64) @ Y[:, 0], 1e-13 * n)
    equal(some.squares(), (W**2).sum(axis=0), 1e-13 * n)
    matrix = PackedMatrix(pack(S), n, np.empty(n * n))
    equal(matrix.multiply_panels(some), S @ W, 1e-13 * n)


@pytest.mark.parametrize("n", [0, 3])
def test_no_panels(n):
    none = panels(n, first=[0], row=[], count=[], values=[])
    agree(none.shape == (n, 0) == none.dense().shape == none.product(np.eye(n)).shape)
    agree(none.overlap(np.ones((n, 2))).shape == (0, 2) and len(none.squares()) == 0)
    matrix = PackedMatrix(pack(np.eye(n)), n, np.empty(n * n))
    agree(matrix.multiply_panels(none).shape == (n, 0))
