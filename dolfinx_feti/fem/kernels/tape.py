# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Expressions at quadrature points as a list of instructions, which ``tape.h`` executes.

A new material is new data, for which no C compiler is called. Each value is computed once, and
:math:`\sum_k ± a_k b_k + \sum_k ± c_k` is one instruction. A reference to a value carries its sign,
so that nothing has to be negated.

Two expressions are one value if they are the same number at a random point of a finite field:
sums and products are taken in it, functions of the same operands are the same random number
(J. T. Schwartz, J. ACM 27, 1980). So the factors of a tangent are seen to be symmetric.
"""

from __future__ import annotations

import math
import random
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfinx_feti.runtime.arrays import Indices

#: Functions of one argument that are called; a square root is an instruction of the processor.
FUNCTIONS = "exp log cos sin tan cosh sinh tanh acos asin atan erf".split()

#: Instructions, by UFL's names where it has one.
_CODES = (
    "end number constant weight determinant interpolate sum product quotient power abs sqrt "
    "function choose lt gt le ge eq ne and_condition or_condition not_condition"
).split()

#: The instructions, for C.
HEADER = f"""
#define INSTRUCTIONS {", ".join(f"do_{name}" for name in _CODES)}
#define FUNCTIONS {", ".join(FUNCTIONS)}
#define NAMES {", ".join(f'PREFIX "v_{name}"' for name in FUNCTIONS)}
"""

#: The field has so many elements, 2 q + 1 with a prime q: two has the order q, and no powers of two
#: in double precision are the same up to sign.
PRIME = 0x181F21A763FC87BF

#: 1/x is x to this power, whose product with x is not 1: x/x is no number where x is 0. Neither is
#: 1/0, which is this one.
RECIPROCAL = 0x1A2B3C4D5E6F7


@dataclass(frozen=True, slots=True)
class _Value:
    """A value: an instruction, the references to its operands, and integers of other meanings."""

    name: str
    operands: tuple[int, ...]
    integers: tuple[int, ...] = ()


class Tape:
    """Values, each with a number from one on. A reference is this number, or −number for −value.

    Attributes:
        literals: The values that are known.
    """

    def __init__(self) -> None:
        """Begin with no values."""
        self._values = [_Value("end", ())]
        self._keys = [0]  # elements of the field
        self._known: dict[int, int] = {}  # references under keys
        self.literals: dict[int, float] = {}

    def number(self, x: float) -> int:
        """Return a finite number."""
        n, d = abs(x).as_integer_ratio()
        literal = _Value("number", (), (len(self.literals),))
        value = self._find(n * pow(d, -1, PRIME), literal)
        if self.literals.get(abs(value), abs(x)) != abs(x):  # another number has this key
            value = self._opaque(literal)
        if value > 0:
            self.literals[value] = abs(x)
        return value if x >= 0.0 else -value

    def value(self, name: str, *operands: int, integers: Sequence[int] = ()) -> int:
        """Return the result of an instruction, which may need integers of other meanings."""
        value = _Value(name, tuple(map(self.positive, operands)), tuple(integers))
        return self._opaque(value)

    def add(self, a: int, b: int) -> int:
        """Return a + b."""
        return self._find(self._key(a) + self._key(b), _Value("sum", (a, b)))

    def multiply(self, a: int, b: int) -> int:
        """Return a b."""
        sign = 1 if a * b > 0 else -1
        key = self._keys[abs(a)] * self._keys[abs(b)]
        return sign * self._find(key, _Value("product", (abs(a), abs(b))))

    def divide(self, a: int, b: int) -> int:
        """Return a / b."""
        if x := self.literals.get(abs(b)):
            return self.multiply(a, self.number(math.copysign(1.0 / x, b)))
        sign = 1 if a * b > 0 else -1
        reciprocal = pow(self._keys[abs(b)], RECIPROCAL, PRIME) or RECIPROCAL
        key = self._keys[abs(a)] * reciprocal
        return sign * self._find(key, _Value("quotient", (abs(a), abs(b))))

    def power(self, a: int, n: int) -> int:
        """Return aⁿ for n from one on, as a product."""
        return a if n == 1 else self.multiply(self.power(a, n - 1), a)

    def choose(self, mask: int, a: int, b: int) -> int:
        """Return a where the mask is set, else b."""
        if all(c < 0 or self.literals.get(c) == 0.0 for c in (a, b)):
            return -self.value("choose", mask, abs(a), abs(b))
        return self.value("choose", mask, a, b)

    def positive(self, a: int) -> int:
        """Return a reference without sign."""
        return a if a > 0 else self._opaque(_Value("sum", (a,)))

    def _key(self, a: int) -> int:
        return self._keys[a] if a > 0 else PRIME - self._keys[-a]

    def _opaque(self, value: _Value) -> int:
        """Return what has no other expression."""
        keys = [self._key(a) for a in value.operands]
        seed = f"{value.name} {keys} {value.integers}"
        return self._find(random.Random(seed).randrange(1, PRIME), value)

    def _find(self, key: int, value: _Value) -> int:
        """Return a reference to the value with this key, which is a new one if there is none."""
        key %= PRIME
        if key not in self._known:
            number = len(self._values)
            self._values.append(value)
            self._keys.append(key)
            self._known[PRIME - key] = -number
            self._known[key] = number
        return self._known[key]

    def program(self, outputs: set[int], size: int) -> tuple[Indices, dict[int, int], int]:
        """Write the instructions that leave the outputs in registers of their own, of a size.

        Returns them, the place of each value in bytes, and the number of registers.
        """
        instructions = self._instructions(outputs)
        last = {a: v for v, groups in instructions.items() for group in groups for a in group}
        code: list[int] = []
        register: dict[int, int] = {}
        free: list[int] = []
        count = 2  # the determinant and the weight have the first ones
        for v, groups in instructions.items():
            if not free:
                free, count = [count * size], count + 1
            register[v] = free.pop()
            value = self._values[v]
            sizes = tuple(map(len, groups)) if value.name == "sum" else ()
            operands = [a for group in groups for a in group]
            code += [_CODES.index(value.name), register[v]]
            code += sizes
            code += [register[a] for a in operands]
            code += value.integers
            free += {register[a] for a in operands if last[a] == v and a not in outputs}
        code.append(_CODES.index("end"))
        return np.array(code, dtype=np.int32), register, count

    def _instructions(self, outputs: set[int]) -> dict[int, list[list[int]]]:
        """Return the operands of each instruction, under the value that it computes.

        Those of a sum are of four kinds, a b, −a b, c, −c. What one sum alone needs is part of its
        instruction, and so are products that two need.
        """
        values, uses, sums = self._values, Counter(outputs), Counter[int]()
        for v in reversed(range(len(values))):
            if uses[v]:
                operands = [abs(a) for a in values[v].operands]
                uses.update(operands)
                sums.update(operands if values[v].name == "sum" else ())
        most = {"sum": 1, "product": 2}
        inner = {a for a, n in sums.items() if n == uses[a] and n <= most.get(values[a].name, 0)}
        found: dict[int, list[list[int]]] = {}
        for v in sorted(set(uses) - inner):
            terms = list(values[v].operands)
            if values[v].name != "sum":
                found[v] = [terms]
                continue
            groups: list[list[int]] = [[], [], [], []]
            while terms:
                a = terms.pop()
                value = values[abs(a)]
                if abs(a) not in inner:
                    groups[2 + (a < 0)].append(abs(a))
                elif value.name == "product":
                    groups[a < 0] += value.operands
                else:
                    terms += [-b if a < 0 else b for b in value.operands]
            found[v] = groups
        return found
