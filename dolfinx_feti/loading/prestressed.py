# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Prestress of a wall that was imaged under load; the wall without load is not computed.

With the inverse G of the deformation that leads to the image
(:mod:`~dolfinx_feti.mechanics.residual_stress`),

.. math:: F_e = F\, G^{-1}, \qquad Π = \int Ψ(F_e)\, \det G \,\mathrm d x, \qquad
    G \leftarrow G\, F(u)^{-1}, \qquad u \leftarrow 0

after each solve: the modified updated Lagrangian formulation of Gee, Förster and Wall (2010), a
fixed point of G, accelerated by Anderson's method, along a path of loads (docs/prestress.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.internal_variables import create_internal_variables
from dolfinx_feti.fem.nodes import diameter
from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.loading.fixed_point import MAX_SOLVES, FixedPoint
from dolfinx_feti.loading.load_step import LoadStep
from dolfinx_feti.loading.load_steps import follow_load
from dolfinx_feti.loading.steps import Steps
from dolfinx_feti.problems.nonlinear_problem import NonlinearProblem
from dolfinx_feti.problems.solvers import relative_tolerance
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.values import require_sequence, require_type

__all__ = ["prestress"]


def prestress(
    problem: NonlinearProblem,
    set_load: Callable[[float], object],
    targets: Sequence[float],
    steps: Steps,
    *,
    G: dolfinx.fem.Function,
    tolerance: float = 1e-8,
    state: Sequence[dolfinx.fem.Function] = (),
    start: float = 0.0,
    unloading: bool = False,
    on_step: Callable[[LoadStep], object] | None = None,
    checkpoint: Checkpoint | None = None,
    unit: str = "",
) -> list[LoadStep]:
    """Compute the G for which a wall under load is in balance at u = 0. Collective.

    Afterwards ``follow_load`` can continue from the last load with the same problem. Internal
    variables stay as they are. Arguments that
    :func:`~dolfinx_feti.loading.load_steps.follow_load` has, too, mean the same. Source: M. W. Gee,
    C. Förster, W. A. Wall, International Journal for Numerical Methods in Biomedical Engineering 26
    (2010).

    Args:
        problem: The nonlinear problem, with energies in F G⁻¹ per volume of the image, and zero as
            the value of all Dirichlet conditions of u.
        set_load: Sets the load in the user's forms.
        targets: Loads on the way; the last one is that of the image.
        steps: How to choose the increments. ``quick`` counts the Newton steps of all solves of a
            load.
        G: Inverse of the deformation that leads to the image, a Function of discontinuous elements
            (("DG", k − 1) for u of degree k) or of quadrature points, shape (d, d); the identity
            at ``start``.
        tolerance: Largest displacement of the last solve, relative to the diagonal of the box
            around the wall. At loads that are no targets, ``steps.rtol`` times the displacement of
            the load's first solve is allowed, if that is larger.
        state: Functions that a solve changes in addition to u, condensed fields and G.
        start: The present load, at which u and a condensed pressure are zero.
        unloading: Whether the load may turn back on its way through the targets.
        on_step: Called in each new equilibrium on all processes.
        checkpoint: Where each new equilibrium is written.
        unit: Name of the unit of the load.

    Returns:
        The accepted steps; their histories hold the Newton steps of all solves.

    Raises:
        TypeError: G is no Function, or another argument has a wrong type.
        ValueError: The tolerance is not positive, or G has another shape, dofs that cells share, or
            det G ≤ 0 somewhere.
        ConvergenceError: A step of the least increment failed.
    """
    require_type(NonlinearProblem, problem=problem)
    require_type(dolfinx.fem.Function, G=G)
    require_sequence(dolfinx.fem.Function, state=state)
    if not tolerance > 0.0:
        raise ValueError(f"tolerance is {tolerance}: give a positive share of the diameter.")
    on_all(lambda: _check(G, problem.unknown), problem.unknown.function_space.mesh.comm)
    prestressing = _Prestressing(problem, G, tolerance)
    return follow_load(
        prestressing,
        set_load,
        targets,
        steps,
        state=[*state, G],
        start=start,
        unloading=unloading,
        on_step=on_step,
        checkpoint=checkpoint,
        unit=unit,
    )


class _Prestressing(FixedPoint):
    """Balance of the image: a fixed point in G, with u = 0 at the end."""

    def __init__(
        self, problem: NonlinearProblem, G: dolfinx.fem.Function, tolerance: float
    ) -> None:
        """Create the fixed point; see :func:`prestress`. Collective."""
        super().__init__(problem)
        self._tolerance = tolerance * diameter(self.u.function_space.mesh)
        F = ufl.Identity(len(self.u)) + ufl.grad(self.u)
        self._G = G
        self._update = create_internal_variables({G: G * ufl.inv(F)}, Compiler(self._comm))

    def _iterate(self, reference: float | None) -> None:
        """Solve, and update G by the displacement, until a solve moves the wall no more."""
        anderson = self._anderson(self._G)
        rtol = relative_tolerance(self.solver)  # ``Steps.rtol`` at loads that are no targets
        allowed = self._tolerance
        moved = 0.0
        for i in range(MAX_SOLVES):
            self._solve(reference)
            moved = self._longest_displacement()
            if i == 0:
                allowed = max(self._tolerance, rtol * moved)
            G = self._G.x.array.copy()
            self._update.update()  # G ← G F⁻¹
            self.u.x.array[:] = 0.0
            if moved <= allowed:
                return
            self._G.x.array[:] = anderson.next(G, self._G.x.array - G)
            if reference is None:
                reference = self.history[0].residual
        raise ConvergenceError(
            f"{MAX_SOLVES} solves did not balance the image: the last one moved it by {moved:.1e}. "
            "Load in smaller steps."
        )

    def _longest_displacement(self) -> float:
        """Return the length of the longest displacement of a dof. Collective."""
        lengths = np.linalg.norm(self.u.x.array.reshape(-1, len(self.u)), axis=1)
        return self._comm.allreduce(float(lengths.max(initial=0.0)), op=MPI.MAX)


def _check(G: dolfinx.fem.Function, u: dolfinx.fem.Function) -> None:
    """Check that G has the shape of Grad u and can be inverted.

    Raises:
        ValueError: G has another shape, or det G ≤ 0 at a dof of this process.
    """
    d = len(u)
    if G.ufl_shape != (d, d):
        raise ValueError(f"G has the shape {G.ufl_shape}: give a Function of the shape {(d, d)}.")
    smallest = np.linalg.det(G.x.array.reshape(-1, d, d)).min(initial=np.inf)
    if not smallest > 0.0:
        raise ValueError(f"det G = {smallest:.3g} somewhere: let G be the identity at first.")
