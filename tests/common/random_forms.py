# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Random forms from a seeded grammar: bodies, unknowns, coefficients, expressions, measures.

A seed determines a form, which is the same on any number of processes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
from collective import COMM

import basix
import basix.ufl
import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.fem.quadrature import limit_quadrature_degree
from dolfinx_feti.meshes.curved import create_curved_mesh

Cell = dolfinx.mesh.CellType
CELLS = ("interval", "triangle", "quadrilateral", "tetrahedron", "hexahedron", "prism")
SIMPLICES = ("triangle", "tetrahedron")
element = basix.ufl.element


@cache
def body(cell: str, is_curved: bool) -> tuple[dolfinx.mesh.Mesh, object, object, list]:
    """Return a mesh of a few cells, tags of its cells and facets, and a list (number, cells)."""
    kind = getattr(Cell, cell)
    if cell == "interval":
        mesh = dolfinx.mesh.create_interval(COMM, 7, [0.0, 1.3])
    elif cell in ("triangle", "quadrilateral"):
        mesh = dolfinx.mesh.create_rectangle(COMM, [[0, 0], [1.2, 0.9]], [3, 2], kind)
    else:
        mesh = dolfinx.mesh.create_box(COMM, [[0, 0, 0], [1.1, 0.8, 0.9]], (2, 2, 1), kind)
    if is_curved:
        mesh = bent(mesh)
    mesh.geometry.x[:, 0] += 0.06 * np.sin(3 * mesh.geometry.x[:, 1] + mesh.geometry.x[:, 2])
    tdim = mesh.topology.dim
    mesh.topology.create_connectivity(tdim - 1, tdim)
    tags: list[object] = []
    for dim in (tdim,) if cell == "prism" else (tdim, tdim - 1):  # its facets are of two types
        m = mesh.topology.index_map(dim)
        entities = np.arange(m.size_local + m.num_ghosts, dtype=np.int32)
        number = 1 + (m.local_to_global(entities) % 7 % 3).astype(np.int32)
        tags.append(dolfinx.mesh.meshtags(mesh, dim, entities, number))
    cells = np.arange(mesh.topology.index_map(tdim).size_local, dtype=np.int32)
    return mesh, tags[0], tags[-1], [(1, cells[::2]), (2, cells[1:3]), (3, cells[:0])]


def bent(mesh: dolfinx.mesh.Mesh) -> dolfinx.mesh.Mesh:
    """Return a mesh with the same cells and quadratic geometry."""
    return create_curved_mesh(
        mesh, lambda x: x + 0.1 * np.outer(x[:, -1] ** 2, np.eye(x.shape[1])[0])
    )


