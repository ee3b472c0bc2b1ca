# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Prestress of a wall that is known under load, as in a scan, without the wall that has no load.

With the inverse G of what leads to the image, as in :mod:`~dolfinx_feti.mechanics.residual_stress`,

.. math:: F_e = F\, G^{-1}, \qquad Π = \int Ψ(F_e)\, \det G \,\mathrm d x, \qquad
    G \leftarrow G\, F(u)^{-1}, \qquad u \leftarrow 0

after each solve: the modified updated Lagrangian formulation of Gee, Förster and Wall (2010), a
fixed point of G, accelerated by Anderson's method, along a path of loads (docs/prestress.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.internal_variables import create_internal_variables
from dolfinx_feti.fem.nodes import diameter
from dolfinx_feti.loading.fixed_point import MOST, FixedPoint
from dolfinx_feti.loading.load_steps import follow_load
from dolfinx_feti.loading.steps import LoadStep, Steps
from dolfinx_feti.problems.nonlinear_problem import NonlinearProblem
from dolfinx_feti.runtime.collective import on_all

__all__ = ["prestress"]


def prestress(
    problem: NonlinearProblem,
    set_load: Callable[[float], object],
    targets: Sequence[float],
    steps: Steps,
    *,
    G: dolfinx.fem.Function,
    tolerance: float = 1e-8,
    **options: Any,
) -> list[LoadStep]:
    """Find the G with which a wall under load is in balance where it is, u = 0. Collective.

    Afterwards ``follow_load`` goes on from the last load with the same problem.

    Args:
        problem: The nonlinear problem, with energies in F G⁻¹ per volume of the image, and zero as
            the value of all Dirichlet conditions of u.
        set_load: Sets the load in the user's forms.
        targets: Loads on the way; the last one is that of the image.
        steps: How to choose the increments. Each load takes several Newton steps, which counts in
            ``quick``.
        G: Inverse of the deformation that leads to the image, a Function of discontinuous elements
            (("DG", k − 1) for u of degree k) or of points of quadrature, shape (d, d); the identity
            at ``start``.
        tolerance: How far a solve may still move the wall, over the diagonal of the box around it;
            on the way, so far or as large a share of the load's first displacement as
            ``steps.rtol``.
        options: Others of ``follow_load``: ``start``, where u and a condensed pressure are zero,
            ``state``, ``on_step``, ``checkpoint``, ``unit``.

    Returns:
        The accepted steps; their histories hold the Newton steps of all solves.

    Raises:
        TypeError: G is no Function.
        ValueError: The tolerance is not positive, or G has another shape, dofs that cells share, or
            det G ≤ 0 somewhere.
        ConvergenceError: No step of the least increment leads on.

    Internal variables stay as they are. Source: M. W. Gee, C. Förster, W. A. Wall, International
    Journal for Numerical Methods in Biomedical Engineering 26 (2010).
    """
    if not tolerance > 0.0:
        raise ValueError(f"tolerance is {tolerance}: give a positive share of the diameter.")
    on_all(lambda: _check(G, problem.u), problem.u.function_space.mesh.comm)
    options["state"] = [*options.get("state", ()), G]
    return follow_load(_Prestressing(problem, G, tolerance), set_load, targets, steps, **options)


class _Prestressing(FixedPoint):
    """The problem of the image's balance, with G as its unknown, and u = 0 at the end."""

    def __init__(
        self, problem: NonlinearProblem, G: dolfinx.fem.Function, tolerance: float
    ) -> None:
        super().__init__(problem)
        self._tolerance = tolerance * diameter(self.u.function_space.mesh)
        F = ufl.Identity(len(self.u)) + ufl.grad(self.u)
        self._G = G
        self._update = create_internal_variables({G: G * ufl.inv(F)}, Compiler(self._comm))

    def _iterate(self, reference: float | None, options: dict[str, Any]) -> None:
        """Solve, and take the wall back to the image, until it stays there."""
        anderson = self._anderson(self._G)
        allowed = 0.0
        for _ in range(MOST):
            self._solve(reference=reference, **options)
            moved, before = self._moved(), self._G.x.array.copy()
            self._update.update()  # G ← G F⁻¹
            self.u.x.array[:] = 0.0
            allowed = allowed or max(self._tolerance, self.solver.getTolerances()[0] * moved)
            if moved <= allowed:
                return
            self._G.x.array[:] = anderson.next(before, self._G.x.array - before)
            if reference is None:
                reference = self.history[0].residual
            options = {"renew": False}
        raise ConvergenceError(
            f"{MOST} solves did not balance the image: the last one moved it by {moved:.1e}. "
            "Load in smaller steps."
        )

    def _moved(self) -> float:
        """Return the length of the longest displacement of a dof."""
        lengths = np.linalg.norm(self.u.x.array.reshape(-1, len(self.u)), axis=1)
        return self._comm.allreduce(float(lengths.max(initial=0.0)), op=MPI.MAX)


def _check(G: dolfinx.fem.Function, u: dolfinx.fem.Function) -> None:
    """Require a Function with the shape of grad u that can be inverted."""
    d = len(u)
    if G.ufl_shape != (d, d):
        raise ValueError(f"G has the shape {G.ufl_shape}: give a Function of the shape {(d, d)}.")
    least = np.linalg.det(G.x.array.reshape(-1, d, d)).min(initial=np.inf)
    if not least > 0.0:
        raise ValueError(f"det G = {least:.3g} somewhere: let G be the identity at first.")
