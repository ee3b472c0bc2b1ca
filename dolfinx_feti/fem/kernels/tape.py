# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Expressions at quadrature points as a list of instructions, which ``tape.c`` executes.

A new material is new data, for which no C compiler is called. An instruction works on eight cells
at several points, which hides the time to decode it.

Each value is computed once. Sums and products with the same operands in any order are one value, so
that the factors of a tangent are seen to be symmetric if it has a potential. A sum of products,

.. math:: \sum_k ± a_k b_k + \sum_k ± c_k,

is one instruction. A reference to a value carries its sign, so that nothing has to be negated.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import numpy as np

from dolfinx_feti.runtime.arrays import Indices
from dolfinx_feti.runtime.native import load, processor_flags

__all__ = ["FUNCTIONS", "Program", "Tape", "load_interpreter"]

#: Bytes of a vector of eight numbers.
VECTOR = 64

#: Functions of one argument that C calls number by number.
FUNCTIONS = "cos sin tan cosh sinh tanh acos asin atan erf".split()

_CODES = (
    "end store number constant input sum product quotient "
    "power fabs sqrt exp log function choose lt gt le ge eq ne and or not add subtract "
    "multiply_add multiply_subtract subtract_product product_sum product_difference"
).split()

#: Sums of two terms, by how many operands of a b, −a b, c, −c they have.
_SHORT: dict[tuple[int, ...], str] = {
    (0, 0, 2, 0): "add",
    (0, 0, 1, 1): "subtract",
    (2, 0, 1, 0): "multiply_add",
    (2, 0, 0, 1): "multiply_subtract",
    (0, 2, 1, 0): "subtract_product",
    (4, 0, 0, 0): "product_sum",
    (2, 2, 0, 0): "product_difference",
}

#: The instructions, for C.
HEADER = f"""
static Instruction {", ".join(f"do_{name}" for name in _CODES)};
static Instruction *const instructions[] = {{{", ".join(f"do_{name}" for name in _CODES)}}};
static double (*const functions[])(double) = {{{", ".join(FUNCTIONS)}}};
"""


@dataclass(frozen=True, slots=True)
class Program:
    """What ``tape.c`` executes.

    Attributes:
        code: Instructions with the places of registers, in bytes.
        vectors: Vectors of eight numbers that the registers take, one for each point.
    """

    code: Indices
    vectors: int


@dataclass(frozen=True, slots=True)
class _Value:
    """A value: an instruction, the references to its operands, and integers of other meanings."""

    name: str
    operands: tuple[int, ...]
    integers: tuple[int, ...] = ()


