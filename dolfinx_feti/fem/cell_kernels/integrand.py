# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""UFL's integrands at a quadrature point as values of a tape.

An integrand is linear in each of its arguments. A *slot* of an argument is a component or one of
its derivatives, :math:`v_s ∈ \{v_i, ∂_J v_i\}`, with a derivative J along an axis of space. The
integrand is

.. math:: \sum_{s t} A_{st}\, v_s u_t, \qquad \sum_s P_s v_s, \qquad Ψ

for a tangent, a residual and an energy. FFCx's analysis (``ffcx.ir.analysis``, not public) expands
it into scalar operations and finds the factors A, P, Ψ, which depend on the state alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

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

from dolfinx_feti.fem.cell_kernels.tape import (
    FUNCTIONS,
    INSTRUCTIONS,
    Tape,
    UnsupportedIntegrandError,
)

#: Powers with a whole exponent up to this one are products, which are cheaper than C's ``pow`` and
#: of which the tape finds equal ones. Materials have up to fourth powers of J and invariants.
MAX_PRODUCT_POWER = 4

#: Number of coordinates of a node: dolfinx stores three, also for a mesh in the plane.
GEOMETRY_COMPONENTS = 3


class Slot(NamedTuple):
    """A component of a function, or a derivative of it.

    Attributes:
        element: Index of the scalar element in ``PointIntegrands.elements``.
        components: Number of components of the function, which share the element.
        component: The component.
        direction: 0 for the value, J + 1 for ∂_J.
    """

    element: int
    components: int
    component: int
    direction: int


#: References to the factors of an integrand, by the slots of its arguments: () for an energy.
Factors = dict[tuple[Slot, ...], int]


@dataclass(frozen=True, slots=True)
class Term:
    """One integrand.

    Attributes:
        form: Index of the form that it belongs to.
        factors: References to its factors.
    """

    form: int
    factors: Factors


