# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Multipliers λ that keep the volume of each cell.

.. math:: r_p(u, p) - r_p(0, λ) = \int q\, \Bigl(J - 1 - \frac{p - λ}{κ}\Bigr), \qquad λ ← p(λ)

The update of the augmented Lagrangian, with the pressure p(λ) of the equilibrium under λ, converges
linearly, at a rate that improves with κ relative to the stiffness of the material. Anderson's
method accelerates it.
"""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_feti.problems.equations.system import System
from dolfinx_feti.problems.incompressible import multiplier_tolerance, set_modulus
from dolfinx_feti.problems.multipliers import MultiplierUpdates
from dolfinx_feti.runtime.anderson import Anderson
from dolfinx_feti.runtime.arrays import Array, Integers
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.norms import max_norm

#: Default bound of abs(mean J − 1) in a cell: the default relative tolerance of Newton's method.
VOLUME_TOLERANCE = 1e-8


def create_volume_multipliers(
    system: System, *, kappa: float | None, volume_tolerance: float | None, default_tolerance: float
) -> VolumeMultipliers | None:
    """Choose the modulus of incompressible fields, and create multipliers if there are to be any.

    Collective.

    Args:
        system: The equations, at the state where the first solve begins.
        kappa: The user's κ, or None.
        volume_tolerance: The user's tolerance, or None.
        default_tolerance: Tolerance of an incompressible field without one.

    Returns:
        The multipliers; None if there are none.

    Raises:
        ValueError: The state does not determine κ, and none was given; the tolerance is not
            positive, no pressure is condensed, or one is no scalar.
    """
    tolerance = multiplier_tolerance(
        kappa,
        volume_tolerance,
        default_tolerance,
        has_incompressible_field=system.forms.compression is not None,
    )
    constraint_sizes = set_modulus(system, kappa, tolerance)
    if tolerance is None:
        return None
    return VolumeMultipliers(system, tolerance, constraint_sizes)


class VolumeMultipliers:
    """The multipliers λ of a problem, one for each dof of its condensed pressures.

    Attributes:
        comm: Communicator of the problem.
        tolerance: Bound of abs(mean J − 1) in each cell; in a linear problem relative to that of
            the first solve.
    """

    def __init__(
        self, system: System, tolerance: float, constraint_sizes: Sequence[float] | None
    ) -> None:
        """Create multipliers λ = 0 in the equations of condensed pressures. Collective.

        Args:
            system: The equations.
            tolerance: The volume tolerance.
            constraint_sizes: Size |c| of the constraint of each condensed field, by which its
                change is divided; 1 for all if None.

        Raises:
            ValueError: The tolerance is not positive, no pressure is condensed, or one is no
                scalar.
        """
        if not tolerance > 0.0:
            raise ValueError(f"volume_tolerance is {tolerance}: give a number above zero, or None.")
        if system.condensation is None:
            raise ValueError(
                "volume_tolerance is given, but no pressure: pass condense=p, with p in the energy."
            )
        system.condensation.create_multipliers(constraint_sizes)
        self.comm = system.comm
        self.tolerance = tolerance
        self._system = system
        self._fields = system.condensation

    @property
    def ends(self) -> Integers:
        """Where the values of each field but the last end in arrays such as :meth:`pressure`."""
        return np.cumsum([len(f.x.array) for f in self._fields.fields])[:-1]

    def pressure(self) -> Array:
        """Return the present pressures, with ghosts, as in ``StateValues.p``."""
        return self._system.state.values().p

    def set(self, pressure: Array) -> float:
        """Set λ to a pressure, given as :meth:`pressure` returns it. Collective.

        Returns:
            The largest change of the mean of r_p(0, λ) in a cell, each field relative to its |c|.
            If λ is set to the p that has solved its equation with the λ before, that is the largest
            abs(mean J − 1) of a cell: J − 1 = (p − λ)/κ, so that the change measures the volume.
        """
        change = on_all(lambda: self._fields.set_multipliers(pressure), self.comm)
        return float(self.comm.allreduce(change, op=MPI.MAX))

    def set_to_pressure(self) -> float:
        """Set λ to the pressure of the present state; return what :meth:`set` does. Collective."""
        return self.set(self.pressure())


class VolumeUpdates(MultiplierUpdates):
    """The updates of λ in one solve.

    Attributes:
        violations: The largest abs(mean J − 1) of a cell after each solve.
    """

    def __init__(
        self, multipliers: VolumeMultipliers, tolerance: float, *, is_relative: bool = False
    ) -> None:
        """Create the updates of a solve that begins with λ = p, which the caller has set.

        Args:
            multipliers: The multipliers; the pressure is λ now.
            tolerance: Bound of abs(mean J − 1) in each cell.
            is_relative: Whether the tolerance is a share of the violation after the first solve.
        """
        self.violations: list[float] = []
        self._multipliers = multipliers
        self._tolerance = tolerance
        self._is_relative = is_relative
        self._λ = multipliers.pressure()
        self._p = self._λ.copy()  # of the last solve
        self._scale = np.ones_like(self._λ)  # of the field that an entry belongs to
        # Ghosts are included in scalar products, as the owned entries of several fields are not
        # contiguous. Cells of two processes then count twice, which does no harm: the weights of
        # Anderson's least-squares problem are arbitrary.
        self._anderson = Anderson(multipliers.comm, len(self._λ))

    def end_solve(self) -> bool:
        """Set λ to the present pressure; return True if each cell keeps its volume. Collective."""
        self._p = self._multipliers.pressure()
        self.violations.append(self._multipliers.set(self._p))
        allowed = self._tolerance
        if self._is_relative:
            allowed *= self.violations[0]
        return self.violations[-1] <= allowed

    def update(self) -> None:
        """Set λ by Anderson's method from the last pressures. Collective."""
        change = self._p - self._λ
        if len(self.violations) == 1:
            self._choose_scales(change)
        scale = self._scale
        self._λ = scale * self._anderson.next(self._λ / scale, change / scale)
        self._multipliers.set(self._λ)

    def _choose_scales(self, first_change: Array) -> None:
        """Scale each field by its largest first change, so that fields may differ in unit.

        Collective.
        """
        scales = np.split(self._scale, self._multipliers.ends)
        changes = np.split(first_change, self._multipliers.ends)
        for scale, change in zip(scales, changes, strict=True):
            largest = max_norm(self._multipliers.comm, change)
            scale[:] = 1.0 if largest == 0.0 else largest

    def failure(self) -> str:
        """Return the message of volumes that are not kept, with the remedy."""
        return (
            f"the mean volume of a cell is still off by {self.violations[-1]:.1e}: take a larger "
            "κ, with which the multipliers converge faster, or a larger volume_tolerance than "
            f"{self._tolerance:g}"
        )