class Tape:
    """Values, each with a number from one on. A reference is this number, or −number for −value."""

    def __init__(self) -> None:
        """Begin with no values."""
        self._values = [_Value("end", ())]
        self._known: dict[object, int] = {}
        self._flat: dict[int, tuple[int, ...]] = {}  # operands of nested sums, or products
        self._numbers: dict[int, float] = {}

    def number(self, x: float) -> int:
        """Return a number."""
        bits = np.array([abs(x)]).view(np.int32)
        value = self.value("number", integers=[int(i) for i in bits])
        self._numbers[value] = abs(x)
        return int(math.copysign(value, x))

    def value(self, name: str, *operands: int, integers: Sequence[int] = ()) -> int:
        """Return the result of an instruction.

        Args:
            name: The instruction.
            operands: References.
            integers: What else it needs.
        """
        value = _Value(name, tuple(map(self._positive, operands)), tuple(integers))
        return self._find(value, value)

    def add(self, a: int, b: int) -> int:
        """Return a + b."""
        terms = [*self._nested("sum", a), *self._nested("sum", b)]
        terms.sort(key=_by_number)
        if terms[0] < 0:
            return -self.add(-a, -b)
        return self._commutative("sum", terms, (a, b))

    def multiply(self, a: int, b: int) -> int:
        """Return a b."""
        sign, a, b = _sign(a, b), abs(a), abs(b)
        x, y = self._numbers.get(a), self._numbers.get(b)
        if x is not None and y is not None:
            return sign * self.number(x * y)
        if 1.0 in (x, y):
            return sign * (b if x == 1.0 else a)
        factors = sorted((*self._nested("product", a), *self._nested("product", b)))
        return sign * self._commutative("product", factors, (a, b))

    def divide(self, a: int, b: int) -> int:
        """Return a / b, a product with the reciprocals of the factors of b."""
        sign, a, b = _sign(a, b), abs(a), abs(b)
        if self._numbers.get(b):
            return sign * self.multiply(a, self.number(1.0 / self._numbers[b]))
        factors = [] if self._numbers.get(a) == 1.0 else list(self._nested("product", a))
        for f in self._nested("product", b):
            value = _Value("quotient", (self.number(1.0), f))
            factors.append(self._find(value, value))
        return sign * self._commutative("quotient", sorted(factors), (a, b))

    def power(self, a: int, n: int) -> int:
        """Return aⁿ for n from one on, as a product."""
        return a if n == 1 else self.multiply(self.power(a, n - 1), a)

    def choose(self, mask: int, a: int, b: int) -> int:
        """Return a where the mask is set, else b."""
        if all(c < 0 or self._numbers.get(c) == 0.0 for c in (a, b)):
            return -self.value("choose", mask, abs(a), abs(b))
        return self.value("choose", mask, a, b)

    def _positive(self, a: int) -> int:
        """Return a reference without sign."""
        return a if a > 0 else self._find(("sum", a), _Value("sum", (a,)))

    def _nested(self, name: str, a: int) -> tuple[int, ...]:
        """Return the operands of the sums, or products, that a consists of."""
        same = (self._values[abs(a)].name == "sum") == (name == "sum")
        operands = self._flat.get(abs(a), ()) if same else ()
        return tuple(-o if a < 0 else o for o in operands) or (a,)

    def _commutative(self, name: str, flat: Sequence[int], operands: tuple[int, int]) -> int:
        """Return a sum, or a product that may be computed as a quotient."""
        if len(flat) == 1:
            return flat[0]
        value = self._find((name == "sum", *flat), _Value(name, operands))
        self._flat.setdefault(value, tuple(flat))
        return value

    def _find(self, key: object, value: _Value) -> int:
        """Return the number of a value, the next one if its key is new."""
        number = self._known.setdefault(key, len(self._values))
        if number == len(self._values):
            self._values.append(value)
        return number

    def program(
        self, outputs: Sequence[int], points: int, inputs: Mapping[tuple[int, ...], int]
    ) -> Program:
        """Write the instructions that compute values.

        Args:
            outputs: References to what is stored, in this order.
            points: Points of an instruction.
            inputs: The place of each input.
        """
        size = VECTOR * points
        instructions = self._instructions(outputs)
        last = {a: v for v, groups in instructions.items() for group in groups for a in group}
        stores: dict[int, list[int]] = {}
        for i, a in enumerate(outputs):
            stores.setdefault(abs(a), []).append(-i - 1 if a < 0 else i + 1)
        code: list[int] = []
        register: dict[int, int] = {}
        count = 0
        free: list[int] = []
        for v, groups in instructions.items():
            if not free:
                free, count = [count], count + 1
            register[v] = free.pop()
            value = self._values[v]
            sizes = tuple(map(len, groups)) if value.name == "sum" else ()
            operands = [a for group in groups for a in group]
            code += [_CODES.index(_SHORT.get(sizes, value.name)), size * register[v]]
            code += () if sizes in _SHORT else sizes
            code += [size * register[a] for a in operands]
            code += [inputs[value.integers]] if value.name == "input" else value.integers
            for i in stores.get(v, ()):
                code += [_CODES.index("store"), size * register[v], abs(i) - 1, int(i < 0)]
            free += {register[a] for a in (*operands, v) if last.get(a, v) == v}
        code.append(_CODES.index("end"))
        return Program(np.array(code, dtype=np.int32), points * count)

    def _instructions(self, outputs: Sequence[int]) -> dict[int, list[list[int]]]:
        """Return the operands of each instruction, under the value that it computes.

        Those of a sum are of four kinds, a b, −a b, c, −c. What one sum alone needs is part of its
        instruction, and so are products that two need.
        """
        values, uses = self._values, Counter(map(abs, outputs))
        other = set(uses)  # what other instructions than sums need
        for v in reversed(range(len(values))):
            if uses[v]:
                uses.update(map(abs, values[v].operands))
                if values[v].name != "sum":
                    other.update(values[v].operands)
        needed = [v for v in range(len(values)) if uses[v]]
        inner = {
            a
            for v in needed
            if values[v].name == "sum"
            for a in map(abs, values[v].operands)
            if (values[a].name == "sum" and uses[a] == 1)
            or (values[a].name == "product" and a not in other and uses[a] <= 2)
        }
        found: dict[int, list[list[int]]] = {}
        for v in needed:
            if v in inner:
                continue
            found[v] = [list(values[v].operands)]
            if values[v].name != "sum":
                continue
            terms, found[v] = found[v][0], [[], [], [], []]
            while terms:
                a = terms.pop()
                value = values[abs(a)]
                if abs(a) not in inner:
                    found[v][2 + int(a < 0)].append(abs(a))
                elif value.name == "product":
                    found[v][int(a < 0)] += value.operands
                else:
                    terms += [-b if a < 0 else b for b in value.operands]
        return found


def load_interpreter(comm: MPI.Comm, points: int) -> int:
    """Return the address of what executes a program in C.

    Args:
        comm: Communicator of all processes that load it.
        points: Points of an instruction.

    Note:
        Collective.
    """
    flags = ["-O3", "-fno-math-errno", "-fno-trapping-math", "-fno-tree-loop-distribute-patterns"]
    source, header = Path(__file__).with_name("tape.c"), f"enum {{ POINTS = {points} }};{HEADER}"
    flags += ["-Wno-psabi", *processor_flags()]
    code = load(source, "void *interpreter(void);", comm, generated=header, flags=flags)
    return int(code.ffi.cast("intptr_t", code.lib.interpreter()))


def _by_number(a: int) -> tuple[int, int]:
    return abs(a), a


def _sign(a: int, b: int) -> int:
    return 1 if (a < 0) == (b < 0) else -1
