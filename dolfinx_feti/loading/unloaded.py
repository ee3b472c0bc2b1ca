# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The unloaded shape of a wall that was imaged under load, as in a scan (docs/scan.md).

Let x be the nodes of the image. The nodes X of the unloaded wall satisfy X + u(X) = x, where u(X)
is the displacement under the load of the image. U = x − X is the fixed point

.. math:: U^{k+1} = u(x - U^k)

of Sellier (2011) and Bols et al. (2013), accelerated by Anderson's method. A path that
``follow_load`` follows has U as its unknown. The mesh moves in place (``fem.nodes``): to X while
forms are assembled, and back to the image afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import dolfinx
import ufl

from dolfinx_feti.errors import ConvergenceError, InadmissibleStartError
from dolfinx_feti.fem.nodes import Nodes, diameter
from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.loading.fixed_point import MAX_SOLVES, FixedPoint
from dolfinx_feti.loading.load_step import LoadStep
from dolfinx_feti.loading.load_steps import follow_load
from dolfinx_feti.loading.steps import Steps
from dolfinx_feti.loading.tolerances import loose_tolerances
from dolfinx_feti.problems.equations.tangent import TangentId
from dolfinx_feti.problems.nonlinear_problem import NonlinearProblem
from dolfinx_feti.problems.solvers import relative_tolerance
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.compat import interpolation_points
from dolfinx_feti.runtime.values import require_sequence, require_type

__all__ = ["unload"]

#: Relative tolerance of forward solves whose loaded wall is not yet the image: their shape changes
#: in the next iteration anyway. The last forward solve has the tolerance of the problem. It is a
#: choice, not measured.
FORWARD_RTOL = 0.1

#: Relative tolerance of the linear solves in those forward solves. With a large κ nearly all of the
#: residual is due to changes of volume: a looser solve meets its tolerance by reducing that part
#: alone.
FORWARD_LINEAR_RTOL = 1e-5

#: Trials of a step of U that turns cells inside out, each half as long as the one before. If even a
#: 16th of the step is too long, the load step fails and is halved.
MAX_TRIALS = 5

_INVERTED = "{0} cells of the unloaded wall would be inside out. Load in smaller steps."


def unload(
    problem: NonlinearProblem,
    set_load: Callable[[float], object],
    targets: Sequence[float],
    steps: Steps,
    *,
    fibres: Sequence[dolfinx.fem.Function] = (),
    tolerance: float = 1e-7,
    on_move: Callable[[], object] | None = None,
    state: Sequence[dolfinx.fem.Function] = (),
    start: float = 0.0,
    unloading: bool = False,
    on_step: Callable[[LoadStep], object] | None = None,
    checkpoint: Checkpoint | None = None,
    unit: str = "",
) -> list[LoadStep]:
    """Move the mesh of a wall under load to the shape of the unloaded wall. Collective.

    Afterwards the forms of the problem are those of the unloaded wall, and u is the displacement
    that leads to the image. In ``on_step``, at loads on the way, the mesh is the image, and u leads
    to it from the shape that would be unloaded if the image had been taken at that load. Arguments
    that :func:`~dolfinx_feti.loading.load_steps.follow_load` has, too, mean the same.

    Args:
        problem: The nonlinear problem, with u in a space of displacements.
        set_load: Sets the load in the user's forms.
        targets: Loads on the way; the last one is that of the image.
        steps: How to choose the increments. ``quick`` counts the Newton steps of all forward solves
            of a load, two to five as a rule.
        fibres: Directions in the image, unit vectors, as Functions that the forms contain. They are
            pulled back to the unloaded wall, a ← F⁻¹ a / ‖F⁻¹ a‖.
        tolerance: Largest distance of a node of the loaded wall from the image, relative to the
            diagonal of the box around the image. At loads that are no targets, ``steps.rtol`` times
            the largest displacement is allowed, if that is larger.
        on_move: Called on all processes after the mesh and the fibres have moved, to the unloaded
            wall or back to the image, to update other data that depend on the mesh.
        state: Functions that a solve changes in addition to u and condensed fields.
        start: The present load, at which u and a condensed pressure are zero.
        unloading: Whether the load may turn back on its way through the targets.
        on_step: Called in each new equilibrium on all processes.
        checkpoint: Where each new equilibrium is written.
        unit: Name of the unit of the load.

    Returns:
        The accepted steps; their histories hold the Newton steps of all forward solves.

    Raises:
        TypeError: An argument has a wrong type.
        ValueError: The tolerance is not positive.
        ConvergenceError: A step of the least increment failed; the mesh is the image.

    Source: M. Sellier, J. Fluids Struct. 27 (2011); J. Bols et al., J. Comput. Appl. Math. 246
    (2013).
    """
    require_type(NonlinearProblem, problem=problem)
    require_sequence(dolfinx.fem.Function, fibres=fibres)
    if not tolerance > 0.0:
        raise ValueError(f"tolerance is {tolerance}: give a positive share of the diameter.")
    fixed_point = _Unloading(problem, fibres, tolerance, on_move)
    accepted = follow_load(
        fixed_point,
        set_load,
        targets,
        steps,
        state=state,
        start=start,
        unloading=unloading,
        on_step=on_step,
        checkpoint=checkpoint,
        unit=unit,
    )
    try:
        fixed_point.move_to_unloaded()
    except BaseException:
        fixed_point.move_to_image()
        raise
    return accepted


