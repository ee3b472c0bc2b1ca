# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""UFL's integrands at a quadrature point as values of a tape.

An integrand is linear in each argument. With the slots of an argument, its components and their
derivatives :math:`v_s ∈ \{v_i, ∂_J v_i\}`, it is

.. math:: \sum_{s t} A_{st}\, v_s u_t, \qquad \sum_s P_s v_s, \qquad Ψ

for a tangent, a residual and an energy. FFCx's analysis expands it into scalar operations and finds
the factors A, P, Ψ, which know of the state alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

import basix
import basix.ufl
import dolfinx
import ufl
from ffcx.ir.analysis.factorization import compute_argument_factorization
from ffcx.ir.analysis.graph import build_scalar_graph
from ffcx.ir.analysis.modified_terminals import (
    ModifiedTerminal,
    analyse_modified_terminal,
    is_modified_terminal,
)
from ufl import classes
from ufl.algorithms.map_integrands import map_integrand_dags
from ufl.core.expr import Expr
from ufl.corealg.multifunction import MultiFunction

from dolfinx_feti.fem.kernels.tape import FUNCTIONS, Tape

#: Powers up to this one are products.
POWER = 4


class Slot(NamedTuple):
    """A component of a function, or its derivative in a direction from 1 on; 0 for the value."""

    element: int  # number of the scalar element
    block: int  # components that share it
    component: int
    direction: int


#: The factors of an integrand, as references to values, under the slots of its arguments.
Factors = dict[tuple[Slot, ...], int]


class Point:
    """The values of all integrands at a point of one quadrature rule.

    Attributes:
        tape: How they are computed.
        elements: Scalar elements, that of the geometry first.
        gradients: Numbers of those whose functions have gradients.
        terms: Numbers of forms, and the factors of an integrand of each.
    """

    def __init__(
        self,
        mesh: dolfinx.mesh.Mesh,
        functions: Sequence[dolfinx.fem.Function],
        constants: Sequence[dolfinx.fem.Constant],
    ) -> None:
        """Begin with the geometry of a mesh, and all coefficients and constants."""
        self.tape = Tape()
        coordinate = mesh.ufl_domain().ufl_coordinate_element()
        self.elements: list[basix.ufl._ElementBase] = [coordinate.sub_elements[0]]
        self.gradients: set[int] = set()
        self.terms: list[tuple[int, Factors]] = []
        self._functions = functions
        self._constants = constants
        self._known: dict[Expr, int] = {}

    def add(self, form: int, integrand: Expr, rank: int) -> None:
        """Add an integrand without compound operators, of the form with this number and rank.

        Raises a NotImplementedError if there is something in it that only FFCx can compile.
        """
        scalars = build_scalar_graph(map_integrand_dags(_Frame(), integrand))
        graph = compute_argument_factorization(scalars, rank)
        nodes = [node["expression"] for node in graph.nodes.values()]
        factors = {
            tuple(self._slot(analyse_modified_terminal(nodes[a])) for a in arguments): nodes[i]
            for i, node in graph.nodes.items()
            for arguments in node.get("target", ())
            if not isinstance(nodes[i], classes.Zero)
        }
        self._evaluate(nodes, factors.values())
        found = {s: self.tape.positive(self._known[node]) for s, node in sorted(factors.items())}
        self.terms.append((form, found))

    def _slot(self, terminal: ModifiedTerminal) -> Slot:
        """Return the slot of a coefficient or an argument."""
        element, block = scalar_element(terminal.terminal)
        if len(terminal.local_derivatives) > 1 or terminal.averaged or terminal.restriction:
            raise NotImplementedError
        e, direction = place(self.elements, element), 0
        if terminal.local_derivatives:
            direction = 1 + terminal.local_derivatives[0]
            self.gradients.add(e)
        return Slot(e, block, terminal.flat_component, direction)

    def _evaluate(self, nodes: Sequence[Expr], wanted: Iterable[Expr]) -> None:
        """Find the values of those nodes that are wanted; each comes after its operands."""
        needed = set(wanted)
        for node in reversed(nodes):
            if node in needed:
                needed.update(_operands(node))
        for node in nodes:
            if node in needed and node not in self._known:
                self._known[node] = self._value(node)

    def _value(self, node: Expr) -> int:
        """Return a terminal, or an operation on its operands a."""
        if is_modified_terminal(node):
            return self._terminal(node)
        tape, a = self.tape, [self._known[operand] for operand in node.ufl_operands]
        name = {"ln": "log"}.get(node._ufl_handler_name_, node._ufl_handler_name_)
        match name:
            case "sum":
                return tape.add(*a)
            case "product":
                return tape.multiply(*a)
            case "division":
                return tape.divide(*a)
            case "conditional":
                return tape.choose(*a)
            case "max_value" | "min_value":
                return tape.choose(tape.value("gt" if name == "max_value" else "lt", *a), *a)
            case "power" if isinstance(node.ufl_operands[1], classes.ScalarValue):
                n = float(node.ufl_operands[1])
                if abs(n) in range(1, POWER + 1):
                    product = tape.power(a[0], int(abs(n)))
                    return product if n > 0.0 else tape.divide(tape.number(1.0), product)
        if name in FUNCTIONS:
            return tape.value("function", *a, integers=[FUNCTIONS.index(name)])
        return tape.value(name, *a)

    def _terminal(self, node: Expr) -> int:
        """Return a number, or what a cell gathers."""
        if isinstance(node, (classes.ScalarValue, classes.Zero)):
            return self.tape.number(float(node))
        terminal = analyse_modified_terminal(node)
        known, component = terminal.terminal, terminal.flat_component
        match known:
            case classes.QuadratureWeight():
                return self.tape.value("weight")
            case classes.JacobianDeterminant():
                return self.tape.value("determinant")
            case classes.SpatialCoordinate():
                return self._interpolate(0, Slot(0, 3, component, 0))
            case dolfinx.fem.Constant():
                before = self._constants[: self._constants.index(known)]
                first = sum(int(np.prod(c.ufl_shape)) for c in before)
                return self.tape.value("constant", integers=[first + component])
            case dolfinx.fem.Function():
                return self._interpolate(1 + self._functions.index(known), self._slot(terminal))
        raise NotImplementedError

    def _interpolate(self, function: int, slot: Slot) -> int:
        e, block, component, direction = slot
        integers = [function, component, block, e, direction, self.elements[e].dim]
        return self.tape.value("interpolate", integers=integers)