class Grammar:
    """Draws a form of rank 0, 1 or 2 with arguments in V; ``text`` lists its random choices."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        cell = self.one(CELLS)
        is_curved = self.chance(0.25)
        is_curved = is_curved and cell != "prism" and COMM.size == 1
        self.mesh, *self.data = body(cell, is_curved)
        self.cell = cell
        self.gdim = self.mesh.geometry.dim
        self.text = [f"seed {seed}", f"curved {cell}" if is_curved else cell]
        self.degree: int | None = None  # of quadrature elements
        self.V = dolfinx.fem.functionspace(self.mesh, self.unknown())
        rank = int(self.rng.integers(3))
        self.has_lists = self.chance(0.3)  # of cells in its measures, in place of tags
        # dolfinx 0.9 loses integrals over a number that is in a tuple, too
        self.numbers = self.one([[1, 2, 3, 7], [(1, 2), 3], [(2, 3), 1], [(1, 2, 3)]])
        # UFL's estimate may need a hundred thousand points
        self.form = limit_quadrature_degree(self.draw(rank), 6)

    # -- choices ----------------------------------------------------------------------------------

    def one(self, choices: Sequence):
        return choices[int(self.rng.integers(len(choices)))]

    def chance(self, p: float) -> bool:
        return bool(self.rng.random() < p)

    def drawn(self, kinds: Sequence) -> object:
        """An element by family, degree, shape and symmetry, or what a call returns."""
        kind = self.one(kinds)
        if callable(kind):
            return kind()
        family, degree, shape, symmetry = (*kind, None, None)[:4]
        return element(family, self.cell, degree, shape=shape, symmetry=symmetry)

    def unknown(self) -> object:
        cell = self.cell
        g = self.gdim
        kinds: list = [("Lagrange", 1), ("Lagrange", 2), ("Lagrange", 1, (g,))]
        kinds += [("Lagrange", 2 if g < 3 else 1, (g,)), ("Lagrange", 1, (2,))]
        if cell != "prism":
            kinds += [("Lagrange", 3 if g < 3 else 2), ("Lagrange", 1, (g, g), g > 1)]
        if cell in SIMPLICES:
            kinds.append(self.with_bubbles)
        return self.drawn(kinds)

    def with_bubbles(self) -> object:
        parts = [element("Lagrange", self.cell, 1), element("Bubble", self.cell, self.gdim + 1)]
        return basix.ufl.blocked_element(basix.ufl.enriched_element(parts), shape=(self.gdim,))

    def element(self) -> object:
        """The element of a coefficient."""
        cell = self.cell
        g = self.gdim
        k = int(self.rng.integers(1, 3))
        variant = basix.LagrangeVariant.legendre
        kinds: list = [("Lagrange", k), ("Lagrange", k, (g,)), ("Lagrange", 1, (g, g))]
        kinds += [("DG", 0), ("DG", k, (2,)), ("DG", 0, (g, g))]
        kinds.append(lambda: element("Lagrange", cell, k, variant, discontinuous=True))
        kinds.append(self.quadrature)
        if g > 1:
            kinds += [("Lagrange", 1, (g, g), True), ("DG", 0, (g, g), True)]
        if cell in SIMPLICES:
            kinds += [("RT", k), ("N1curl", k), ("BDM", 1), ("CR", 1), ("Lagrange", 3)]
            kinds += [("iso", 4 - g), ("Regge", 1), self.with_bubbles]
        if cell in ("quadrilateral", "hexahedron"):
            kinds += [("RTCF" if g == 2 else "NCF", 1), ("RTCE" if g == 2 else "NCE", 1)]
            kinds += [("DPC", 1), ("S", 2)]
        return self.drawn(kinds)

    def quadrature(self) -> object:
        self.degree = self.degree or int(self.rng.integers(1, 4))
        shape = self.one([(), (self.gdim,), (self.gdim, self.gdim)])
        return basix.ufl.quadrature_element(self.cell, shape, degree=self.degree)

    def mixed(self) -> object:
        cell = self.cell
        g = self.gdim
        shape = (g,) if g > 1 else (2,)  # FFCx does not know a vector of one in a mixed element
        vector = element("Lagrange", cell, int(self.rng.integers(1, 3)), shape=shape)
        parts = [vector, element("Lagrange", cell, 1)]
        if self.chance(0.3):
            parts.append(element("DG", cell, 0, shape=(2,)))
        if self.chance(0.3):
            parts[1] = basix.ufl.mixed_element([parts[1], element("DG", cell, 0)])
        if cell in SIMPLICES and self.chance(0.3):
            parts[0] = element("RT", cell, 1)
        return basix.ufl.mixed_element(parts)

    def function(self, e: object) -> dolfinx.fem.Function:
        """A Function whose values depend on the global numbers of its dofs."""
        f = dolfinx.fem.Function(dolfinx.fem.functionspace(self.mesh, e))
        dofmap = f.function_space.dofmap
        bs = dofmap.index_map_bs
        m = dofmap.index_map
        blocks = m.local_to_global(np.arange(m.size_local + m.num_ghosts, dtype=np.int32))
        dofs = (blocks[:, None] * bs + np.arange(bs)).ravel()
        f.x.array[:] = 0.3 + 0.5 * np.sin(1.7 * dofs + self.rng.random())
        return f

    # -- expressions ------------------------------------------------------------------------------

    def coefficient(self) -> tuple[Expr, bool]:
        """An expression of any shape, and whether it has a gradient."""
        kind = self.one(["plain"] * 5 + ["split", "sub", "collapsed", "component", "constant", "x"])
        self.text.append(kind)
        if kind == "x":
            return ufl.SpatialCoordinate(self.mesh), False
        if kind == "constant":
            shape = self.one([(), (self.gdim,), (2, 2), (3,)])
            return dolfinx.fem.Constant(self.mesh, self.rng.random(shape) + 0.2), False
        if kind == "component":
            f = self.function(element("Lagrange", self.cell, 1, shape=(3,)))
            return f.sub(int(self.rng.integers(3))), True
        if kind == "plain":
            e = self.element()
            self.text.append(str(e))
            return self.function(e), not e.has_custom_quadrature
        w = self.function(self.mixed())
        parts = w.function_space.num_sub_spaces
        i = int(self.rng.integers(parts))
        self.text.append(f"{w.function_space.ufl_element()}[{i}]")
        if kind == "split":
            return ufl.split(w)[i], True
        if kind == "collapsed":
            return w.sub(i).collapse(), True
        return w.sub(i), True

    def component(self, f: Expr) -> Expr:
        """A scalar of a tensor of any rank."""
        return f[tuple(int(self.rng.integers(n)) for n in f.ufl_shape)] if f.ufl_shape else f

    def atom(self) -> Expr:
        """A scalar expression of one coefficient."""
        f, smooth = self.coefficient()
        if smooth and self.chance(0.4):
            f = ufl.grad(f)
            if self.chance(0.4):
                return ufl.inner(f, f)
        if not f.ufl_shape:
            return f
        if len(set(f.ufl_shape)) == 1 and len(f.ufl_shape) == 2 and self.chance(0.4):
            return self.one([ufl.tr, ufl.det])(f) if f.ufl_shape[0] > 1 else f[0, 0]
        if self.chance(0.3):
            return ufl.inner(f, f)
        return self.component(f)

    def scalar(self, depth: int = 2) -> Expr:
        """A scalar expression."""
        if depth == 0 or self.chance(0.25):
            return self.atom()
        a = self.scalar(depth - 1)
        a = a / ufl.sqrt(4 + a**2) if self.chance(0.8) else a  # large arguments magnify rounding
        unary: list[Callable[[Expr], Expr]] = [
            lambda a: ufl.exp(-(a**2) / 9),
            lambda a: ufl.sqrt(1 + a**2),
            lambda a: ufl.ln(2 + a**2),
            lambda a: ufl.sin(a / (1 + a**2)),
            ufl.tanh,
            ufl.atan,
            ufl.erf,
            abs,
            ufl.sign,
            lambda a: (1 + a**2) ** -1.5,
            lambda a: a**3,
            lambda a: 1 / (2 + a**2),
            lambda a: ufl.bessel_J(1, a) if self.chance(0.2) else ufl.cosh(ufl.sin(a)),
            lambda a: ufl.diff(v**2 * ufl.atan(v), v) if (v := ufl.variable(a)) is not None else a,
        ]
        if self.chance(0.5):
            return self.one(unary)(a)
        b = self.scalar(depth - 1)
        binary: list[Callable[[Expr, Expr], Expr]] = [
            lambda a, b: a + b,
            lambda a, b: a * b,
            lambda a, b: a - 2 * b,
            lambda a, b: a / (1.5 + b**2),
            ufl.max_value,
            ufl.min_value,
            lambda a, b: ufl.conditional(ufl.And(ufl.lt(a, b), ufl.gt(a, -0.2)), a, b * b),
            lambda a, b: ufl.conditional(ufl.Or(ufl.ge(a, 0.3), ufl.Not(ufl.le(b, a))), 1.0, b),
            lambda a, b: ufl.atan2(a, 2 + b**2) if self.chance(0.3) else a * b**2,
        ]
        return self.one(binary)(a, b)

    def matrix(self) -> Expr:
        """A tensor, (gdim, gdim)."""
        g = self.gdim
        rows = [[self.atom() if i <= j else float(i) for j in range(g)] for i in range(g)]
        return ufl.as_matrix(rows)

    # -- forms ------------------------------------------------------------------------------------

    def measure(self, *, cells_only: bool = False) -> ufl.Measure:
        """A measure over cells or facets."""
        facets = not cells_only and self.cell != "prism" and self.chance(0.25)
        cell_tags, facet_tags, cell_list = self.data
        metadata: dict[str, object] = {}
        if self.degree is not None:
            metadata["quadrature_degree"] = self.degree
        elif self.chance(0.6):
            metadata["quadrature_degree"] = self.one([1, 2, 3, 4, np.int64(2), np.int32(3)])
        elif self.chance(0.1) and self.cell not in ("interval", "prism"):
            metadata["quadrature_rule"] = "vertex"
        data = cell_list if self.has_lists else cell_tags
        if facets:
            data = facet_tags
        number = None
        if self.chance(0.4):
            number = self.one(self.numbers)
        self.text.append(f"{'ds' if facets else 'dx'}({number}) {metadata}")
        kind = "ds" if facets else "dx"
        dx = ufl.Measure(kind, self.mesh, subdomain_data=data, metadata=metadata)
        return dx if number is None else dx(number)

    def draw(self, rank: int) -> ufl.Form:
        """A form of this rank: a sum of one to three terms, or the derivative of an energy."""
        terms = int(self.rng.integers(1, 4))
        v = ufl.TestFunction(self.V)
        u = ufl.TrialFunction(self.V)
        if rank and self.chance(0.25):
            return self.derived(rank, v, u)
        integrands = [self.term(rank, v, u) for _ in range(terms)]  # all, before self.degree counts
        cells_only = self.degree is not None
        return sum((c * self.measure(cells_only=cells_only) for c in integrands), ufl.Form([]))

    def derived(self, rank: int, v: ufl.Argument, u: ufl.Argument) -> ufl.Form:
        """The derivative of an energy."""
        self.text.append("derived")
        w = dolfinx.fem.Function(self.V, self.function(self.V.ufl_element()).x)
        s = ufl.inner(ufl.grad(w), ufl.grad(w)) + self.scalar(1) * ufl.inner(w, w)
        energy = self.one([lambda s: ufl.ln(2 + s**2), lambda s: s**2, lambda s: ufl.sqrt(1 + s)])(
            s if self.chance(0.5) else s * s / 4 + 1
        )
        energy = energy * self.measure(cells_only=self.degree is not None)
        F = ufl.derivative(energy, w, v)
        return F if rank == 1 else ufl.derivative(F, w, u)

    def term(self, rank: int, v: ufl.Argument, u: ufl.Argument) -> Expr:
        c = self.scalar()
        if rank == 0:
            return c
        first = self.component(v)
        if rank == 1:
            return c * self.one([first, first.dx(int(self.rng.integers(self.gdim)))])
        second = self.component(u)
        j = int(self.rng.integers(self.gdim))
        choices = [
            lambda: c * ufl.inner(u, v),
            lambda: c * ufl.inner(ufl.grad(u), ufl.grad(v)),
            lambda: ufl.inner(ufl.grad(second), self.matrix() * ufl.grad(first)),
            lambda: c * second.dx(j) * first,
            lambda: c * first.dx(j) * second,
        ]
        if self.V.value_shape == (self.gdim,):
            choices += [
                lambda: c * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(v)) + ufl.div(u) * ufl.div(v),
                lambda: ufl.inner(
                    self.matrix() * ufl.grad(u), ufl.grad(v) + self.matrix() * ufl.grad(v)
                ),
            ]
        if self.V.ufl_element().embedded_superdegree > 1:
            choices.append(lambda: c * ufl.div(ufl.grad(second)) * first)
        return self.one(choices)()
