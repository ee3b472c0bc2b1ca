# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The wall without load of one that is known under load, as in a scan (docs/scan.md).

Wanted are the nodes X of the wall without load, X + u(X) = x, of nodes x of the image. U = x − X
is the fixed point :math:`U^{k+1} = u(x - U^k)` of Sellier (2011) and Bols et al. (2013), with
Anderson's acceleration, and the unknown of a path that ``follow_load`` follows. The mesh moves in
place (``fem.nodes``), to X where something is assembled, and back to the image.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import dolfinx
import ufl

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.fem.nodes import Nodes, diameter
from dolfinx_feti.loading.fixed_point import MOST, FixedPoint
from dolfinx_feti.loading.load_steps import INADMISSIBLE, follow_load
from dolfinx_feti.loading.stepper import loosened
from dolfinx_feti.loading.steps import LoadStep, Steps
from dolfinx_feti.problems.nonlinear_problem import NonlinearProblem
from dolfinx_feti.problems.system import Tangent
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.compat import interpolation_points

__all__ = ["unload"]

#: What a forward solve leaves of its residual, and a linear solve in it, until the wall is found.
#: Where κ is large nearly all of the residual is of the volume, and a rougher one would be blind.
ROUGH, LINEAR = 0.1, 1e-5

#: Halvings of a step that turns cells inside out.
HALVINGS = 5


def unload(
    problem: NonlinearProblem,
    set_load: Callable[[float], object],
    targets: Sequence[float],
    steps: Steps,
    *,
    fibres: Sequence[dolfinx.fem.Function] = (),
    tolerance: float = 1e-7,
    on_move: Callable[[], object] | None = None,
    **options: Any,
) -> list[LoadStep]:
    """Move the mesh, that of a wall under load, to where the wall is without it. Collective.

    Afterwards the forms of the problem are those of the unloaded wall, and u is the displacement
    that leads to the image. At the loads on the way the mesh is the image, and u leads to it from
    the wall that would be without load if the image were of that load.

    Args:
        problem: The nonlinear problem, with u in a space of displacements.
        set_load: Sets the load in the user's forms.
        targets: Loads on the way; the last one is that of the image.
        steps: How to choose the increments. Each load takes two to five Newton steps, which counts
            in ``quick``.
        fibres: Unit vectors in the image, Functions of the mesh that the forms use: they follow
            into the unloaded wall, a ← F⁻¹ a / ‖F⁻¹ a‖.
        tolerance: How far a node of the loaded wall may be from the image, over the diagonal of
            the box around that; on the way, so far or as large a share of u as ``steps.rtol``.
        on_move: Called on all processes when the mesh and the fibres have moved, to the unloaded
            wall or back to the image, for what else depends on the mesh's shape.
        options: Others of :func:`~dolfinx_feti.loading.load_steps.follow_load`: ``start``, where u
            and a condensed pressure are zero, ``state``, ``on_step``, ``checkpoint``, ``unit``.

    Returns:
        The accepted steps; their histories hold the Newton steps of all forward solves.

    Raises:
        ValueError: The tolerance is not positive.
        ConvergenceError: No step of the least increment leads on; the mesh is the image.

    Source: M. Sellier, J. Fluids Struct. 27 (2011); J. Bols et al., J. Comput. Appl. Math. 246
    (2013).
    """
    if not tolerance > 0.0:
        raise ValueError(f"tolerance is {tolerance}: give a positive share of the diameter.")
    unloading = _Unloading(problem, fibres, tolerance, on_move)
    accepted = follow_load(unloading, set_load, targets, steps, **options)
    try:
        unloading.move()
    except BaseException:
        unloading.move(back=True)
        raise
    return accepted


