# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Isotropic remeshing of an open triangulated surface.

Repeatedly: split edges longer than 4/3 h, collapse edges shorter than 4/5 h, flip edges towards six
edges at a vertex (four on a rim), move each vertex to the mean of its neighbours and back onto the
original surface (M. Botsch and L. Kobbelt, *A remeshing approach to multiresolution modeling*,
Symposium on Geometry Processing, 2004). The rims stay on the original rims.

One pass of an operation changes independent edges, those with the lowest rank in their
neighbourhood. A pass is a few array operations, and its result depends on the surface only.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse

from dolfinx_feti.meshes.surface import (
    Edges,
    Guide,
    Indices,
    Mask,
    Points,
    edge_lengths,
    find_edges,
    triangle_angles,
    triangle_normals,
    vertex_normals,
)

__all__ = ["remesh"]


def remesh(x: Points, t: Indices, *, size: float, sweeps: int = 10) -> tuple[Points, Indices]:
    """Return a triangulation of the same surface with edges of about one length.

    Args:
        x: Points of the given surface, (n, 3) [mm].
        t: Its triangles, all oriented alike, (m, 3).
        size: Wanted length h of the edges [mm].
        sweeps: Rounds of split, collapse, flip and smooth.

    Returns:
        Points and triangles, oriented as the given ones.
    """
    guide = Guide(x, t)
    for _ in range(sweeps):
        x, t = _split(x, t, 4 / 3 * size)
        x, t = _collapse(x, t, 4 / 5 * size, 4 / 3 * size)
        t = _flip(x, t)
        x = _smooth(x, t, guide)
    return x, _flip(x, t, by_angle=True)


def _rank(able: Mask, value: Points) -> Indices:
    """Return ranks of edges, (k,): the eligible ones by increasing value, then all others.

    Args:
        able: Mask of the eligible edges, (k,).
        value: Values, (k,); equal ones are ranked by the number of the edge.
    """
    rank = np.full(len(value), len(value))
    rank[np.lexsort((value, ~able))[: able.sum()]] = np.arange(able.sum())
    return rank


def _lowest_around(n: int, ends: Indices, rank: Indices) -> Indices:
    """Return for each edge the lowest rank of an edge at its ends or at their neighbours, (k,)."""
    at_vertex = np.full(n, rank.max(initial=0) + 1)
    np.minimum.at(at_vertex, ends, rank[:, None])
    around = at_vertex.copy()
    np.minimum.at(around, ends, at_vertex[ends[:, ::-1]])
    return np.asarray(around[ends].min(axis=1))


def _split(x: Points, t: Indices, longest: float) -> tuple[Points, Indices]:
    """Split edges longer than ``longest`` at their midpoint, the longest of a triangle first."""
    while True:
        edges = find_edges(t)
        length = edge_lengths(x, edges.ends)
        rank = _rank(length > longest, -length)
        # lowest rank in each of the triangles on both sides of an edge
        first = rank[edges.of_triangle].min(axis=1)[edges.sides]
        first[edges.sides[:, 1] < 0, 1] = len(rank)
        chosen = (length > longest) & (rank <= first.min(axis=1))
        if not chosen.any():
            return x, t
        middle = np.full(len(rank), -1)
        middle[chosen] = len(x) + np.arange(chosen.sum())
        x = np.vstack([x, x[edges.ends[chosen]].mean(axis=1)])
        # the triangles with a chosen edge, opposite to corner a
        cut, corner = np.nonzero(middle[edges.of_triangle] >= 0)
        new = middle[edges.of_triangle[cut, corner]]
        a, b, c = (t[cut, (corner + k) % 3] for k in range(3))
        halves = np.column_stack([a, b, new]), np.column_stack([a, new, c])
        t = np.vstack([np.delete(t, cut, axis=0), *halves])


