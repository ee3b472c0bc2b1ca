# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Isotropic remeshing of an open triangulated surface.

Repeatedly: split edges longer than 4/3 h, collapse edges shorter than 4/5 h, flip edges towards six
edges at a vertex (four on a rim), move each vertex to the mean of its neighbours and back onto the
original surface (M. Botsch and L. Kobbelt, *A remeshing approach to multiresolution modeling*,
Symposium on Geometry Processing, 2004). The rims stay on the original rims.

One pass of an operation changes independent edges: those with the lowest rank in their
neighbourhood. So a pass is a few array operations, and the result depends on the surface only.

As in ``surface``, x are points, (n, 3) [mm], and t triangles, (m, 3). Edges are compared by keys:
a n + b for the edge (a, b) with a < b.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse

from dolfinx_feti.meshes.surface import (
    Edges,
    SurfaceProjection,
    edge_lengths,
    find_edges,
    triangle_angles,
    triangle_normals,
    vertex_normals,
    without_collapsed,
)
from dolfinx_feti.runtime.arrays import Array, Mask, Numbers

__all__ = ["remesh"]

#: Length over h above which an edge is split: that of Botsch and Kobbelt. An edge of 4/3 h is as
#: far from h as its halves, 2/3 h.
SPLIT_LENGTH = 4 / 3

#: Length over h below which an edge is collapsed: that of Botsch and Kobbelt. An edge of 4/5 h is
#: as far from h as the edges that its collapse extends by half of it, 6/5 h.
COLLAPSE_LENGTH = 4 / 5

#: Rounds of split, collapse, flip and smooth. A choice that was not measured.
SWEEPS = 10

#: Upper bound of the rounds of flips in a sweep. A choice that was not measured.
MAX_FLIP_ROUNDS = 20

#: Rounds of smoothing in a sweep. A choice that was not measured.
SMOOTHING_ROUNDS = 4

#: Cosine of 60°, the largest angle by which a collapse turns a triangle, and the largest angle
#: between two triangles that a flip creates. A choice that was not measured.
MIN_COSINE = 0.5

#: Smallest gain of a flip, in squared valences or in radians: a rounding margin.
MIN_GAIN = 1e-9

#: Number of edges at an inner vertex of a regular triangulation.
REGULAR_VALENCE = 6

#: Number of edges at a vertex on a rim of a regular triangulation.
REGULAR_RIM_VALENCE = 4


def remesh(x: Array, t: Numbers, *, size: float) -> tuple[Array, Numbers]:
    """Return a triangulation of the same surface with edges of about one length.

    Args:
        x: Points of the given surface, (n, 3) [mm].
        t: Its triangles, all oriented alike, (m, 3).
        size: Wanted length h of the edges [mm].

    Returns:
        Points and triangles, oriented as the given ones.
    """
    original = SurfaceProjection(x, t)
    longest = SPLIT_LENGTH * size
    for _ in range(SWEEPS):
        x, t = _split(x, t, longest)
        x, t = _collapse(x, t, shortest=COLLAPSE_LENGTH * size, longest=longest)
        t = _flip(x, t, _valence_gain)
        x = _smooth(x, t, original)
    return x, _flip(x, t, _angle_gain)


# -- ranks of edges -------------------------------------------------------------------------------


def _rank(is_eligible: Mask, values: Array) -> Numbers:
    """Return ranks of edges, (k,): 0, 1, … for the eligible ones by increasing value, k for others.

    Args:
        is_eligible: Mask of the eligible edges, (k,).
        values: Value of each edge, (k,); equal ones are ranked by the number of the edge.
    """
    n_eligible = np.count_nonzero(is_eligible)
    rank = np.full(len(values), len(values))
    eligible_first = np.lexsort((values, ~is_eligible))
    rank[eligible_first[:n_eligible]] = np.arange(n_eligible)
    return rank


def _has_lowest_rank(n: int, ends: Numbers, rank: Numbers) -> Mask:
    """Return a mask of the edges with the lowest rank in their neighbourhood, (k,).

    The neighbourhood of an edge has all edges at its ends and at the neighbours of its ends.

    Args:
        n: Number of vertices.
        ends: Ends of the edges, (k, 2).
        rank: Their ranks, (k,).
    """
    at_vertex = np.full(n, rank.max(initial=0) + 1)
    np.minimum.at(at_vertex, ends, rank[:, None])
    around_vertex = at_vertex.copy()
    np.minimum.at(around_vertex, ends, at_vertex[ends[:, ::-1]])
    return np.asarray(rank == around_vertex[ends].min(axis=1))


# -- splits ---------------------------------------------------------------------------------------