class PointIntegrands:
    """All integrands of one quadrature rule, as values of a tape at a point.

    Attributes:
        tape: Instructions that compute the factors of all integrands.
        elements: Scalar elements; element 0 is that of the geometry.
        with_gradients: Indices of the elements whose gradients occur.
        terms: The integrands.
    """

    def __init__(
        self,
        mesh: dolfinx.mesh.Mesh,
        functions: Sequence[dolfinx.fem.Function],
        constants: Sequence[dolfinx.fem.Constant],
    ) -> None:
        """Create a point without integrands.

        Args:
            mesh: The mesh.
            functions: Coefficients of all forms. On the tape, function 0 is the position x, and
                function i is entry i − 1 of this list.
            constants: Constants of all forms.
        """
        coordinate_element = mesh.ufl_domain().ufl_coordinate_element()
        self.tape = Tape()
        self.elements: list[basix.ufl._ElementBase] = [coordinate_element.sub_elements[0]]
        self.with_gradients: set[int] = set()
        self.terms: list[Term] = []
        self._functions = functions
        self._constants = constants
        self._reference: dict[Expr, int] = {}  # of each expression on the tape

    def add(self, form_index: int, integrand: Expr, rank: int) -> None:
        """Add an integrand.

        Args:
            form_index: Index of its form.
            integrand: Expression without compound operators, as in UFL's form data.
            rank: Number of its arguments.

        Raises:
            UnsupportedIntegrandError: Only FFCx can compile it.
        """
        # FFCx's graph: a node has an "expression" of its operands, which precede it. A node that is
        # a factor has in "target" the arguments that it multiplies, as tuples of other nodes.
        scalars = build_scalar_graph(map_integrand_dags(_PhysicalFrame(), integrand))
        graph = compute_argument_factorization(scalars, rank)
        nodes = [node["expression"] for node in graph.nodes.values()]
        expressions: dict[tuple[Slot, ...], Expr] = {}
        for i, node in graph.nodes.items():
            if isinstance(nodes[i], classes.Zero):
                continue
            for arguments in node.get("target", ()):
                slots = tuple(self._slot(analyse_modified_terminal(nodes[a])) for a in arguments)
                expressions[slots] = nodes[i]
        self._evaluate(nodes, expressions.values())
        factors = {
            slots: self.tape.positive_reference(self._reference[expression])
            for slots, expression in sorted(expressions.items())
        }
        self.terms.append(Term(form_index, factors))

    def add_element(self, element: basix.ufl._ElementBase) -> int:
        """Return the index of a scalar element in ``elements``; add the element if it is new."""
        if element not in self.elements:
            self.elements.append(element)
        return self.elements.index(element)

    def _slot(self, terminal: ModifiedTerminal) -> Slot:
        """Return the slot of a component of a coefficient or an argument, or of its derivative.

        Raises:
            UnsupportedIntegrandError: It is a second derivative, or a value on a facet.
        """
        element, components = scalar_element(terminal.terminal)
        if len(terminal.local_derivatives) > 1:
            raise UnsupportedIntegrandError(f"second derivatives of {terminal.terminal}")
        if terminal.averaged or terminal.restriction:
            raise UnsupportedIntegrandError(f"{terminal.terminal} on facets")
        index = self.add_element(element)
        direction = 0
        if terminal.local_derivatives:
            direction = 1 + terminal.local_derivatives[0]
            self.with_gradients.add(index)
        return Slot(index, components, terminal.flat_component, direction)

    def _evaluate(self, nodes: Sequence[Expr], outputs: Iterable[Expr]) -> None:
        """Write expressions on the tape, and what they depend on.

        Args:
            nodes: Scalar expressions, each after its operands.
            outputs: Those that are computed.
        """
        needed = set(outputs)
        for node in reversed(nodes):
            if node in needed:
                needed.update(_operands(node))
        for node in nodes:
            if node in needed and node not in self._reference:
                self._reference[node] = self._value(node)

    def _value(self, node: Expr) -> int:
        """Return the reference to a terminal, or to an operation on operands that are on the tape.

        Raises:
            UnsupportedIntegrandError: There is no instruction for the operation.
        """
        if is_modified_terminal(node):
            return self._terminal(node)
        tape = self.tape
        operands = [self._reference[operand] for operand in node.ufl_operands]
        name = node._ufl_handler_name_
        match name:
            case "sum":
                return tape.add(*operands)
            case "product":
                return tape.multiply(*operands)
            case "division":
                return tape.divide(*operands)
            case "conditional":
                return tape.choose(*operands)
            case "max_value":
                first_is_larger = tape.apply("gt", *operands)
                return tape.choose(first_is_larger, *operands)
            case "min_value":
                first_is_smaller = tape.apply("lt", *operands)
                return tape.choose(first_is_smaller, *operands)
            case "power":
                return self._power(operands[0], operands[1], node.ufl_operands[1])
            case "ln":
                return tape.apply("function", *operands, integers=[FUNCTIONS.index("log")])
            case _ if name in FUNCTIONS:
                return tape.apply("function", *operands, integers=[FUNCTIONS.index(name)])
            case _ if name in INSTRUCTIONS:
                return tape.apply(name, *operands)
        raise UnsupportedIntegrandError(f"operator {name}")

    def _power(self, base: int, exponent: int, exponent_node: Expr) -> int:
        """Return the reference to a power; with a small whole exponent it is a product.

        Args:
            base: Reference to the base.
            exponent: Reference to the exponent.
            exponent_node: The exponent as an expression.
        """
        tape = self.tape
        if isinstance(exponent_node, classes.ScalarValue):
            n = float(exponent_node)
            if abs(n) in range(1, MAX_PRODUCT_POWER + 1):
                product = tape.power(base, int(abs(n)))
                return product if n > 0.0 else tape.divide(tape.number(1.0), product)
        return tape.apply("power", base, exponent)

    def _terminal(self, node: Expr) -> int:
        """Return the reference to a number, or to a value of the cell at the point.

        Raises:
            UnsupportedIntegrandError: It is another value, such as the volume of the cell.
        """
        if isinstance(node, (classes.ScalarValue, classes.Zero)):
            return self.tape.number(float(node))
        modified = analyse_modified_terminal(node)
        terminal = modified.terminal
        component = modified.flat_component
        match terminal:
            case classes.QuadratureWeight():
                return self.tape.apply("weight")
            case classes.JacobianDeterminant():
                return self.tape.apply("determinant")
            case classes.SpatialCoordinate():
                return self._interpolate(0, Slot(0, GEOMETRY_COMPONENTS, component, 0))
            case dolfinx.fem.Constant():
                before = self._constants[: self._constants.index(terminal)]
                first = sum(int(np.prod(c.ufl_shape)) for c in before)
                return self.tape.apply("constant", integers=[first + component])
            case dolfinx.fem.Function():
                function = 1 + self._functions.index(terminal)
                return self._interpolate(function, self._slot(modified))
        raise UnsupportedIntegrandError(f"{type(terminal).__name__} {terminal}")

    def _interpolate(self, function: int, slot: Slot) -> int:
        """Return the reference to a component of a function, or its derivative, at the point."""
        nodes = self.elements[slot.element].dim
        integers = [function, slot.component, slot.components, slot.element, slot.direction, nodes]
        return self.tape.apply("interpolate", integers=integers)


def scalar_element(f: ufl.Argument | dolfinx.fem.Function) -> tuple[basix.ufl._ElementBase, int]:
    """Return the scalar element of a function and the number of components that share it.

    Raises:
        UnsupportedIntegrandError: Its values in a cell are no combinations of scalar basis
            functions that only the reference cell determines.
    """
    V = f.ufl_function_space()
    element = f.ufl_element()
    components = element.block_size
    scalar = element.sub_elements[0] if element.sub_elements else element
    if (
        not isinstance(V, dolfinx.fem.FunctionSpace)
        or scalar.has_custom_quadrature  # a quadrature element
        or scalar.map_type != basix.MapType.identity
        or scalar.polyset_type != basix.PolysetType.standard
        or scalar.reference_value_size != 1
        or element.reference_value_size != components
        or int(np.prod(V.value_shape)) != components  # a symmetric tensor
        or V.element.needs_dof_transformations
    ):
        raise UnsupportedIntegrandError(f"element {element}")
    return scalar, components


class _PhysicalFrame(MultiFunction):
    """Replacement of f and ∇f by reference values, as FFCx's analysis expects.

    The frame of the reference cell is the physical one here: the basis functions of ``kernel.c``
    have physical gradients, ∂φ/∂X.
    """

    expr = MultiFunction.reuse_if_untouched

    def form_argument(self, o: Expr) -> Expr:
        """Return f in the reference cell, which is f: ``scalar_element`` allows no other maps."""
        return classes.ReferenceValue(o)

    def grad(self, o: Expr, f: Expr) -> Expr:
        """Return ∂f/∂X."""
        return classes.ReferenceGrad(f)


def _operands(node: Expr) -> tuple[Expr, ...]:
    """Return the operands of an expression; none of a terminal."""
    return () if is_modified_terminal(node) else node.ufl_operands
