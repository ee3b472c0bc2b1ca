# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Relations between tensors in UFL, checked at random values of all fields.

A field :math:`f(x) = a\,(b·x)` has the gradient :math:`a ⊗ b`. With one direction b for all fields,
every gradient has the form :math:`q ⊗ b`. A tensor that is linear in gradients and no gradient
itself has another form, except for special a and b, which are drawn with probability zero. In the
same way, an identity that holds for random a and b holds for all fields.
"""

from __future__ import annotations

import itertools
import logging
import warnings
from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

import ufl
from ufl import classes
from ufl.core.expr import Expr
from ufl.corealg.traversal import traverse_unique_terminals
from ufl.domain import extract_unique_domain

from dolfinx_feti.runtime.arrays import Array

__all__ = ["RandomFields"]

_log = logging.getLogger(__name__)

#: Relative difference of two tensors that is rounding. A few operations leave 1e-15; different
#: tensors differ by about one. The bound is between the two, on a logarithmic scale.
TENSOR_RTOL = 1e-9

#: Difference that is rounding after the identity, of size one, has been subtracted: some tens of
#: rounding units. It decides only if both tensors are zero to rounding.
TENSOR_ATOL = 1e-14


class RandomFields:
    """Random values of all fields, for checks of relations between tensors.

    Each field is a (b·x) with an amplitude a of its shape and the common direction b, |b| = 1. The
    numbers are equal on all processes.
    """

    def __init__(self, u: ufl.Coefficient, seed: int, *, is_present: bool = False) -> None:
        """Draw the direction and the point; amplitudes are drawn when a field first occurs.

        Args:
            u: The unknown.
            seed: Seed of the random numbers.
            is_present: True for :meth:`factor`, which is evaluated at u = 0: u is zero at the
                point, while its gradient is random, and Constants have their present values. False
                for relations that hold in all states: u and Constants are random, too.
        """
        self._u = u
        self._is_present = is_present
        self._random = np.random.default_rng(seed)
        self._dim = len(ufl.SpatialCoordinate(extract_unique_domain(u)))
        b = self._draw((self._dim,))
        self._b = b / np.linalg.norm(b)
        self._x = self._draw((self._dim,))
        self._drawn: dict[Expr, Array] = {}
        self._values: dict[tuple[Expr, float], Array | None] = {}

    def is_deformation(self, T: Expr, *, is_regular: bool) -> bool:
        """Return True if T is a deformation gradient, see the head of ``deformation``.

        Args:
            T: A square tensor, affine in u.
            is_regular: Whether the forms contain its inverse or determinant.
        """
        at_rest = self._value(T, 0.0)
        moved = self._value(T, 1.0)
        if at_rest is None or moved is None:
            return False
        one = np.eye(len(moved))
        return self._is_gradient(at_rest - one) and (is_regular or self._is_gradient(moved - one))

    def is_displacement_gradient(self, H: Expr) -> bool:
        """Return True if H, affine in u, is the gradient of a field for all u."""
        values = self._value(H, 0.0), self._value(H, 1.0)
        return all(value is not None and self._is_gradient(value) for value in values)

    def is_strain(self, E: Expr, H: Expr) -> bool:
        """Return True if E = c (H + Hᵀ + Hᵀ H) or E = c (H + Hᵀ + H Hᵀ) with a number c."""
        strain = self._value(E, 1.0)
        h = self._value(H, 1.0)
        if strain is None or h is None or strain.shape != h.shape:
            return False
        return any(_is_multiple(strain, h + h.T + square) for square in (h.T @ h, h @ h.T))

    def is_elastic_part(self, T: Expr, F: Expr) -> bool:
        """Return True if T = F A with a tensor A that does not depend on u."""
        t = self._value(T, 1.0)
        f = self._value(F, 1.0)
        t_at_rest = self._value(T, 0.0)
        f_at_rest = self._value(F, 0.0)
        if t is None or f is None or t_at_rest is None or f_at_rest is None or t.shape != f.shape:
            return False
        return _is_same(t, f @ np.linalg.solve(f_at_rest, t_at_rest))

    def different(self, tensors: Iterable[Expr]) -> list[Expr]:
        """Return the tensors that differ from all tensors before them and from their transposes.

        Args:
            tensors: Tensors that :meth:`is_deformation` or another check has evaluated.
        """
        different: list[Expr] = []
        values: list[Array] = []
        for T in tensors:
            value = self._value(T, 1.0)
            assert value is not None, T  # a check has evaluated it
            same_shape = (other for other in values if other.shape == value.shape)
            if not any(_is_same(value, V) or _is_same(value.T, V) for V in same_shape):
                different.append(T)
                values.append(value)
        return different

    def factor(self, F: Expr) -> float:
        """Return |s| of F = F(0) + s Grad u; zero if F cannot be evaluated.

        The sign of s is that of a direction of time, which does not matter for a length.
        """
        part_of_u = self._value(ufl.derivative(F, self._u, self._u), 1.0)  # s Grad u
        if part_of_u is None:
            return 0.0
        return float(np.linalg.norm(part_of_u) / np.linalg.norm(self._amplitude(self._u)))

    def _is_gradient(self, D: Array) -> bool:
        """Return True if D, (n, n), contains the gradient of a field.

        The gradient, q ⊗ b or its transpose, is in the rows and columns of the directions in which
        the mesh extends. In all other rows and columns, such as those of the circumference of an
        axisymmetric body, D is diagonal. Which rows belong to the mesh is not known, so that all
        choices are tried.
        """
        n = len(D)
        b = self._b
        for rows in map(list, itertools.combinations(range(n), self._dim)):
            others = [i for i in range(n) if i not in rows]
            block = D[np.ix_(rows, rows)]
            off_block = D.copy()
            off_block[np.ix_(rows, rows)] = 0.0
            off_block[others, others] = 0.0
            candidates = np.outer(block @ b, b), np.outer(b, b @ block)
            if not any(_is_same(block, candidate) for candidate in candidates):
                continue
            if _is_same(off_block, np.zeros_like(D)):
                return True
        return False

    def _value(self, T: Expr, scale: float) -> Array | None:
        """Return T, (n, n), with u multiplied by a number; None if it cannot be evaluated."""
        key = (T, scale)
        if key not in self._values:
            try:
                self._values[key] = self._evaluate(T, scale)
            except Exception as error:  # UFL raises errors of many classes for its operators
                _log.debug("a tensor is not checked, as UFL cannot evaluate it: %r", error)
                self._values[key] = None
        return self._values[key]

    def _evaluate(self, T: Expr, scale: float) -> Array:
        """Return T, (n, n), at the point, with u multiplied by a number.

        Raises:
            Exception: UFL cannot evaluate T there.
        """
        expanded = ufl.algorithms.expand_derivatives(T)
        values = {f: self._field(f, scale) for f in traverse_unique_terminals(expanded)}
        point_values = {f: value for f, value in values.items() if value is not None}
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # UFL warns of a terminal without a value
            components = [
                float(expanded(tuple(self._x), point_values, index))
                for index in np.ndindex(T.ufl_shape)
            ]
        value = np.reshape(components, T.ufl_shape)
        if not np.all(np.isfinite(value)):
            raise ArithmeticError("not finite")
        return value

    def _field(self, f: Expr, scale: float) -> object:
        """Return the value of a terminal for UFL's evaluation.

        It is a function of the point and of the numbers of derivatives for a field, an array for a
        Constant, and None for a terminal that has a value in UFL, such as a number.
        """
        if isinstance(f, classes.Coefficient):
            a = self._amplitude(f)
            is_zero_here = False
            if f == self._u:
                a = scale * a
                is_zero_here = self._is_present

            def field(x: Sequence[float], derivatives: tuple[int, ...] = ()) -> Array:
                if not derivatives and not is_zero_here:
                    return a * (self._b @ x)
                if len(derivatives) == 1:
                    return a * self._b[derivatives[0]]
                return np.zeros_like(a)

            return field
        if isinstance(f, ufl.Constant) and self._is_present and hasattr(f, "value"):
            return np.asarray(f.value)
        if isinstance(f, ufl.Constant):
            return self._amplitude(f)
        is_of_cell = isinstance(f, classes.GeometricQuantity)
        if is_of_cell and not isinstance(f, classes.SpatialCoordinate):
            return self._amplitude(f)
        return None

    def _amplitude(self, f: Expr) -> Array:
        """Return the random number or array of a terminal, the same at each call."""
        if f not in self._drawn:
            self._drawn[f] = self._draw(f.ufl_shape)
        return self._drawn[f]

    def _draw(self, shape: tuple[int, ...]) -> Array:
        """Return random numbers between a half and one: none is nearly zero."""
        return np.asarray(self._random.uniform(0.5, 1.0, shape))


def _is_same(A: npt.NDArray[np.floating], B: npt.NDArray[np.floating]) -> bool:
    """Return True if two arrays differ by rounding."""
    size = max(float(np.abs(A).max()), float(np.abs(B).max()))
    return bool(np.abs(A - B).max() <= TENSOR_RTOL * size + TENSOR_ATOL)


def _is_multiple(A: Array, B: Array) -> bool:
    """Return True if A = c B with a number c."""
    return _is_same(A, B * (np.vdot(A, B) / np.vdot(B, B)))