def _collapse(x: Points, t: Indices, shortest: float, longest: float) -> tuple[Points, Indices]:
    """Collapse edges shorter than ``shortest``, unless the surface would fold or tear.

    Args:
        x: Points, (n, 3).
        t: Triangles, (m, 3).
        shortest: Length below which an edge is collapsed.
        longest: Length that no edge may exceed afterwards.
    """
    refused: Indices = np.zeros((0, 2), dtype=np.int64)
    while True:
        edges = find_edges(t)
        n = len(x)
        length = edge_lengths(x, edges.ends)
        able = (length < shortest) & _can_merge(n, edges)
        # edges are compared as numbers, a n + b for (a, b)
        able &= ~np.isin(edges.ends @ [n, 1], refused @ [n, 1])
        rank = _rank(able, length)
        chosen = edges.ends[able & (rank == _lowest_around(n, edges.ends, rank))]
        if not len(chosen):
            return x, t
        rim = edges.on_rim(n)
        swap = rim[chosen[:, 1]] & ~rim[chosen[:, 0]]  # the vertex on a rim remains
        onto, removed = np.where(swap[:, None], chosen[:, ::-1], chosen).T
        at_midpoint = (rim[onto] == rim[removed])[:, None]
        place = np.where(at_midpoint, (x[onto] + x[removed]) / 2, x[onto])
        good = _fits(x, t, onto, removed, place, longest)
        refused = np.vstack([refused, chosen[~good]])
        x, t, number = _merge(x, t, onto[good], removed[good], place[good])
        refused = np.sort(number[refused], axis=1)
        refused = refused[refused[:, 0] >= 0]


def _can_merge(n: int, edges: Edges) -> Mask:
    """Return a mask of the edges whose collapse preserves the topology, (k,).

    The ends of such an edge have no common neighbours except the vertices across the edge, and an
    interior edge does not join two rims.
    """
    a, b = edges.ends.T
    inside = edges.sides[:, 1] >= 0
    rim = edges.on_rim(n)
    A = scipy.sparse.coo_matrix((np.ones(len(a)), (a, b)), shape=(n, n)).tocsr()
    A = A + A.T
    common = np.asarray(A[a].multiply(A[b]).sum(axis=1)).ravel()
    return np.asarray((common == 1 + inside) & ~(inside & rim[a] & rim[b]))


def _fits(
    x: Points, t: Indices, onto: Indices, removed: Indices, place: Points, longest: float
) -> Mask:
    """Return a mask of the merges that turn no triangle by more than 60°, (k,).

    Args:
        x: Points, (n, 3).
        t: Triangles, (m, 3).
        onto: Vertices that remain, (k,).
        removed: Vertices that are merged into them, (k,).
        place: Their new position, (k, 3).
        longest: Length that no edge may exceed afterwards.
    """
    merge = np.full(len(x), -1)
    merge[onto] = np.arange(len(onto))
    merge[removed] = np.arange(len(onto))
    moved = x.copy()
    moved[onto] = place
    moved[removed] = place
    touched = np.sort(merge[t], axis=1)
    remains = (touched[:, 2] >= 0) & (touched[:, 1] < 0)  # triangles with one moved vertex
    s = t[remains]
    turned = np.sum(triangle_normals(x, s) * triangle_normals(moved, s), axis=1) < 0.5  # cos 60°
    side = np.linalg.norm(moved[s] - moved[np.roll(s, 1, axis=1)], axis=2).max(axis=1)
    good = np.ones(len(onto), dtype=bool)
    good[touched[remains, 2][turned | (side > longest)]] = False
    return good


def _merge(
    x: Points, t: Indices, onto: Indices, removed: Indices, place: Points
) -> tuple[Points, Indices, Indices]:
    """Merge vertices and renumber.

    Args:
        x: Points, (n, 3).
        t: Triangles, (m, 3).
        onto: Vertices that remain, (k,).
        removed: Vertices that are merged into them, (k,).
        place: Their new position, (k, 3).

    Returns:
        Points, triangles, and the new number of each vertex, -1 for removed ones, (n,).
    """
    target = np.arange(len(x))
    remains = np.ones(len(x), dtype=bool)
    target[removed] = onto
    remains[removed] = False
    x = x.copy()
    x[onto] = place
    t = target[t]
    t = t[(t[:, 0] != t[:, 1]) & (t[:, 1] != t[:, 2]) & (t[:, 2] != t[:, 0])]
    number = np.where(remains, np.cumsum(remains) - 1, -1)
    return x[remains], number[t], number