def scalar_element(f: ufl.Argument | dolfinx.fem.Function) -> tuple[basix.ufl._ElementBase, int]:
    """Return the scalar element of a function and the number of components that share it.

    Raises:
        NotImplementedError: Its values are no combinations of nodal ones.
    """
    V, element = f.ufl_function_space(), f.ufl_element()
    block = element.block_size
    scalar = element.sub_elements[0] if element.sub_elements else element
    if (
        not isinstance(V, dolfinx.fem.FunctionSpace)
        or scalar.has_custom_quadrature  # a function of quadrature points
        or scalar.map_type != basix.MapType.identity
        or scalar.polyset_type != basix.PolysetType.standard
        or scalar.reference_value_size != 1
        or element.reference_value_size != block
        or int(np.prod(V.value_shape)) != block  # a symmetric tensor
        or V.element.needs_dof_transformations
    ):
        raise NotImplementedError
    return scalar, block


class _Frame(MultiFunction):
    """Let the cell's frame of reference be the physical one, which FFCx's analysis expects."""

    expr = MultiFunction.reuse_if_untouched

    def form_argument(self, o: Expr) -> Expr:
        """f, of which an identity maps the values."""
        return classes.ReferenceValue(o)

    def grad(self, o: Expr, f: Expr) -> Expr:
        """∂f/∂X."""
        return classes.ReferenceGrad(f)


def _operands(node: Expr) -> tuple[Expr, ...]:
    return () if is_modified_terminal(node) else node.ufl_operands


def place(things: list[Any], thing: object) -> int:
    """Return the place of a thing, the last one if it is new."""
    if thing not in things:
        things.append(thing)
    return things.index(thing)
