# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Deformation gradients F in the forms of a problem, and the volume ratio J = det F.

The unknown u need not be a displacement: it may be a velocity v, :math:`F = I + Δt\, \nabla v`, or
an increment w, :math:`F = I + \nabla(u_n + w)`. A deformation gradient is affine in u; at u = 0 it
is I, or the sum of I and the gradient of other fields; and :math:`F - I` is a gradient for all u. A
tensor T of the forms is taken for F if

1. it is affine in u,
2. :math:`T - I` is a gradient at u = 0,
3. :math:`T - I` is a gradient for all u, or the forms contain the inverse, determinant or cofactors
   of T and a gradient of u occurs in T.

The alternative in 3 is for increments from a last state, such as :math:`I + \nabla w\, F_n^{-1}`.
Such an increment is no gradient on the reference configuration, but the forms contain its inverse
or determinant, so it has to stay regular, too.

That a tensor is a gradient is checked numerically (``random_fields``): fields :math:`a\,(b·x)` with
random amplitudes a and one common direction b have gradients :math:`q ⊗ b`, of rank one, unlike
strains and products. If no tensor passes, a strain :math:`E = c\,(H + H^⊤ + H^⊤ H)` gives F = I +
H. An axisymmetric F, of shape (3, 3) on a mesh in the plane, has a gradient in two of its rows and
columns, and a stretch in the third.

The elastic part :math:`F_e = F A` of a deformation, with A of growth, residual stress, or a
prestressed image, has the volume ratio det F · det A, on which the energy depends.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import reduce

import ufl
from ufl import classes
from ufl.core.expr import Expr
from ufl.corealg.traversal import traverse_unique_terminals, unique_post_traversal

from dolfinx_feti.fem.user_forms.random_fields import RandomFields

__all__ = ["GradientFactor", "VolumeRatio", "find_volume_ratio", "volume_ratio_of_expression"]

#: Number of random fields at which a relation has to hold. Two different tensors differ at a random
#: field with probability one. The second field is for a difference that is as small as rounding at
#: the first one.
DRAWS = 2

#: Operators that are linear in each of their operands.
_LINEAR = (
    classes.Sum,
    classes.Indexed,
    classes.ComponentTensor,
    classes.IndexSum,
    classes.ListTensor,
    classes.Variable,
    classes.Transposed,
    classes.Sym,
    classes.Skew,
    classes.Deviatoric,
    classes.Trace,
    classes.Grad,
    classes.NablaGrad,
    classes.Div,
    classes.NablaDiv,
)

#: Operators that multiply their operands.
_PRODUCTS = (classes.Product, classes.Dot, classes.Inner, classes.Outer)

_GRADIENTS = (classes.Grad, classes.NablaGrad)

#: Parts of expressions that are no tensors, whose ``ufl_shape`` raises.
_WITHOUT_SHAPE = (classes.MultiIndex, classes.Label, classes.ExprList, classes.ExprMapping)

#: Operators whose operand is a regular (invertible) tensor in every admissible state.
_NEED_REGULAR = (classes.Determinant, classes.Inverse, classes.Cofactor)


@dataclass(frozen=True, slots=True)
class VolumeRatio:
    """The volume ratio of a body.

    Attributes:
        of_body: Volume ratio of the body: det F, or the smallest det F of several F. Newton's
            method requires that it is positive at the quadrature points of each iterate.
        of_energy: Volume ratio on which the energy depends: det F_e if there is one elastic part,
            and ``of_body`` otherwise. Its values inside cells are checked in accepted states.
        is_determinant: Whether both are determinants, so that their values are changes of volume.
            For any other expression that a user gives, only the sign has a meaning.
        gradients: The tensors F, (n, n) each; empty if a user's expression contains none.
        u: The unknown.
    """

    of_body: Expr
    of_energy: Expr
    is_determinant: bool
    gradients: tuple[Expr, ...]
    u: ufl.Coefficient


