# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""From the factors at quadrature points to the entries of a cell, in C.

.. math:: r[ai] = \sum_{q J} P_q[iJ]\, ∂_J φ_a, \qquad
          K[ai, bk] = \sum_{q L} \Bigl(\sum_J A_q[iJ, kL]\, ∂_J φ_a\Bigr)\, ∂_L φ_b.

Where A_st and A_ts are one value of the tape for all slots, K is symmetric: one half is copied.
"""

from __future__ import annotations

from collections.abc import Sequence

from dolfinx_feti.fem.kernels.integrand import Slot

__all__ = ["Factors", "braces", "contraction"]

#: Number of a factor under the slots of the arguments.
Factors = dict[tuple[Slot, ...], int]


def contraction(
    factors: Factors, values: Sequence[int], first: int, shape: tuple[int, ...]
) -> list[str]:
    """Return the loops that add one form to what is computed of it.

    Args:
        factors: Its factors.
        values: The value of each factor.
        first: Where the form begins.
        shape: Dofs of a cell for each argument.
    """
    if not shape:
        return [
            f"for (int q = start; q < start + POINTS; ++q) entries[{first}] += A[{i}][q];"
            for i in factors.values()
        ]
    return _vector(factors, first) if len(shape) == 1 else _matrix(factors, values, first, shape[1])


def _vector(factors: Factors, first: int) -> list[str]:
    """r[ai] = Σ_qJ P_q[iJ] ∂_J φ_a."""
    rows: dict[int, list[str]] = {}
    for (v,), i in factors.items():
        rows.setdefault(v.component, []).append(f"A[{i}][q] * {v.basis('a')}")
    lines = []
    for (v,) in list(factors)[:1]:
        lines.append(f"for (int a = 0; a < N{v.element}; ++a) {{")
        for component, products in rows.items():
            lines += [
                "{",
                "V s = {0.0};",
                f"for (int q = start; q < start + POINTS; ++q) s += {' + '.join(products)};",
                f"entries[{first} + a * {v.block} + {component}] += s;",
                "}",
            ]
        lines.append("}")
    return lines


def _matrix(factors: Factors, values: Sequence[int], first: int, width: int) -> list[str]:
    """T_qa[i, kL] = Σ_J A_q[iJ, kL] ∂_J φ_a, then K[ai, bk] = Σ_qL T_qa[i, kL] ∂_L φ_b."""
    if not factors:
        return []
    v, u = next(iter(factors))
    halves: dict[tuple[int, Slot], list[str]] = {}
    for (row, column), i in factors.items():
        halves.setdefault((row.component, column), []).append(f"A[{i}][q] * {row.basis('a')}")
    wholes: dict[tuple[int, int], list[str]] = {}
    for t, (i, column) in enumerate(halves):
        basis = column.basis("b")
        wholes.setdefault((i, column.component), []).append(f"T[{t}][q - start] * {basis}")
    known = {slots: values[i] for slots, i in factors.items()}
    half = all(known.get((u, v)) == value for (v, u), value in known.items())
    lines = ["{", f"for (int a = 0; a < N{v.element}; ++a) {{", f"V T[{len(halves)}][POINTS];"]
    lines.append("for (int q = start; q < start + POINTS; ++q) {")
    lines += [f"T[{t}][q - start] = {' + '.join(p)};" for t, p in enumerate(halves.values())]
    lines += ["}", f"for (int b = {'a' if half else '0'}; b < N{u.element}; ++b) {{"]
    lines += [f"V s{j} = {{0.0}};" for j in range(len(wholes))]
    lines.append("for (int q = start; q < start + POINTS; ++q) {")
    lines += [f"s{j} += {' + '.join(p)};" for j, p in enumerate(wholes.values())]
    lines.append("}")
    for j, (i, k) in enumerate(wholes):
        at, to = f"a * {v.block} + {i}", f"b * {u.block} + {k}"
        lines.append(f"entries[{first} + ({at}) * {width} + {to}] += s{j};")
        if half:
            lines.append(f"if (a != b) entries[{first} + ({to}) * {width} + {at}] += s{j};")
    return [*lines, "}", "}", "}"]


def braces(values: object) -> str:
    """Return numbers, or rows of them, in C."""
    return repr(values).translate(str.maketrans("[]()", "{}{}"))