class _Unloading(FixedPoint):
    """The problem of the unloaded wall, with U = x − X, of all nodes, as its unknown u."""

    def __init__(
        self,
        problem: NonlinearProblem,
        fibres: Sequence[dolfinx.fem.Function],
        tolerance: float,
        on_move: Callable[[], object] | None,
    ) -> None:
        super().__init__(problem)
        mesh = self.u.function_space.mesh
        self._nodes = Nodes(mesh)
        self._fibres = [(a, a.x.array.copy(), _pulled_back(a, problem.u)) for a in fibres]
        self._tolerance, self._on_move = tolerance * diameter(mesh), on_move

    def residual_norm(self) -> float:
        """Return ‖r‖ of the loaded wall in the image."""
        with self._moved():
            return self._problem.residual_norm()

    def linearise(self) -> Tangent:
        """Assemble the forward problem's tangent."""
        with self._moved():
            return self._problem.linearise()

    def move(self, *, back: bool = False) -> None:
        """Move mesh and fibres to the unloaded wall, or back to the image."""
        x, image = self._nodes.mesh.geometry.x, self._nodes.initial
        x[:] = image if back else image - self._nodes.displacement(self.u)
        for a, in_image, pulled_back in self._fibres:
            a.x.array[:] = in_image
            if not back:
                a.interpolate(pulled_back)
                a.x.scatter_forward()
        if self._on_move is not None:
            on_all(self._on_move, self._comm)

    @contextmanager
    def _moved(self) -> Iterator[None]:
        """Let the mesh be the unloaded wall, and then the image again."""
        try:
            self.move()
            yield
        finally:
            self.move(back=True)

    def _iterate(self, reference: float | None, options: dict[str, Any]) -> None:
        """Iterate until the loaded wall is the image, and in equilibrium."""
        anderson = self._anderson(self.u)
        nodes, close, distance = self._nodes, False, math.inf
        rtol = self.solver.getTolerances()[0]
        last: Array | None = None  # U of the solve before
        self._step(self.u.x.array, self.u.x.array, halvings=1)  # the prediction is admissible
        for _ in range(MOST):
            U = self.u.x.array.copy()
            rough = {"rtol": ROUGH, "linear_rtol": LINEAR}
            tolerances = {"atol": rtol * (reference or 0.0)} if close else rough
            with self._moved(), loosened(self.solver, **tolerances):
                try:
                    self._solve(**options)
                except ConvergenceError:
                    if last is None or self.solver.getConvergedReason() != INADMISSIBLE:
                        raise
                    self.u.x.array[:] = (U + last) / 2.0
                    continue
                loaded = nodes.mesh.geometry.x + nodes.displacement(self.u)
            distance = nodes.longest(loaded - nodes.initial)
            moved = nodes.longest(nodes.displacement(self.u))
            reached = distance <= max(self._tolerance, rtol * moved)
            if reached and close:
                return
            if not reached:
                self._step(U, anderson.next(U, self.u.x.array - U))
            if reference is None:
                reference = self.history[0].residual
            options, close, last = {"renew": False}, reached, U
        raise ConvergenceError(
            f"{MOST} forward solves did not find the unloaded wall: the loaded one is "
            f"{distance:.1e} off the image. Load in smaller steps."
        )

    def _step(self, U: Array, new: Array, halvings: int = HALVINGS) -> None:
        """Go from U to new, or as far as no cell of the unloaded wall turns inside out."""
        for halving in range(halvings):
            self.u.x.array[:] = U + (new - U) / 2**halving
            if not (inverted := self._inverted()):
                return
        self.solver.setConvergedReason(INADMISSIBLE)
        raise ConvergenceError(
            f"{inverted} cells of the unloaded wall would be inside out. Load in smaller steps."
        )

    def _inverted(self) -> int:
        """Count the cells of the unloaded wall that are inside out."""
        x = self._nodes.mesh.geometry.x
        x[:] = self._nodes.initial - self._nodes.displacement(self.u)
        inverted = self._nodes.inverted()
        x[:] = self._nodes.initial
        return inverted


def _pulled_back(a: dolfinx.fem.Function, u: dolfinx.fem.Function) -> dolfinx.fem.Expression:
    """Return F⁻¹ a / ‖F⁻¹ a‖."""
    F = ufl.Identity(len(u)) + ufl.grad(u)
    A = ufl.inv(F) * a
    points = interpolation_points(a.function_space)
    return dolfinx.fem.Expression(A / ufl.sqrt(ufl.inner(A, A)), points)