class GradientFactor:
    """The factor s of F = I + s Grad u: 1 for a displacement, Δt for a velocity.

    It depends on the present values of Constants in F, and is computed again when one changes. If
    s is a field or cannot be computed, it is 1, that of a displacement.
    """

    def __init__(self, ratio: VolumeRatio) -> None:
        """Collect the Constants in the deformation gradients."""
        self._ratio = ratio
        self._constants: list[ufl.Constant] = []  # those of dolfinx, which have a value
        for F in ratio.gradients:
            for f in traverse_unique_terminals(F):
                if isinstance(f, ufl.Constant) and hasattr(f, "value"):
                    self._constants.append(f)
        self._values: list[bytes] | None = None  # of the Constants when s was computed
        self._factor = 1.0

    def value(self) -> float:
        """Return s with the present values of the Constants; the largest one of several F."""
        values = [constant.value.tobytes() for constant in self._constants]
        if values != self._values:
            sample = RandomFields(self._ratio.u, 0, is_present=True)
            factors = [sample.factor(F) for F in self._ratio.gradients]
            self._values = values
            self._factor = max((s for s in factors if s > 0.0), default=1.0)
        return self._factor


def volume_ratio_of_expression(expression: Expr, u: ufl.Coefficient) -> VolumeRatio:
    """Return the volume ratio of a user's expression.

    Args:
        expression: The volume ratio, a scalar in UFL.
        u: The unknown.

    Raises:
        TypeError: It is no expression in UFL.
        ValueError: It is no scalar.
    """
    if not isinstance(expression, Expr):
        raise TypeError(
            f"volume_ratio is {expression!r}: give an expression in UFL, such as det F."
        )
    if expression.ufl_shape or expression.ufl_free_indices:
        raise ValueError(
            f"volume_ratio has the shape {expression.ufl_shape}: give a scalar, such as det F."
        )
    ratio_of_gradients = _find([expression], u)
    return VolumeRatio(
        of_body=expression,
        of_energy=expression,
        is_determinant=isinstance(_plain(expression), classes.Determinant),
        gradients=() if ratio_of_gradients is None else ratio_of_gradients.gradients,
        u=u,
    )


def find_volume_ratio(forms: Iterable[ufl.Form], u: ufl.Coefficient) -> VolumeRatio | None:
    """Return the volume ratio of the deformation gradients in residuals or energies.

    Args:
        forms: The forms.
        u: The unknown, of any meaning and shape.

    Returns:
        The volume ratio; None if no tensor in the forms passes the test of a deformation gradient.
    """
    return _find([integral.integrand() for form in forms for integral in form.integrals()], u)


@dataclass(frozen=True, slots=True)
class _Candidates:
    """Square tensors in expressions, without enclosing variables and transpositions.

    Attributes:
        affine: Tensors of degree one in u: candidates for F, for F_e, and for H.
        quadratic: Tensors of degree two in u: candidates for a strain E.
        regular: Tensors whose inverse, determinant or cofactors occur.
    """

    affine: list[Expr]
    quadratic: list[Expr]
    regular: set[Expr]


def _find(roots: Sequence[Expr], u: ufl.Coefficient) -> VolumeRatio | None:
    """Return the volume ratio of the deformation gradients in expressions; None without one."""
    candidates = _candidates(roots, u)
    if not candidates.affine:
        return None
    samples = [RandomFields(u, seed) for seed in range(DRAWS)]
    gradients = samples[0].different(_deformation_gradients(candidates, u, samples))
    if not gradients:
        gradients = samples[0].different(_gradients_in_strains(candidates, samples))
    if not gradients:
        return None
    elastic_parts = samples[0].different(_elastic_parts(candidates, gradients, samples))
    of_body = reduce(ufl.min_value, map(ufl.det, gradients))
    of_energy = of_body
    if len(elastic_parts) == 1:  # of several ones, each may belong to a part of the body
        of_energy = ufl.det(elastic_parts[0])
    return VolumeRatio(of_body, of_energy, True, tuple(gradients), u)


def _candidates(roots: Sequence[Expr], u: ufl.Coefficient) -> _Candidates:
    """Return the square tensors of low degree in u that occur in expressions."""
    nodes = list(dict.fromkeys(node for root in roots for node in unique_post_traversal(root)))
    degree = _degrees_in(u, nodes)
    # a partial sum, such as I + Grad w in I + Grad w + Grad u_n, is no deformation gradient
    operands: set[Expr] = set()
    for node in nodes:
        if not isinstance(node, classes.Sum):
            operands.update(node.ufl_operands)
    affine = []
    quadratic = []
    for node in nodes:
        T = _as_square(node) if degree[node] in (1, 2) else None
        if T is None:
            continue
        if degree[node] == 2:
            quadratic.append(T)
        elif node in operands:
            affine.append(T)
    regular = {_plain(T.ufl_operands[0]) for T in nodes if isinstance(T, _NEED_REGULAR)}
    return _Candidates(_distinct(affine), _distinct(quadratic), regular)


