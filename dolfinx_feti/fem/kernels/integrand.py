# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""UFL's integrands at a quadrature point as C, for as many cells at once as V has lanes.

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

__all__ = ["VALUE", "Point", "Slot", "State", "UnsupportedError", "scalar_element"]

#: The direction of a slot without derivative.
VALUE = -1

#: UFL's functions in C.
FUNCTIONS = {
    name: name for name in "sqrt exp cos sin tan cosh sinh tanh acos asin atan erf".split()
}
FUNCTIONS["ln"] = "log"

#: Powers up to this one are products.
POWER = 4

_COMPARISONS = {
    classes.LT: "<",
    classes.GT: ">",
    classes.LE: "<=",
    classes.GE: ">=",
    classes.EQ: "==",
    classes.NE: "!=",
}


class UnsupportedError(Exception):
    """An integrand has what only FFCx can compile."""


@dataclass(frozen=True, slots=True)
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
        return f"phi{e}[q][{node}]" if d == VALUE else f"B{e}[q][{node}][{d}]"


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
    """The statements of all integrands at a point of one quadrature rule.

    Attributes:
        statements: In C, in their order.
        factors: Name of each factor.
        slots: All slots of arguments and coefficients.
    """

    def __init__(self, state: State) -> None:
        """Begin with nothing.

        Args:
            state: What the integrands are written in.
        """
        self._state = state
        self._names: dict[Expr, tuple[str, str]] = {}
        self.statements: list[str] = []
        self.factors: list[str] = []
        self.slots: set[Slot] = set()

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
        needed = [False] * len(nodes)
        for _, i in targets:
            needed[i] = True
        for i in reversed(range(len(nodes))):
            if needed[i]:
                for operand in _operands(nodes[i]):
                    needed[graph.e2i[operand]] = True
        for node, needs in zip(nodes, needed, strict=True):
            if needs and node not in self._names:
                operands = [self._names[operand] for operand in _operands(node)]
                self._names[node] = self._name(node, operands)
        found = {}
        for arguments, i in targets:
            slots = tuple(self._slot(analyse_modified_terminal(nodes[a])) for a in arguments)
            if not isinstance(nodes[i], classes.Zero):
                found[slots] = len(self.factors)
                self.factors.append(self._names[nodes[i]][0])
        return found

    def _slot(self, terminal: ModifiedTerminal) -> Slot:
        slot = self._state.slot(terminal)
        self.slots.add(slot)
        return slot

    def _name(self, node: Expr, operands: Sequence[tuple[str, str]]) -> tuple[str, str]:
        """Return name and type of a node, after its statement if it needs one."""
        if is_modified_terminal(node):
            return self._terminal(node)
        kind = "V" if any(kind == "V" for _, kind in operands) else "double"
        if isinstance(node, classes.Condition):
            kind = "L"
        elif isinstance(node, (classes.Conditional, classes.MaxValue, classes.MinValue)):
            kind = "V"
        code = _operation(node, [name for name, _ in operands], kind)
        return self._state_that(f"const {kind} {{0}} = {code};"), kind

    def _state_that(self, statement: str) -> str:
        """Add the statement of a new name; return the name."""
        name = f"t{len(self.statements)}"
        self.statements.append(statement.format(name))
        return name

    def _terminal(self, node: Expr) -> tuple[str, str]:
        """Return name and type of a number, or of what a cell gathers."""
        if isinstance(node, (classes.ScalarValue, classes.Zero)):
            if not np.isfinite(float(node)):
                raise UnsupportedError(f"the number {node}")
            return repr(float(node)), "double"
        terminal = analyse_modified_terminal(node)
        known, component = terminal.terminal, terminal.flat_component
        if isinstance(known, classes.QuadratureWeight):
            return "weight[q]", "double"
        if isinstance(known, classes.JacobianDeterminant):
            return "det", "V"
        if isinstance(known, dolfinx.fem.Constant):
            place = _place(self._state.constants, known)
            first = sum(int(np.prod(c.ufl_shape)) for c in self._state.constants[:place])
            return f"c[{first + component}]", "double"
        if isinstance(known, classes.SpatialCoordinate):
            n, values, basis = "NODES", f"X[n * GDIM + {component}]", "psi[q][n]"
        elif isinstance(known, dolfinx.fem.Function):
            slot = self._slot(terminal)
            place = _place(self._state.functions, known)
            n, basis = f"N{slot.element}", slot.basis("n")
            values = f"W[{place}][n * {slot.block} + {component}]"
        else:
            raise UnsupportedError
        total = f"V {{0}} = {{{{0.0}}}}; for (int n = 0; n < {n}; ++n) {{0}} += {values} * {basis};"
        return self._state_that(total), "V"


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


def _operation(node: Expr, a: Sequence[str], kind: str) -> str:
    """Return an operation on its operands a, with a V for its result, a double, or a mask L."""
    wide = [f"BROADCAST({name})" for name in a]
    call = "v_" if kind == "V" else ""
    match node:
        case classes.Sum():
            return " + ".join(a)
        case classes.Product():
            return " * ".join(a)
        case classes.Division():
            return " / ".join(a)
        case classes.Power():
            exponent = node.ufl_operands[1]
            if isinstance(exponent, classes.ScalarValue):
                n = abs(float(exponent))
                if n in range(1, POWER + 1):
                    product = " * ".join([a[0]] * int(n))
                    return product if float(exponent) > 0.0 else f"1.0 / ({product})"
            return f"{call}pow({', '.join(wide if kind == 'V' else a)})"
        case classes.MathFunction() if node._name in FUNCTIONS:
            return f"{call}{FUNCTIONS[node._name]}({a[0]})"
        case classes.Abs():
            return f"{call}fabs({a[0]})"
        case classes.BinaryCondition() if type(node) in _COMPARISONS:
            return f"{wide[0]} {_COMPARISONS[type(node)]} {wide[1]}"
        case classes.AndCondition():
            return " & ".join(a)
        case classes.OrCondition():
            return " | ".join(a)
        case classes.NotCondition():
            return f"~{a[0]}"
        case classes.Conditional():
            return f"choose({a[0]}, {wide[1]}, {wide[2]})"
        case classes.MaxValue():
            return f"choose({wide[0]} > {wide[1]}, {wide[0]}, {wide[1]})"
        case classes.MinValue():
            return f"choose({wide[0]} < {wide[1]}, {wide[0]}, {wide[1]})"
    raise UnsupportedError