def _split(x: Array, t: Numbers, longest: float) -> tuple[Array, Numbers]:
    """Split edges longer than ``longest`` at their midpoint, the longest of a triangle first."""
    while True:
        edges = find_edges(t)
        length = edge_lengths(x, edges.ends)
        is_long = length > longest
        rank = _rank(is_long, -length)
        lowest_in_triangle = rank[edges.of_triangle].min(axis=1)  # (m,)
        lowest_of_both = lowest_in_triangle[edges.triangles]  # (k, 2)
        lowest_of_both[~edges.is_interior, 1] = len(rank)  # there is no second triangle
        is_split = is_long & (rank <= lowest_of_both.min(axis=1))
        if not is_split.any():
            return x, t
        midpoint = np.full(len(rank), -1)  # number of the new vertex on each edge
        midpoint[is_split] = len(x) + np.arange(np.count_nonzero(is_split))
        x = np.vstack([x, x[edges.ends[is_split]].mean(axis=1)])
        # each triangle (a, b, c) with a split edge (b, c) becomes (a, b, new) and (a, new, c)
        cut, corner = np.nonzero(midpoint[edges.of_triangle] >= 0)
        new = midpoint[edges.of_triangle[cut, corner]]
        a, b, c = (t[cut, (corner + k) % 3] for k in range(3))
        first = np.column_stack([a, b, new])
        second = np.column_stack([a, new, c])
        t = np.vstack([np.delete(t, cut, axis=0), first, second])


# -- collapses ------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Merges:
    """Pairs of vertices that become one; no vertex is in two of them.

    Attributes:
        remaining: Vertices that remain, (k,).
        removed: Vertices that are merged into these, (k,).
        places: Positions of the merged vertices, (k, 3).
    """

    remaining: Numbers
    removed: Numbers
    places: Array

    def select(self, mask: Mask) -> Merges:
        """Return some of the merges, by a mask, (k,)."""
        return Merges(self.remaining[mask], self.removed[mask], self.places[mask])


def _collapse(x: Array, t: Numbers, *, shortest: float, longest: float) -> tuple[Array, Numbers]:
    """Collapse edges shorter than ``shortest``, unless the surface would fold or tear.

    Args:
        x: Points, (n, 3).
        t: Triangles, (m, 3).
        shortest: Length below which an edge is collapsed.
        longest: Length that no edge may exceed afterwards.
    """
    refused: Numbers = np.zeros((0, 2), dtype=np.int64)  # edges that would fold the surface
    while True:
        edges = find_edges(t)
        n = len(x)
        length = edge_lengths(x, edges.ends)
        is_refused = np.isin(_keys(edges.ends, n), _keys(refused, n))
        is_eligible = (length < shortest) & _preserves_topology(n, edges) & ~is_refused
        is_chosen = is_eligible & _has_lowest_rank(n, edges.ends, _rank(is_eligible, length))
        if not is_chosen.any():
            return x, t
        chosen = edges.ends[is_chosen]
        merges = _merges_of_edges(x, chosen, edges.on_rim(n))
        keeps_shape = _keeps_shape(x, t, merges, longest)
        refused = np.vstack([refused, chosen[~keeps_shape]])
        x, t, number = _merge(x, t, merges.select(keeps_shape))
        refused = np.sort(number[refused], axis=1)
        refused = refused[refused[:, 0] >= 0]  # an edge with a removed vertex is another one now


def _keys(ends: Numbers, n: int) -> Numbers:
    """Return a number for each pair of n vertices, (k,): a n + b for (a, b)."""
    return np.asarray(ends @ [n, 1], dtype=np.int64)


def _preserves_topology(n: int, edges: Edges) -> Mask:
    """Return a mask of the edges whose collapse preserves the topology, (k,).

    The ends of such an edge have no common neighbours except the vertices opposite to it, and an
    interior edge does not join two rims.
    """
    a, b = edges.ends.T
    on_rim = edges.on_rim(n)
    A = scipy.sparse.coo_matrix((np.ones(len(a)), (a, b)), shape=(n, n)).tocsr()
    A = A + A.T
    common_neighbours = np.asarray(A[a].multiply(A[b]).sum(axis=1)).ravel()
    opposite_vertices = 1 + edges.is_interior
    joins_rims = edges.is_interior & on_rim[a] & on_rim[b]
    return np.asarray((common_neighbours == opposite_vertices) & ~joins_rims)


def _merges_of_edges(x: Array, ends: Numbers, on_rim: Mask) -> Merges:
    """Return the merges that collapse edges.

    A vertex on a rim remains where it is if the other one is inside; otherwise the merged vertex is
    at the midpoint.

    Args:
        x: Points, (n, 3).
        ends: Ends of the edges, (k, 2).
        on_rim: Mask of the vertices on a rim, (n,).
    """
    second_remains = on_rim[ends[:, 1]] & ~on_rim[ends[:, 0]]
    remaining, removed = np.where(second_remains[:, None], ends[:, ::-1], ends).T
    at_midpoint = (on_rim[remaining] == on_rim[removed])[:, None]
    places = np.where(at_midpoint, (x[remaining] + x[removed]) / 2, x[remaining])
    return Merges(remaining, removed, places)