def _deformation_gradients(
    candidates: _Candidates, u: ufl.Coefficient, samples: Sequence[RandomFields]
) -> Iterator[Expr]:
    """Yield the affine tensors that pass conditions 1 to 3 of this file."""
    for T in candidates.affine:
        is_regular = T in candidates.regular and _has_gradient_of(u, T)
        if all(sample.is_deformation(T, is_regular=is_regular) for sample in samples):
            yield T


def _elastic_parts(
    candidates: _Candidates, gradients: Sequence[Expr], samples: Sequence[RandomFields]
) -> Iterator[Expr]:
    """Yield the regular tensors F A, with A independent of u, that are no F themselves."""
    for T in candidates.affine:
        if T not in candidates.regular or T in gradients:
            continue
        for F in gradients:
            if all(sample.is_elastic_part(T, F) for sample in samples):
                yield T
                break


def _gradients_in_strains(
    candidates: _Candidates, samples: Sequence[RandomFields]
) -> Iterator[Expr]:
    """Yield I + H for each affine H with a strain E = c (H + Hᵀ + Hᵀ H) among the tensors."""
    for H in candidates.affine:
        if not all(sample.is_displacement_gradient(H) for sample in samples):
            continue
        for E in candidates.quadratic:
            if all(sample.is_strain(E, H) for sample in samples):
                yield ufl.Identity(H.ufl_shape[0]) + H
                break


def _degrees_in(u: ufl.Coefficient, nodes: Sequence[Expr]) -> dict[Expr, float]:
    """Return the polynomial degree in u of each node; infinity if it is no polynomial.

    Args:
        u: The unknown.
        nodes: Nodes of expressions, each after its operands.
    """
    degree: dict[Expr, float] = {}
    for node in nodes:
        parts = [degree[part] for part in node.ufl_operands]
        if isinstance(node, classes.Coefficient):
            degree[node] = 1 if node == u else 0
        elif isinstance(node, classes.Argument):
            degree[node] = math.inf  # a variation: no part of a deformation gradient
        elif not any(parts):
            degree[node] = 0
        elif isinstance(node, _LINEAR):
            degree[node] = max(parts)
        elif isinstance(node, _PRODUCTS):
            degree[node] = sum(parts)
        elif isinstance(node, classes.Division) and parts[1] == 0:
            degree[node] = parts[0]
        else:
            degree[node] = math.inf
    return degree


def _as_square(node: Expr) -> Expr | None:
    """Return a node as a square tensor without free indices; None if it is none.

    A sum with two free indices is one, too: UFL 2026 writes I + Grad u by components.
    """
    if isinstance(node, _WITHOUT_SHAPE):
        return None
    shape = node.ufl_shape
    free = node.ufl_free_indices
    extents = node.ufl_index_dimensions
    if len(shape) == 2 and shape[0] == shape[1] and not free:
        return node
    if isinstance(node, classes.Sum) and not shape and len(free) == 2 and extents[0] == extents[1]:
        return ufl.as_tensor(node, tuple(classes.Index(count) for count in free))
    return None


def _has_gradient_of(u: ufl.Coefficient, T: Expr) -> bool:
    """Return True if a gradient of u occurs in T."""
    inside = (node for node in unique_post_traversal(T) if isinstance(node, _GRADIENTS))
    return any(u in traverse_unique_terminals(node) for node in inside)


def _plain(T: Expr) -> Expr:
    """Return T without enclosing variables and transpositions, which keep its determinant."""
    while isinstance(T, (classes.Variable, classes.Transposed)):
        T = T.ufl_operands[0]
    return T


def _distinct(tensors: Iterable[Expr]) -> list[Expr]:
    """Return the tensors without enclosing variables and transpositions, each once."""
    return list(dict.fromkeys(map(_plain, tensors)))
