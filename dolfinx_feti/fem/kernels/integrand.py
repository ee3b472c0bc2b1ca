# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""UFL's integrands at a quadrature point as values of a tape.

An integrand is linear in each argument. With the slots of an argument, its components and their
derivatives :math:`v_s ∈ \{v_i, ∂_J v_i\}`, it is

.. math:: \sum_{s t} A_{st}\, v_s u_t, \qquad \sum_s P_s v_s, \qquad Ψ

for a tangent, a residual and an energy. FFCx's analysis expands it into scalar operations and finds
the factors A, P, Ψ, which know of the state alone; here they become one statement for each
operation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

import basix
import basix.ufl
import dolfinx
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

__all__ = ["VALUE", "Input", "Point", "Slot", "State", "UnsupportedError", "scalar_element"]

#: The direction of a slot without derivative.
VALUE = -1

#: Powers up to this one are products.
POWER = 4

#: Instructions for UFL's conditions.
_CONDITIONS = {
    classes.LT: "lt",
    classes.GT: "gt",
    classes.LE: "le",
    classes.GE: "ge",
    classes.EQ: "eq",
    classes.NE: "ne",
    classes.AndCondition: "and",
    classes.OrCondition: "or",
    classes.NotCondition: "not",
}


#: Instructions for UFL's functions.
_VECTORISED = {"sqrt": "sqrt", "exp": "exp", "ln": "log"}


class UnsupportedError(Exception):
    """An integrand has what only FFCx can compile."""


class Input(IntEnum):
    """What a tape reads at a point: w, det ∂x/∂ξ, x, a coefficient, and its gradient."""

    WEIGHT, DETERMINANT, COORDINATE, COEFFICIENT, GRADIENT = range(5)


@dataclass(frozen=True, slots=True, order=True)
class Slot:
    """A component of a function, or its derivative.

    Attributes:
        element: Number of the scalar element.
        block: Components that share it.
        component: The component.
        direction: Direction of the derivative, or ``VALUE``.
    """

    element: int
    block: int
    component: int
    direction: int

    def basis(self, node: str) -> str:
        """Return the basis function of a node, in C; a double for a value, else V."""
        e, d = self.element, self.direction
        return f"phi{e}[q][{node}]" if d == VALUE else f"B{e}[{node}][{d}][q]"


class State:
    """What integrands are written in; it is gathered for each cell.

    Attributes:
        elements: Scalar elements of all functions.
        functions: Coefficients.
        constants: Constants.
    """

    def __init__(self) -> None:
        """Begin with nothing."""
        self.elements: list[basix.ufl._ElementBase] = []
        self.functions: list[dolfinx.fem.Function] = []
        self.constants: list[dolfinx.fem.Constant] = []

    def slot(self, terminal: ModifiedTerminal) -> Slot:
        """Return the slot of a coefficient or an argument."""
        element, block = scalar_element(terminal.terminal.ufl_function_space())
        if len(terminal.local_derivatives) > 1 or terminal.averaged or terminal.restriction:
            raise UnsupportedError
        direction = next(iter(terminal.local_derivatives), VALUE)
        return Slot(_place(self.elements, element), block, terminal.flat_component, direction)


