# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What a linear and a nonlinear problem share: another solver of their torn system, a diagnosis."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.diagnosis.advice import Advice
from dolfinx_feti.diagnosis.result import Diagnosis
from dolfinx_feti.diagnosis.run import diagnose
from dolfinx_feti.fem.condensation import Blocks, Condensation
from dolfinx_feti.fem.decomposition import Decomposition
from dolfinx_feti.problems.solvers import create_solver
from dolfinx_feti.runtime.collective import on_all

__all__ = ["TornProblem"]


class TornProblem:
    """A problem whose linear systems are torn.

    Attributes:
        A: The torn matrix.
        decomposition: Subdomain of each owned cell.
    """

    A: PETSc.Mat
    decomposition: Decomposition
    _prefix: str
    _petsc_options: dict[str, object]
    _condensation: Condensation | None = None

    def linear_system(self) -> tuple[PETSc.Mat, PETSc.Vec]:
        """Assemble the torn system of the next solve.

        Returns:
            A, which stays the problem's own, and b, which the caller destroys.

        Note:
            Collective.
        """
        raise NotImplementedError

    @property
    def condenses(self) -> bool:
        """Whether fields are condensed."""
        return self._condensation is not None

    def condensed_blocks(self) -> tuple[npt.NDArray[np.int32], Blocks]:
        """Assemble what was condensed into the matrix, at the present state.

        Returns:
            Global dofs of u in each owned cell, (cells, d), and the blocks K_up, K_pp⁻¹ K_pu and
            K_pp⁻¹ r_p there.

        Raises:
            ValueError: Nothing is condensed.

        Note:
            Collective.
        """
        if self._condensation is None:
            raise ValueError("No field of this problem is condensed.")
        torn = self._condensation.dofs()
        dofs = self.A.getLGMap()[0].apply(torn.ravel()).reshape(torn.shape)
        return dofs, on_all(self._condensation.assemble, self.A.comm.tompi4py())

    def _approximation(self) -> npt.NDArray[np.float64] | float:
        """Return the x of the present state, (owned,), or one value for all."""
        return 0.0

    def _known_advice(self) -> tuple[Advice, ...]:
        """Return what earlier solves have found."""
        return ()

    def create_linear_solver(self) -> PETSc.KSP:
        """Create another FETI solver of A, with the options of this problem.

        Returns:
            A KSP that has set up nothing yet; the caller destroys it.

        Raises:
            ValueError: An option has a wrong value.

        Note:
            Collective.
        """
        return create_solver(self.A, self._prefix, self._petsc_options)

    def diagnose(self) -> Diagnosis:
        """Measure what FETI builds for the next linear system and what its time goes into.

        It is assembled anew and solved once more, by another solver with the same options. PETSc's
        logging is begun if it is not, for the times.

        Returns:
            The diagnosis: ``print`` it, take its ``records``, or ``plot`` it.

        Note:
            Collective.
        """
        return diagnose(
            self.linear_system,
            self.create_linear_solver,
            state=self._approximation(),
            decomposition=self.decomposition,
            prefix=self._prefix,
            known=self._known_advice(),
        )