def _keeps_shape(x: Array, t: Numbers, merges: Merges, longest: float) -> Mask:
    """Return a mask of the merges that turn no triangle by more than 60°, (k,).

    Args:
        x: Points, (n, 3).
        t: Triangles, (m, 3).
        merges: The merges.
        longest: Length that no edge may exceed afterwards.
    """
    k = len(merges.remaining)
    merge_of_vertex = np.full(len(x), -1)
    merge_of_vertex[merges.remaining] = np.arange(k)
    merge_of_vertex[merges.removed] = np.arange(k)
    moved = x.copy()
    moved[merges.remaining] = merges.places
    moved[merges.removed] = merges.places
    merges_of_corners = np.sort(merge_of_vertex[t], axis=1)  # −1 first, for a vertex that stays
    has_one_moved = (merges_of_corners[:, 2] >= 0) & (merges_of_corners[:, 1] < 0)
    changed = t[has_one_moved]  # a triangle with two moved vertices vanishes
    cosine = np.sum(triangle_normals(x, changed) * triangle_normals(moved, changed), axis=1)
    sides = moved[changed] - moved[np.roll(changed, 1, axis=1)]
    longest_side = np.linalg.norm(sides, axis=2).max(axis=1)
    is_bad = (cosine < MIN_COSINE) | (longest_side > longest)
    keeps_shape = np.ones(k, dtype=bool)
    keeps_shape[merges_of_corners[has_one_moved, 2][is_bad]] = False
    return keeps_shape


def _merge(x: Array, t: Numbers, merges: Merges) -> tuple[Array, Numbers, Numbers]:
    """Merge vertices and renumber all of them.

    Args:
        x: Points, (n, 3).
        t: Triangles, (m, 3).
        merges: The merges.

    Returns:
        Points, triangles, and the new number of each vertex, −1 for a removed one, (n,).
    """
    target = np.arange(len(x))
    target[merges.removed] = merges.remaining
    remains = np.ones(len(x), dtype=bool)
    remains[merges.removed] = False
    x = x.copy()
    x[merges.remaining] = merges.places
    t = without_collapsed(target[t])
    number = np.where(remains, np.cumsum(remains) - 1, -1)
    return x[remains], number[t], number


# -- flips ----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Flips:
    """The flips of all interior edges of a surface, each for itself.

    Attributes:
        edges: The edges of the surface.
        which: Numbers of the interior edges, (k,).
        before: The two triangles of each, (k, 2, 3).
        after: The two triangles that a flip makes of them, (k, 2, 3).
    """

    edges: Edges
    which: Numbers
    before: Numbers
    after: Numbers

    @classmethod
    def of_surface(cls, t: Numbers) -> Flips:
        """Return the flips of a surface with triangles t, (m, 3)."""
        edges = find_edges(t)
        which = np.flatnonzero(edges.is_interior)
        return cls(edges, which, t[edges.triangles[which]], _flipped_triangles(t, edges, which))


#: Gain by each flip, (k,), of points (n, 3) and k flips.
Gain = Callable[[Array, Flips], Array]


def _flip(x: Array, t: Numbers, gain_of: Gain) -> Numbers:
    """Return triangles whose edges are flipped as long as a flip has a gain, (m, 3).

    Args:
        x: Points, (n, 3).
        t: Triangles, (m, 3).
        gain_of: Gain by each flip.
    """
    for _ in range(MAX_FLIP_ROUNDS):
        flips = Flips.of_surface(t)
        is_chosen = _has_largest_gain(x, flips, gain_of(x, flips))
        if not is_chosen.any():
            break
        t = t.copy()
        t[flips.edges.triangles[flips.which[is_chosen]]] = flips.after[is_chosen]
    return t


def _has_largest_gain(x: Array, flips: Flips, gain: Array) -> Mask:
    """Return a mask of the possible flips with the largest gain in their neighbourhood, (k,).

    Args:
        x: Points, (n, 3).
        flips: The flips.
        gain: Gain by each of them, (k,).
    """
    n = len(x)
    edges = flips.edges
    new_ends = np.sort(edges.opposite[flips.which], axis=1)
    exists = np.isin(_keys(new_ends, n), _keys(edges.ends, n))
    joins_rims = edges.on_rim(n)[new_ends].all(axis=1)
    keeps_sides = _keeps_sides(x, flips.before, flips.after)
    is_eligible = (gain > MIN_GAIN) & ~exists & ~joins_rims & keeps_sides
    gain_of_edge = np.zeros(len(edges.ends))
    gain_of_edge[flips.which] = gain
    is_eligible_edge = np.zeros(len(edges.ends), dtype=bool)
    is_eligible_edge[flips.which] = is_eligible
    rank = _rank(is_eligible_edge, -gain_of_edge)
    return is_eligible & _has_lowest_rank(n, edges.ends, rank)[flips.which]