class _Unloading(FixedPoint):
    """The unloaded shape as a fixed point in U = x − X, whose values are those of the unknown u."""

    def __init__(
        self,
        problem: NonlinearProblem,
        fibres: Sequence[dolfinx.fem.Function],
        tolerance: float,
        on_move: Callable[[], object] | None,
    ) -> None:
        """Create the fixed point; see :func:`unload`. Collective."""
        super().__init__(problem)
        mesh = self.u.function_space.mesh
        self._nodes = Nodes(mesh)
        self._fibres = [_FibreDirections(a, self.u) for a in fibres]
        self._tolerance = tolerance * diameter(mesh)
        self._on_move = on_move

    def residual_norm(self) -> float:
        """Return ‖r‖ of the forward problem. Collective."""
        with self._on_unloaded_mesh():
            return self._problem.residual_norm()

    def linearise(self) -> TangentId:
        """Assemble the tangent of the forward problem. Collective."""
        with self._on_unloaded_mesh():
            return self._problem.linearise()

    def warn_of_cells(self) -> None:
        """Warn of distorted cells of the loaded wall. Collective."""
        with self._on_unloaded_mesh():
            self._problem.warn_of_cells()

    def move_to_unloaded(self) -> None:
        """Move mesh and fibres to the unloaded wall of the present U. Collective."""
        self._nodes.mesh.geometry.x[:] = self._unloaded_nodes()
        for directions in self._fibres:
            directions.pull_back()
        self._call_on_move()

    def move_to_image(self) -> None:
        """Move mesh and fibres to the image. Collective."""
        self._nodes.mesh.geometry.x[:] = self._nodes.initial
        for directions in self._fibres:
            directions.restore()
        self._call_on_move()

    def _call_on_move(self) -> None:
        if self._on_move is not None:
            on_all(self._on_move, self._comm)

    @contextmanager
    def _on_unloaded_mesh(self) -> Iterator[None]:
        """Move the mesh to the unloaded wall, and back to the image at the end. Collective."""
        try:
            self.move_to_unloaded()
            yield
        finally:
            self.move_to_image()

    def _unloaded_nodes(self) -> Array:
        """Return X = x − U, (nodes, 3). Collective."""
        return self._nodes.initial - self._nodes.displacement(self.u)

    def _iterate(self, reference: float | None) -> None:
        """Iterate U until the loaded wall is the image, and in equilibrium.

        Forward solves have a loose tolerance until the loaded wall is the image. One with the
        problem's own tolerance follows; if its loaded wall is off the image, the iteration goes on.
        If a cell of the loaded wall is inside out at the start of a solve, the iteration goes back
        to the mean of U and the last U whose solve converged: the step of U was too long.
        """
        anderson = self._anderson(self.u)
        was_image = False  # whether the loaded wall of the last solve was the image
        distance = math.inf
        last_U: Array | None = None  # of the last solve that converged
        self._require_admissible_prediction()
        for _ in range(MAX_SOLVES):
            U = self.u.x.array.copy()
            try:
                distance, is_image = self._solve_forward(reference, is_last=was_image)
            except InadmissibleStartError:
                if last_U is None:
                    raise
                self.u.x.array[:] = (U + last_U) / 2.0
                continue
            if is_image and was_image:
                return
            if not is_image:
                self._change_U(U, anderson.next(U, self.u.x.array - U))
            if reference is None:
                reference = self.history[0].residual
            was_image = is_image
            last_U = U
        raise ConvergenceError(
            f"{MAX_SOLVES} forward solves did not find the unloaded wall: the loaded one is "
            f"{distance:.1e} off the image. Load in smaller steps."
        )

    def _solve_forward(self, reference: float | None, *, is_last: bool) -> tuple[float, bool]:
        """Solve the forward problem from the unloaded wall of the present U. Collective.

        Args:
            reference: Residual norm that the problem's relative tolerance refers to; None if it is
                not known yet.
            is_last: Whether to solve with that tolerance.

        Returns:
            The largest distance of a node of the loaded wall from the image; True if that is within
            the tolerance.

        Raises:
            InadmissibleStartError: A cell of the loaded wall is inside out at the start.
            ConvergenceError: The solve failed.
        """
        nodes = self._nodes
        rtol = relative_tolerance(self.solver)
        if is_last and reference is not None:
            tolerances = {"atol": rtol * reference}
        else:
            tolerances = {"rtol": FORWARD_RTOL, "linear_rtol": FORWARD_LINEAR_RTOL}
        with self._on_unloaded_mesh(), loose_tolerances(self.solver, **tolerances):
            self._solve()
            loaded = nodes.mesh.geometry.x + nodes.displacement(self.u)  # X + u(X)
        distance = nodes.longest(loaded - nodes.initial)
        longest_displacement = nodes.longest(nodes.displacement(self.u))
        return distance, distance <= max(self._tolerance, rtol * longest_displacement)

    def _require_admissible_prediction(self) -> None:
        """Check that the unloaded wall of the present U has no cell inside out. Collective.

        Raises:
            InadmissibleStartError: It has one.
        """
        inverted = self._inverted_cells()
        if inverted > 0:
            raise InadmissibleStartError(_INVERTED.format(inverted))

    def _change_U(self, U: Array, U_next: Array) -> None:
        """Change U to U_next, or by a part of the difference that turns no cell inside out.

        Collective.

        Args:
            U: Present values of the unknown, with ghosts.
            U_next: The values to go to.

        Raises:
            InadmissibleStartError: Cells turn inside out with all of ``MAX_TRIALS`` lengths.
        """
        inverted = 0
        for halvings in range(MAX_TRIALS):
            self.u.x.array[:] = U + (U_next - U) / 2**halvings
            inverted = self._inverted_cells()
            if inverted == 0:
                return
        raise InadmissibleStartError(_INVERTED.format(inverted))

    def _inverted_cells(self) -> int:
        """Return the number of cells of the unloaded wall that are inside out. Collective."""
        x = self._nodes.mesh.geometry.x
        x[:] = self._unloaded_nodes()
        try:
            return self._nodes.inverted()
        finally:
            x[:] = self._nodes.initial


class _FibreDirections:
    """Directions a of fibres that move with the mesh, a ← F⁻¹ a / ‖F⁻¹ a‖."""

    def __init__(self, a: dolfinx.fem.Function, u: dolfinx.fem.Function) -> None:
        """Store the directions in the image.

        Args:
            a: The directions, unit vectors.
            u: Displacement from the unloaded wall to the image.
        """
        F = ufl.Identity(len(u)) + ufl.grad(u)
        A = ufl.inv(F) * a
        points = interpolation_points(a.function_space)
        self._a = a
        self._in_image = a.x.array.copy()
        self._pulled_back = dolfinx.fem.Expression(A / ufl.sqrt(ufl.inner(A, A)), points)

    def pull_back(self) -> None:
        """Set a to the directions in the unloaded wall, where the mesh is. Collective."""
        self.restore()
        self._a.interpolate(self._pulled_back)
        self._a.x.scatter_forward()

    def restore(self) -> None:
        """Set a to the directions in the image."""
        self._a.x.array[:] = self._in_image
