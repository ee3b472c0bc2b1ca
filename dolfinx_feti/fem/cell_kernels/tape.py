# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Scalar expressions at a quadrature point as a list of instructions, which ``tape.h`` executes.

A new material is new data: no C compiler is called. Each value is computed once, and a sum
:math:`\sum_k ± a_k b_k + \sum_k ± c_k` is one instruction.

*References.* A value has an index v ≥ 1 on the tape. The reference v means the value, −v its
negative, so no instruction negates. In this file, arguments a, b and results of the methods of
``Tape`` are references; an ``Instruction`` computes a value.

*Equal values.* Each value has a key: its value at a random point of a finite field (J. T. Schwartz,
J. ACM 27, 1980). Keys of sums and products are computed in the field. Any other function has a
random key, which depends on the keys of its operands. Values with one key count as one value. Two
different polynomials of degree d have one key with the probability d/:data:`PRIME` < 1e-16. This is
how the factors A_st and A_ts of a tangent become one value, without a search for symmetry.
"""

from __future__ import annotations

import math
import random
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from dolfinx_feti.runtime.arrays import Indices

#: Functions of one argument that the C library has; the square root is an instruction.
FUNCTIONS = "exp log cos sin tan cosh sinh tanh acos asin atan erf".split()

#: Instructions, in the order of their codes. Names are UFL's where UFL has the operator.
INSTRUCTIONS = (
    "end number constant weight determinant interpolate sum product quotient power abs sqrt "
    "function choose lt gt le ge eq ne and_condition or_condition not_condition"
).split()

#: Tables of the instructions and functions, for ``tape.h``.
HEADER = f"""
#define INSTRUCTIONS {", ".join(f"do_{name}" for name in INSTRUCTIONS)}
#define FUNCTIONS {", ".join(FUNCTIONS)}
#define NAMES {", ".join(f'PREFIX "v_{name}"' for name in FUNCTIONS)}
"""

#: Number of elements of the field, 2 q + 1 with a prime q: in such a field 2 has the order q, so
#: that no two powers of two in double precision have the same key up to sign.
PRIME = 0x181F21A763FC87BF

#: The key of 1/x is the key of x to this power, which is arbitrary. With the true inverse in the
#: field, x/x would be the number 1, but it is NaN at x = 0.
RECIPROCAL_EXPONENT = 0x1A2B3C4D5E6F7

#: Registers 0 and 1 hold the determinant of the Jacobian and the quadrature weight.
RESERVED_REGISTERS = 2


class UnsupportedIntegrandError(Exception):
    """Only FFCx can compile an integrand; the message names what is not supported."""


@dataclass(frozen=True, slots=True)
class Instruction:
    """The instruction that computes a value.

    Attributes:
        name: One of :data:`INSTRUCTIONS`.
        operands: References to other values.
        integers: Further numbers that the instruction reads, such as that of a coefficient.
    """

    name: str
    operands: tuple[int, ...]
    integers: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Code:
    """Instructions for ``tape.h``.

    Attributes:
        words: Codes of the instructions with their operands, one after the other, (n,).
        offset: Offset in bytes of the register of each value.
        registers: Number of registers.
    """

    words: Indices
    offset: dict[int, int]
    registers: int


@dataclass(slots=True)
class SumTerms:
    """Values in a sum, + a b − a b + c − c, as in the instruction ``sum``."""

    added_products: list[int] = field(default_factory=list)  # a, b, a, b, …
    subtracted_products: list[int] = field(default_factory=list)  # a, b, a, b, …
    added: list[int] = field(default_factory=list)  # c
    subtracted: list[int] = field(default_factory=list)  # c

    def groups(self) -> list[list[int]]:
        """Return the four lists, in the order of the instruction."""
        return [self.added_products, self.subtracted_products, self.added, self.subtracted]

    def add_product(self, factors: Sequence[int], *, is_negative: bool) -> None:
        """Add a product of two values, or subtract it."""
        (self.subtracted_products if is_negative else self.added_products).extend(factors)

    def add_value(self, value: int, *, is_negative: bool) -> None:
        """Add a value, or subtract it."""
        (self.subtracted if is_negative else self.added).append(value)


class Tape:
    """Values of scalar expressions, each of them once.

    Attributes:
        literals: The numbers among the values, without sign.
    """

    def __init__(self) -> None:
        """Create an empty tape."""
        self._computed_by = [Instruction("end", ())]  # of each value; none has index 0, as −0 is 0
        self._keys = [0]  # of each value
        self._references: dict[int, int] = {}  # the reference that has a key
        self.literals: dict[int, float] = {}

    def number(self, x: float) -> int:
        """Return the reference to a finite number."""
        numerator, denominator = abs(x).as_integer_ratio()
        index = len(self.literals)  # if the number is new
        literal = Instruction("number", (), (index,))
        key = numerator * pow(denominator, -1, PRIME)
        reference = self._find(key, literal)
        if self.literals.get(abs(reference), abs(x)) != abs(x):  # another number has this key
            reference = self._find_opaque(literal)
        if reference > 0:
            self.literals[reference] = abs(x)
        return reference if x >= 0.0 else -reference

    def apply(self, name: str, *operands: int, integers: Sequence[int] = ()) -> int:
        """Return the reference to the result of an instruction that is no sum or product."""
        unsigned = tuple(map(self.positive_reference, operands))
        return self._find_opaque(Instruction(name, unsigned, tuple(integers)))

    def add(self, a: int, b: int) -> int:
        """Return the reference to a + b."""
        return self._find(self._key(a) + self._key(b), Instruction("sum", (a, b)))

    def multiply(self, a: int, b: int) -> int:
        """Return the reference to a b."""
        sign = 1 if a * b > 0 else -1
        key = self._keys[abs(a)] * self._keys[abs(b)]
        return sign * self._find(key, Instruction("product", (abs(a), abs(b))))

    def divide(self, a: int, b: int) -> int:
        """Return the reference to a / b."""
        divisor = self.literals.get(abs(b))
        if divisor:
            return self.multiply(a, self.number(math.copysign(1.0 / divisor, b)))
        sign = 1 if a * b > 0 else -1
        reciprocal = pow(self._keys[abs(b)], RECIPROCAL_EXPONENT, PRIME)
        if reciprocal == 0:  # 1/0 must not have the key of the number 0
            reciprocal = RECIPROCAL_EXPONENT  # any number but zero
        key = self._keys[abs(a)] * reciprocal
        return sign * self._find(key, Instruction("quotient", (abs(a), abs(b))))

    def power(self, a: int, n: int) -> int:
        """Return the reference to aⁿ, n ≥ 1, as a product."""
        return a if n == 1 else self.multiply(self.power(a, n - 1), a)

    def choose(self, mask: int, a: int, b: int) -> int:
        """Return the reference to a if the mask is set, else b.

        The choice between −a and −b is the negative of that between a and b, so that both are one
        value; zero has both signs.
        """
        if self._is_negated_or_zero(a) and self._is_negated_or_zero(b):
            return -self.apply("choose", mask, abs(a), abs(b))
        return self.apply("choose", mask, a, b)

    def _is_negated_or_zero(self, a: int) -> bool:
        """Return True if a reference is negated, or refers to zero."""
        return a < 0 or self.literals.get(a) == 0.0

    def positive_reference(self, a: int) -> int:
        """Return a positive reference to the value of a; a negated value becomes a new one."""
        return a if a > 0 else self._find_opaque(Instruction("sum", (a,)))

    def _key(self, a: int) -> int:
        """Return the key of a reference."""
        return self._keys[a] if a > 0 else PRIME - self._keys[-a]

    def _find_opaque(self, instruction: Instruction) -> int:
        """Return the reference to a result whose key follows no rule of algebra.

        Only the same instruction, with operands of the same keys, has this key.
        """
        keys = [self._key(a) for a in instruction.operands]
        seed = f"{instruction.name} {keys} {instruction.integers}"
        return self._find(random.Random(seed).randrange(1, PRIME), instruction)

    def _find(self, key: int, instruction: Instruction) -> int:
        """Return the reference with this key; if there is none, append the instruction's value."""
        key %= PRIME
        if key not in self._references:
            number = len(self._computed_by)
            self._computed_by.append(instruction)
            self._keys.append(key)
            self._references[PRIME - key] = -number
            self._references[key] = number
        return self._references[key]

    # -- instructions -----------------------------------------------------------------------------

    def code(self, outputs: set[int], size: int) -> Code:
        """Write the instructions that compute some values.

        Registers are reused as soon as no later instruction reads them, except those of outputs.

        Args:
            outputs: The values; their registers hold them at the end.
            size: Bytes of a register.
        """
        instructions = self._instructions(outputs)
        last_reader = {}  # the last value whose instruction reads a value
        for value, groups in instructions.items():
            for group in groups:
                for operand in group:
                    last_reader[operand] = value
        words: list[int] = []
        offset: dict[int, int] = {}
        free: list[int] = []  # offsets of registers that are not read any more
        registers = RESERVED_REGISTERS
        for value, groups in instructions.items():
            if not free:
                free.append(registers * size)
                registers += 1
            offset[value] = free.pop()
            words += self._encoded(value, groups, offset)
            operands = {a for group in groups for a in group}  # a value may occur twice
            ended = [a for a in operands if last_reader[a] == value and a not in outputs]
            free += {offset[a] for a in ended}
        words.append(INSTRUCTIONS.index("end"))
        return Code(np.array(words, dtype=np.int32), offset, registers)

    def _encoded(
        self, value: int, groups: Sequence[Sequence[int]], offset: Mapping[int, int]
    ) -> list[int]:
        """Return an instruction for ``tape.h``: its code, the result, and the operands.

        Args:
            value: The value that it computes.
            groups: Its operands; only a sum has several groups, and their lengths come first.
            offset: Offset in bytes of the register of each value.
        """
        name = self._computed_by[value].name
        words = [INSTRUCTIONS.index(name), offset[value]]
        if name == "sum":
            words += [len(group) for group in groups]
        words += [offset[a] for group in groups for a in group]
        words += self._computed_by[value].integers
        return words

    def _instructions(self, outputs: set[int]) -> dict[int, list[list[int]]]:
        """Return the operands of each instruction, in groups, by the value that it computes."""
        used = self._used(outputs)
        inlined = self._inlined(outputs, used)
        instructions: dict[int, list[list[int]]] = {}
        for v in sorted(used - inlined):
            instruction = self._computed_by[v]
            if instruction.name == "sum":
                instructions[v] = self._terms(instruction.operands, inlined).groups()
            else:
                instructions[v] = [list(instruction.operands)]
        return instructions

    def _used(self, outputs: set[int]) -> set[int]:
        """Return the values that outputs depend on, and the outputs."""
        used = set(outputs)
        for v in reversed(range(len(self._computed_by))):
            if v in used:
                used.update(abs(a) for a in self._computed_by[v].operands)
        return used

    def _inlined(self, outputs: set[int], used: set[int]) -> set[int]:
        """Return the sums and products that one sum alone uses: it computes them on the way.

        A multiplication costs the instruction of a sum no more than an addition. Products that two
        or four sums use may be computed in each of them, but a tangent in P2–P0 takes as long.
        """
        uses = Counter(outputs)
        uses_in_sums = Counter[int]()
        for v in used:
            operands = [abs(a) for a in self._computed_by[v].operands]
            uses.update(operands)
            if self._computed_by[v].name == "sum":
                uses_in_sums.update(operands)
        return {
            v
            for v, count in uses_in_sums.items()
            if count == 1 and uses[v] == 1 and self._computed_by[v].name in ("sum", "product")
        }

    def _terms(self, operands: Sequence[int], inlined: set[int]) -> SumTerms:
        """Return the terms of a sum, with those of the sums and products that it contains."""
        terms = SumTerms()
        remaining = list(operands)
        while remaining:
            a = remaining.pop()
            instruction = self._computed_by[abs(a)]
            if abs(a) not in inlined:
                terms.add_value(abs(a), is_negative=a < 0)
            elif instruction.name == "product":
                terms.add_product(instruction.operands, is_negative=a < 0)
            elif a < 0:
                remaining += [-b for b in instruction.operands]
            else:
                remaining += instruction.operands
        return terms