class Point:
    """The values of all integrands at a point of one quadrature rule.

    Attributes:
        tape: How they are computed.
        factors: The factors, as references to its values.
        slots: All slots of arguments and coefficients.
        inputs: What the tape reads, each with the number of its coefficient, or 0.
    """

    def __init__(self, state: State) -> None:
        """Begin with nothing.

        Args:
            state: What the integrands are written in.
        """
        self._state = state
        self._known: dict[Expr, int] = {}
        self.tape = Tape()
        self.factors: list[int] = []
        self.slots: set[Slot] = set()
        self.inputs: set[tuple[Input, int]] = set()

    @property
    def values(self) -> set[int]:
        """Elements whose functions have values here."""
        return {slot.element for slot in self.slots if slot.direction == VALUE}

    @property
    def gradients(self) -> set[int]:
        """Elements whose functions have gradients here."""
        return {slot.element for slot in self.slots if slot.direction != VALUE}

    def add(self, integrand: Expr, rank: int) -> dict[tuple[Slot, ...], int]:
        """Add an integrand.

        Args:
            integrand: Of a cell, without compound operators.
            rank: Number of its arguments.

        Returns:
            Number of the factor of each combination of slots.

        Raises:
            UnsupportedError: There is something in it that only FFCx can compile.
        """
        scalars = build_scalar_graph(map_integrand_dags(_Frame(), integrand))
        graph = compute_argument_factorization(scalars, rank)
        nodes = [node["expression"] for node in graph.nodes.values()]
        targets = [(k, i) for i, node in graph.nodes.items() for k in node.get("target", ())]
        needed = {nodes[i] for _, i in targets}
        for node in reversed(nodes):
            if node in needed:
                needed.update(_operands(node))
        for node in nodes:
            if node in needed and node not in self._known:
                operands = [self._known[operand] for operand in _operands(node)]
                self._known[node] = self._value(node, operands)
        factors = {
            tuple(self._slot(analyse_modified_terminal(nodes[a])) for a in arguments): nodes[i]
            for arguments, i in targets
        }
        found: dict[tuple[Slot, ...], int] = {}
        for slots in sorted(factors):  # the order of a material's terms makes no other code
            if isinstance(factors[slots], classes.Zero):
                continue
            factor, mirrored = self._known[factors[slots]], found.get(slots[::-1])
            if mirrored is not None and self.factors[mirrored] == factor:
                found[slots] = mirrored
            else:
                found[slots] = len(self.factors)
                self.factors.append(factor)
        return found

    def _slot(self, terminal: ModifiedTerminal) -> Slot:
        slot = self._state.slot(terminal)
        self.slots.add(slot)
        return slot

    def _value(self, node: Expr, a: Sequence[int]) -> int:
        """Return an operation on its operands a."""
        if is_modified_terminal(node):
            return self._terminal(node)
        tape = self.tape
        match node:
            case classes.Sum():
                return tape.add(*a)
            case classes.Product():
                return tape.multiply(*a)
            case classes.Division():
                return tape.divide(*a)
            case classes.Power():
                exponent = node.ufl_operands[1]
                if isinstance(exponent, classes.ScalarValue):
                    n = float(exponent)
                    if abs(n) in range(1, POWER + 1):
                        product = tape.power(a[0], int(abs(n)))
                        return product if n > 0.0 else tape.divide(tape.number(1.0), product)
                return tape.value("power", *a)
            case classes.MathFunction() if node._name in _VECTORISED:
                return tape.value(_VECTORISED[node._name], a[0])
            case classes.MathFunction() if node._name in FUNCTIONS:
                return tape.value("function", a[0], integers=[FUNCTIONS.index(node._name)])
            case classes.Abs():
                return tape.value("fabs", a[0])
            case classes.Condition() if type(node) in _CONDITIONS:
                return tape.value(_CONDITIONS[type(node)], *a)
            case classes.Conditional():
                return tape.choose(*a)
            case classes.MaxValue():
                return tape.choose(tape.value("gt", *a), *a)
            case classes.MinValue():
                return tape.choose(tape.value("lt", *a), *a)
        raise UnsupportedError

    def _terminal(self, node: Expr) -> int:
        """Return a number, or what a cell gathers."""
        value = self.tape.value
        if isinstance(node, (classes.ScalarValue, classes.Zero)):
            if not np.isfinite(float(node)):
                raise UnsupportedError(f"the number {node}")
            return self.tape.number(float(node))
        terminal = analyse_modified_terminal(node)
        known, component = terminal.terminal, terminal.flat_component
        if isinstance(known, classes.QuadratureWeight):
            return self._input(Input.WEIGHT)
        if isinstance(known, classes.JacobianDeterminant):
            return self._input(Input.DETERMINANT)
        if isinstance(known, dolfinx.fem.Constant):
            place = _place(self._state.constants, known)
            first = sum(int(np.prod(c.ufl_shape)) for c in self._state.constants[:place])
            return value("constant", integers=[first + component])
        if isinstance(known, classes.SpatialCoordinate):
            return self._input(Input.COORDINATE, component=component)
        if not isinstance(known, dolfinx.fem.Function):
            raise UnsupportedError
        slot = self._slot(terminal)
        function = _place(self._state.functions, known)
        if slot.direction == VALUE:
            return self._input(Input.COEFFICIENT, function, component)
        return self._input(Input.GRADIENT, function, component, slot.direction)

    def _input(self, kind: Input, function: int = 0, component: int = 0, direction: int = 0) -> int:
        self.inputs.add((kind, function))
        return self.tape.value("input", integers=[kind, function, component, direction])


def scalar_element(V: dolfinx.fem.FunctionSpace) -> tuple[basix.ufl._ElementBase, int]:
    """Return the scalar element of a space and the number of components that share it.

    Raises:
        UnsupportedError: The values of its functions are no combinations of nodal ones.
    """
    element = V.ufl_element()
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
        raise UnsupportedError
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


def _place(things: list[Any], thing: object) -> int:
    """Return the place of a thing, the last one if it is new."""
    if thing not in things:
        things.append(thing)
    return things.index(thing)


def _operands(node: Expr) -> tuple[Expr, ...]:
    return () if is_modified_terminal(node) else node.ufl_operands