def _flipped_triangles(t: Numbers, edges: Edges, which: Numbers) -> Numbers:
    """Return the two triangles of each flipped edge, (k, 2, 3).

    The triangles (c, a, b) and (d, b, a) become (c, a, d) and (d, b, c).

    Args:
        t: Triangles, (m, 3).
        edges: Their edges.
        which: Numbers of the edges, (k,), all of them interior.
    """
    c, d = edges.opposite[which].T
    first = t[edges.triangles[which, 0]]
    corner_c = np.argmax(first == c[:, None], axis=1)
    row = np.arange(len(which))
    a = first[row, (corner_c + 1) % 3]
    b = first[row, (corner_c + 2) % 3]
    return np.stack([np.column_stack([c, a, d]), np.column_stack([d, b, c])], axis=1)


def _valence_gain(x: Array, flips: Flips) -> Array:
    """Return the decrease of the sum of squared excess valences by each flip, (k,).

    The excess of a vertex is its number of edges over that in a regular triangulation.

    Args:
        x: Points, (n, 3); only their number counts.
        flips: The flips.
    """
    n = len(x)
    edges = flips.edges
    regular = np.where(edges.on_rim(n), REGULAR_RIM_VALENCE, REGULAR_VALENCE)
    excess = np.bincount(edges.ends.ravel(), minlength=n) - regular
    at_ends = excess[edges.ends[flips.which]]  # these lose an edge
    at_opposite = excess[edges.opposite[flips.which]]  # these get one
    gain = at_ends**2 - (at_ends - 1) ** 2 + at_opposite**2 - (at_opposite + 1) ** 2
    return np.asarray(gain.sum(axis=1), dtype=np.float64)


def _angle_gain(x: Array, flips: Flips) -> Array:
    """Return by how much each flip opens the smallest angle of its two triangles [rad], (k,)."""
    return _smallest_angle(x, flips.after) - _smallest_angle(x, flips.before)


def _smallest_angle(x: Array, pairs: Numbers) -> Array:
    """Return the smallest angle in each pair of triangles, (k, 2, 3), in radians, (k,)."""
    angles = triangle_angles(x, pairs.reshape(-1, 3))
    return np.asarray(angles.reshape(-1, 6).min(axis=1))


def _keeps_sides(x: Array, before: Numbers, after: Numbers) -> Mask:
    """Return a mask of the flips whose triangles face the side of the old ones, (k,).

    The normals of the two new triangles also differ by less than 60°.

    Args:
        x: Points, (n, 3).
        before: Triangles before each flip, (k, 2, 3).
        after: Triangles after it, (k, 2, 3).
    """
    old_normal = triangle_normals(x, before.reshape(-1, 3)).reshape(-1, 2, 3).sum(axis=1)
    n_1, n_2 = np.moveaxis(triangle_normals(x, after.reshape(-1, 3)).reshape(-1, 2, 3), 1, 0)
    faces_old_side = (np.sum(old_normal * n_1, axis=1) > 0) & (np.sum(old_normal * n_2, axis=1) > 0)
    return np.asarray(faces_old_side & (np.sum(n_1 * n_2, axis=1) > MIN_COSINE))


# -- smoothing ------------------------------------------------------------------------------------


def _smooth(x: Array, t: Numbers, original: SurfaceProjection) -> Array:
    """Move the vertices to the mean of their neighbours, and back onto the original surface.

    A vertex on a rim moves to the mean of its two neighbours on the rim.

    Args:
        x: Points, (n, 3).
        t: Triangles, (m, 3).
        original: Projection onto the original surface.
    """
    edges = find_edges(t)
    n = len(x)
    on_rim = edges.on_rim(n)
    both_ways = np.vstack([edges.ends, edges.ends[:, ::-1]])
    is_used = np.tile(~edges.is_interior, 2) | ~on_rim[both_ways[:, 0]]
    sums = scipy.sparse.coo_matrix(
        (is_used.astype(float), tuple(both_ways.T)), shape=(n, n)
    ).tocsr()
    means = scipy.sparse.diags(1 / np.asarray(sums.sum(axis=1)).ravel()) @ sums
    for _ in range(SMOOTHING_ROUNDS):
        step = means @ x - x
        normal = vertex_normals(x, t)
        along_normal = np.sum(step * normal, axis=1, keepdims=True)
        tangential = x + step - along_normal * normal
        x = x + step
        x[~on_rim] = original.project(tangential[~on_rim])
        x[on_rim] = original.project_on_rim(x[on_rim])
    return x
