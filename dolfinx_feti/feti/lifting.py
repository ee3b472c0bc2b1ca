# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Two conventions for right-hand sides of problems with prescribed values :math:`x_D`.

A torn matrix keeps the rows and columns of prescribed dofs. Its right-hand side has the values
:math:`x_D` on these dofs and the loads :math:`b_f` on the free ones, and the solver lifts:

.. math:: A_{ff} x_f = b_f - A_{fD} x_D

An assembled matrix whose columns of prescribed dofs are zero, as dolfinx's, needs a right-hand side
that is lifted already, :math:`\tilde b_f = b_f - A_{fD} x_D` (``apply_lifting``, then ``set_bc``).
If that one is lifted again, the effect of the prescribed values counts twice. A check logs a
warning then. It takes a product with K for each right-hand side of a linear problem, until it has
detected a fault once. Newton's method assembles its right-hand sides itself and skips the check.
"""

from __future__ import annotations

from copy import copy

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import total_of, warn
from dolfinx_feti.torn.matrix import Torn

#: Tolerance of the check, which compares b_f with −A_fD x_D. A vector counts as lifted if b_f
#: contains −A_fD x_D once: the multiple of it in b_f and the cosine of their angle are one, up to
#: this tolerance. It counts as not lifted if the multiple is zero, up to this tolerance. Loads
#: alone have a multiple near zero: −A_fD x_D changes from dof to dof, and is larger than the load
#: of a cell by a factor that grows with 1/h². At half of the tolerance, lifted vectors with larger
#: loads at the supports would be missed; at twice, some loads would be suspected.
MULTIPLE_TOLERANCE = 0.1

#: Smallest ratio of the entries of a lifted vector next to prescribed dofs to those elsewhere, both
#: as root mean squares. It excludes a load that equals −A_fD x_D by chance, such as one that is one
#: at each dof: its entries have the same size everywhere. At half of the ratio, a graded load on a
#: coarse mesh, which is larger at the supports, could pass for a lifted vector.
MIN_RATIO = 3.0

#: Warning for a lifted vector if the solver lifts; {0} is the options prefix.
LIFTED_TWICE = (
    "The right-hand side seems to be lifted (apply_lifting) already, and FETI lifts it again: the "
    "solution would be wrong. Leave apply_lifting out, as problem.assemble_rhs(L) does, or choose "
    "dolfinx's convention by FETI(lifted=True), problem.create_linear_solver(lifted=True) or "
    "-{0}feti_right_side lifted."
)

#: Warning for a vector without lifting if the solver does not lift.
NEVER_LIFTED = (
    "The right-hand side does not seem to be lifted (apply_lifting), although lifted=True or "
    "-{0}feti_right_side lifted is set: the solution would be wrong. Lift it, or leave that out."
)


class RightHandSides:
    """The convention of one solver's right-hand sides, and the check of each; it stores no vectors.

    Attributes:
        are_lifted: Whether they are lifted already.
        needs_check: Whether a vector in the other convention would be logged. It is True until that
            has happened once, and False from the start for Newton's method.
    """

    def __init__(self, *, are_lifted: bool, needs_check: bool) -> None:
        """Store the convention; the arguments are the attributes of the class."""
        self.are_lifted = are_lifted
        self.needs_check = needs_check

    def unlifted(self, torn: Torn, b: PETSc.Vec, prefix: str) -> PETSc.Vec:
        """Return b without lifting, as the solver needs it. Collective.

        If b seems to have the other convention, a warning is logged, once.

        Args:
            torn: The torn matrix.
            b: Right-hand side, (N,).
            prefix: Options prefix of the KSP, for the warning.

        Returns:
            A vector that the caller destroys: another reference to b, or a new vector.
        """
        if not (self.are_lifted or self.needs_check):
            return copy(b)  # another reference
        if not np.isfinite(b.norm()):
            return copy(b)  # the outer loop ends with DIVERGED_NANORINF
        x_D = np.where(torn.is_dirichlet, b.array_r, 0.0)
        force = prescribed_force(torn, x_D)
        if self.needs_check:
            self._warn_of_other_convention(torn, b, force, prefix)
        if not self.are_lifted:
            return copy(b)
        unlifted = b.copy()
        unlifted.array[:] += force  # b_f = b̃_f + A_fD x_D
        return unlifted

    def _warn_of_other_convention(
        self, torn: Torn, b: PETSc.Vec, force: Array, prefix: str
    ) -> None:
        """Log a warning if b seems to have the other convention. Collective.

        Args:
            torn: The torn matrix.
            b: Right-hand side, (N,).
            force: A_fD x_D, (N,).
            prefix: Options prefix of the KSP.
        """
        multiple_if_wrong = 0.0 if self.are_lifted else 1.0
        multiple = lifted_multiple(torn, b.array_r, force)
        if abs(multiple - multiple_if_wrong) <= MULTIPLE_TOLERANCE:
            text = NEVER_LIFTED if self.are_lifted else LIFTED_TWICE
            warn(text.format(prefix), torn.comm)
            self.needs_check = False


def prescribed_force(torn: Torn, x_D: Array) -> Array:
    """Return A_fD x_D on the free dofs, zero on the others, (N,). Collective.

    Args:
        torn: The torn matrix.
        x_D: Prescribed values, zero on free dofs, (N,).
    """
    force = torn.assemble(torn.multiply(torn.tear(x_D)))
    return np.where(torn.is_dirichlet, 0.0, force)


def lifted_multiple(torn: Torn, b: Array, force: Array) -> float:
    """Return the multiple of −A_fD x_D that a right-hand side seems to contain. Collective.

    Args:
        torn: The torn matrix.
        b: The right-hand side, (N,).
        force: A_fD x_D, see :func:`prescribed_force`.

    Returns:
        The multiple that fits best on the dofs where the force is not zero, if it is about one, as
        in a lifted vector, or about zero. It is nan otherwise, or if there is no such force, or if
        b has NaN or Inf.
    """
    coupled = force != 0.0  # free dofs next to prescribed ones
    others = ~coupled & ~torn.is_dirichlet
    with np.errstate(invalid="ignore", over="ignore"):  # b may have NaN or Inf
        ff = force @ force
        fb = force @ b
        bb = b[coupled] @ b[coupled]
        bb_others = b[others] @ b[others]
    sums = total_of(np.array([ff, fb, bb, bb_others, coupled.sum(), others.sum()]), torn.comm)
    if not np.all(np.isfinite(sums)):
        return np.nan
    ff, fb, bb, bb_others, n_coupled, n_others = sums
    if not ff > 0.0:
        return np.nan
    multiple = -fb / ff
    cosine = -fb / np.sqrt(ff * bb) if bb > 0.0 else 0.0
    is_larger_at_supports = bb * n_others >= MIN_RATIO**2 * bb_others * n_coupled
    is_one = abs(multiple - 1.0) <= MULTIPLE_TOLERANCE
    is_lifted = is_one and cosine >= 1.0 - MULTIPLE_TOLERANCE and is_larger_at_supports
    is_unlifted = abs(multiple) <= MULTIPLE_TOLERANCE
    return float(multiple) if is_lifted or is_unlifted else np.nan
