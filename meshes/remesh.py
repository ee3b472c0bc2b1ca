# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Isotropic remeshing of an open triangulated surface.

Split what is longer than 4/3 h, collapse what is shorter than 4/5 h, flip towards six triangles at
a vertex (four on a rim), move the vertices to the middle of their neighbours and back onto the
given surface; repeat (M. Botsch and L. Kobbelt, *A remeshing approach to multiresolution modeling*,
Symposium on Geometry Processing, 2004). The rims stay on the given rims.

One pass of an operation changes edges that do not see each other: an edge goes first if its rank is
the lowest around it. So a pass is a few array operations, and its result depends on nothing but the
surface.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse

from meshes.surface import (
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
    """Rank the able edges by rising value, ties by their number; all others come last."""
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
    """Halve the edges that are too long, those first that rank first in all their triangles."""
    while True:
        edges = find_edges(t)
        length = edge_lengths(x, edges.ends)
        rank = _rank(length > longest, -length)
        first = rank[edges.of_triangle].min(axis=1)[edges.sides]
        first[edges.sides[:, 1] < 0, 1] = len(rank)
        chosen = (length > longest) & (rank <= first.min(axis=1))
        if not chosen.any():
            return x, t
        middle = np.full(len(rank), -1)
        middle[chosen] = len(x) + np.arange(chosen.sum())
        x = np.vstack([x, x[edges.ends[chosen]].mean(axis=1)])
        cut, corner = np.nonzero(middle[edges.of_triangle] >= 0)
        new = middle[edges.of_triangle[cut, corner]]
        a, b, c = (t[cut, (corner + k) % 3] for k in range(3))
        halves = np.column_stack([a, b, new]), np.column_stack([a, new, c])
        t = np.vstack([np.delete(t, cut, axis=0), *halves])


def _collapse(x: Points, t: Indices, shortest: float, longest: float) -> tuple[Points, Indices]:
    """Merge the ends of the edges that are too short, unless the surface would fold or tear."""
    refused: Indices = np.zeros((0, 2), dtype=np.int64)
    while True:
        edges, n = find_edges(t), len(x)
        length = edge_lengths(x, edges.ends)
        able = (length < shortest) & _can_merge(n, edges)
        able &= ~np.isin(edges.ends @ [n, 1], refused @ [n, 1])
        rank = _rank(able, length)
        chosen = edges.ends[able & (rank == _lowest_around(n, edges.ends, rank))]
        if not len(chosen):
            return x, t
        rim = edges.on_rim(n)
        swap = rim[chosen[:, 1]] & ~rim[chosen[:, 0]]
        onto, gone = np.where(swap[:, None], chosen[:, ::-1], chosen).T
        on_middle = (rim[onto] == rim[gone])[:, None]
        place = np.where(on_middle, (x[onto] + x[gone]) / 2, x[onto])
        good = _fits(x, t, onto, gone, place, longest)
        refused = np.vstack([refused, chosen[~good]])
        x, t, number = _merge(x, t, onto[good], gone[good], place[good])
        refused = np.sort(number[refused], axis=1)
        refused = refused[refused[:, 0] >= 0]


def _can_merge(n: int, edges: Edges) -> Mask:
    """Say for which edges the surface stays one: no neighbour in common but those across."""
    a, b = edges.ends.T
    inside, rim = edges.sides[:, 1] >= 0, edges.on_rim(n)
    A = scipy.sparse.coo_matrix((np.ones(len(a)), (a, b)), shape=(n, n)).tocsr()
    A = A + A.T
    common = np.asarray(A[a].multiply(A[b]).sum(axis=1)).ravel()
    return np.asarray((common == 1 + inside) & ~(inside & rim[a] & rim[b]))


def _fits(
    x: Points, t: Indices, onto: Indices, gone: Indices, place: Points, longest: float
) -> Mask:
    """Say which merges turn no triangle by more than 60° and make no edge too long."""
    merge = np.full(len(x), -1)
    merge[onto] = merge[gone] = np.arange(len(onto))
    moved = x.copy()
    moved[onto] = moved[gone] = place
    touched = np.sort(merge[t], axis=1)
    left = (touched[:, 2] >= 0) & (touched[:, 1] < 0)
    s = t[left]
    turned = np.sum(triangle_normals(x, s) * triangle_normals(moved, s), axis=1) < 0.5
    side = np.linalg.norm(moved[s] - moved[np.roll(s, 1, axis=1)], axis=2).max(axis=1)
    good = np.ones(len(onto), dtype=bool)
    good[touched[left, 2][turned | (side > longest)]] = False
    return good


def _merge(
    x: Points, t: Indices, onto: Indices, gone: Indices, place: Points
) -> tuple[Points, Indices, Indices]:
    """Merge vertices and renumber; return points, triangles, and the new numbers (-1: gone)."""
    target, kept = np.arange(len(x)), np.ones(len(x), dtype=bool)
    target[gone], kept[gone] = onto, False
    x = x.copy()
    x[onto] = place
    t = target[t]
    t = t[(t[:, 0] != t[:, 1]) & (t[:, 1] != t[:, 2]) & (t[:, 2] != t[:, 0])]
    number = np.where(kept, np.cumsum(kept) - 1, -1)
    return x[kept], number[t], number


def _flip(x: Points, t: Indices, *, by_angle: bool = False, rounds: int = 20) -> Indices:
    """Flip edges where that evens out the valences, or where it opens the smallest angle."""
    for _ in range(rounds):
        edges, n = find_edges(t), len(x)
        inside = np.flatnonzero(edges.sides[:, 1] >= 0)
        old, new = t[edges.sides[inside]], _turned(t, edges, inside)
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
    a, b = first[k, (at + 1) % 3], first[k, (at + 2) % 3]
    return np.stack([np.column_stack([c, a, d]), np.column_stack([d, b, c])], axis=1)


def _valence_gain(n: int, edges: Edges, which: Indices) -> Points:
    """Return by how much a flip lowers the sum of squared excesses over 6 edges (4 on a rim)."""
    excess = np.bincount(edges.ends.ravel(), minlength=n) - np.where(edges.on_rim(n), 4, 6)
    ends, across = excess[edges.ends[which]], excess[edges.across[which]]
    gain = ends**2 - (ends - 1) ** 2 + across**2 - (across + 1) ** 2
    return np.asarray(gain.sum(axis=1), dtype=np.float64)


def _angle_gain(x: Points, old: Indices, new: Indices) -> Points:
    """Return by how much a flip opens the smallest angle [rad]."""
    smallest = [triangle_angles(x, s.reshape(-1, 3)).reshape(-1, 6).min(axis=1) for s in (old, new)]
    return np.asarray(smallest[1] - smallest[0])


def _faces_alike(x: Points, old: Indices, new: Indices) -> Mask:
    """Say which flips leave two triangles that face each other's way and the old ones'."""
    before = triangle_normals(x, old.reshape(-1, 3)).reshape(-1, 2, 3).sum(axis=1)
    n, m = np.moveaxis(triangle_normals(x, new.reshape(-1, 3)).reshape(-1, 2, 3), 1, 0)
    forward = (np.sum(before * n, axis=1) > 0) & (np.sum(before * m, axis=1) > 0)
    return np.asarray(forward & (np.sum(n * m, axis=1) > 0.5))


def _smooth(x: Points, t: Indices, guide: Guide, *, rounds: int = 4) -> Points:
    """Move the vertices to the middle of their neighbours, and back onto the given surface."""
    edges, n = find_edges(t), len(x)
    rim = edges.on_rim(n)
    both_ways = np.vstack([edges.ends, edges.ends[:, ::-1]])
    weight = np.tile(edges.sides[:, 1] < 0, 2) | ~rim[both_ways[:, 0]]
    M = scipy.sparse.coo_matrix((weight.astype(float), tuple(both_ways.T)), shape=(n, n)).tocsr()
    M = scipy.sparse.diags(1 / np.asarray(M.sum(axis=1)).ravel()) @ M
    for _ in range(rounds):
        step, normal = M @ x - x, vertex_normals(x, t)
        y = x + step - np.sum(step * normal, axis=1, keepdims=True) * normal
        x = x + step
        x[~rim] = guide.project(y[~rim])
        x[rim] = guide.project_on_rim(x[rim])
    return x