def _flip(x: Points, t: Indices, *, by_angle: bool = False, rounds: int = 20) -> Indices:
    """Flip edges if this evens out the valences or, ``by_angle``, opens the smallest angle."""
    for _ in range(rounds):
        edges = find_edges(t)
        n = len(x)
        inside = np.flatnonzero(edges.sides[:, 1] >= 0)
        old = t[edges.sides[inside]]
        new = _turned(t, edges, inside)
        gain = _angle_gain(x, old, new) if by_angle else _valence_gain(n, edges, inside)
        across = np.sort(edges.across[inside], axis=1)
        able = (gain > 1e-9) & ~np.isin(across @ [n, 1], edges.ends @ [n, 1])
        able &= ~edges.on_rim(n)[across].all(axis=1) & _faces_alike(x, old, new)
        value = np.zeros(len(edges.ends))
        value[inside] = gain
        mask = np.zeros(len(edges.ends), dtype=bool)
        mask[inside[able]] = True
        rank = _rank(mask, -value)
        chosen = able & (rank == _lowest_around(n, edges.ends, rank))[inside]
        if not chosen.any():
            break
        t = t.copy()
        t[edges.sides[inside[chosen]]] = new[chosen]
    return t


def _turned(t: Indices, edges: Edges, which: Indices) -> Indices:
    """Return the two triangles on the sides of flipped edges, (k, 2, 3).

    With the corners c, a, b and d, b, a of the old ones they are c, a, d and d, b, c.
    """
    c, d = edges.across[which].T
    first = t[edges.sides[which, 0]]
    at = np.argmax(first == c[:, None], axis=1)
    k = np.arange(len(which))
    a = first[k, (at + 1) % 3]
    b = first[k, (at + 2) % 3]
    return np.stack([np.column_stack([c, a, d]), np.column_stack([d, b, c])], axis=1)


def _valence_gain(n: int, edges: Edges, which: Indices) -> Points:
    """Return the decrease of the sum of squared excess valences by each flip, (k,).

    The excess is that over 6 edges at a vertex, or over 4 on a rim.
    """
    excess = np.bincount(edges.ends.ravel(), minlength=n) - np.where(edges.on_rim(n), 4, 6)
    ends = excess[edges.ends[which]]
    across = excess[edges.across[which]]
    gain = ends**2 - (ends - 1) ** 2 + across**2 - (across + 1) ** 2
    return np.asarray(gain.sum(axis=1), dtype=np.float64)


def _angle_gain(x: Points, old: Indices, new: Indices) -> Points:
    """Return the increase of the smallest angle by each flip [rad], (k,)."""
    smallest = [triangle_angles(x, s.reshape(-1, 3)).reshape(-1, 6).min(axis=1) for s in (old, new)]
    return np.asarray(smallest[1] - smallest[0])


def _faces_alike(x: Points, old: Indices, new: Indices) -> Mask:
    """Return a mask of the flips whose triangles face the side of the old ones, (k,).

    The normals of the two new triangles also differ by less than 60°.
    """
    before = triangle_normals(x, old.reshape(-1, 3)).reshape(-1, 2, 3).sum(axis=1)
    n, m = np.moveaxis(triangle_normals(x, new.reshape(-1, 3)).reshape(-1, 2, 3), 1, 0)
    forward = (np.sum(before * n, axis=1) > 0) & (np.sum(before * m, axis=1) > 0)
    return np.asarray(forward & (np.sum(n * m, axis=1) > 0.5))  # cos 60°


def _smooth(x: Points, t: Indices, guide: Guide, *, rounds: int = 4) -> Points:
    """Move the vertices to the mean of their neighbours, and back onto the original surface."""
    edges = find_edges(t)
    n = len(x)
    rim = edges.on_rim(n)
    both_ways = np.vstack([edges.ends, edges.ends[:, ::-1]])
    weight = np.tile(edges.sides[:, 1] < 0, 2) | ~rim[both_ways[:, 0]]
    M = scipy.sparse.coo_matrix((weight.astype(float), tuple(both_ways.T)), shape=(n, n)).tocsr()
    M = scipy.sparse.diags(1 / np.asarray(M.sum(axis=1)).ravel()) @ M
    for _ in range(rounds):
        step = M @ x - x
        normal = vertex_normals(x, t)
        y = x + step - np.sum(step * normal, axis=1, keepdims=True) * normal
        x = x + step
        x[~rim] = guide.project(y[~rim])
        x[rim] = guide.project_on_rim(x[rim])
    return x
