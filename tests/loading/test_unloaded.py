# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The wall without load: what is unloaded and loaded again is the image."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from walls import Wall, fibres, tube, wall

import ufl

from dolfinx_feti import ConvergenceError, NonlinearProblem, loads
from dolfinx_feti.fem.nodes import Nodes
from dolfinx_feti.loading import Checkpoint, LoadStep, Steps, follow_load, unload
from dolfinx_feti.loading.load_steps import INADMISSIBLE
from dolfinx_feti.output import cell_values

#: Each load takes more than one forward solve.
STEPS = Steps(first=10.0, least=1.0, rtol=1e-3, quick=8)


def cost(steps: list[LoadStep]) -> tuple[int, int]:
    """Count load steps and Newton steps, those of failed attempts included."""
    return sum(1 + step.failures for step in steps), sum(len(step.all_steps) for step in steps)


class Scan:
    """A small tube, imaged under pressure."""

    def __init__(self, degree: int = 1, length: float = 1.0) -> None:
        self.body: Wall = wall(tube(around=6, along=2), degree=degree)
        self.mesh = self.body.u.function_space.mesh
        self.problem: NonlinearProblem = self.body.problem(4)
        self.mesh.geometry.x[:] *= length
        self.nodes = Nodes(self.mesh)

    def set_load(self, pressure: float) -> None:
        self.body.load.value = loads.mmhg(pressure)

    def rest(self) -> None:
        self.set_load(0.0)
        self.body.u.x.array[:] = 0.0
        self.body.p.x.array[:] = 0.0

    def inflate(self, target: float) -> tuple[int, int]:
        """Return what it took."""
        return cost(follow_load(self.problem, self.set_load, [target], STEPS))

    def unload(self, *targets: float, steps: Steps = STEPS, **options: object) -> list[LoadStep]:
        return unload(self.problem, self.set_load, targets, steps, **options)

    def distance(self) -> float:
        """How far the loaded wall is from the image [mm]."""
        loaded = self.mesh.geometry.x + self.nodes.displacement(self.body.u)
        return self.nodes.longest(loaded - self.nodes.initial)


@pytest.mark.processes(1, 2)
@pytest.mark.parametrize("degree", [1, 2])
def test_loaded_again_it_is_the_image(degree):
    """For quadratic displacements on straight cells, too, at the nodes of the mesh."""
    scan = Scan(degree)
    inflation = scan.inflate(40.0)
    scan.rest()
    steps = scan.unload(40.0)
    for spent, once in zip(cost(steps), inflation, strict=True):
        agree(spent <= 3 * once, (cost(steps), inflation))
    agree(scan.nodes.longest(scan.mesh.geometry.x - scan.nodes.initial) > 0.01)
    small(scan.distance(), 1e-12)  # u leads to the image
    scan.rest()
    scan.inflate(40.0)
    small(scan.distance(), 1e-6)


def test_fibres_follow():
    """F A has the direction of the image's fibre in each cell, and A is a unit vector."""
    scan = Scan()
    a = fibres(scan.mesh, 1.0)
    image = a.x.array.copy()
    moves = []
    scan.unload(
        10.0,
        fibres=[a],
        on_move=lambda: moves.append(scan.nodes.longest(scan.mesh.geometry.x - scan.nodes.initial)),
    )
    F = ufl.Identity(3) + ufl.grad(scan.body.u)
    pushed, length = (cell_values(e, scan.mesh) for e in (F * a, ufl.sqrt(ufl.inner(a, a))))
    equal(length, np.ones_like(length), 1e-12)
    pushed /= np.linalg.norm(pushed, axis=1, keepdims=True)
    equal(pushed, image.reshape(-1, 3)[: len(pushed)], 1e-12)
    agree(moves[0] == 0.0 and moves[-1] > 0.0, moves)
    agree(all(moved == 0.0 for moved in moves[1::2]), moves)  # back to the image


@pytest.mark.processes(1, 2)
def test_path_that_goes_on(tmp_path):
    """Its last part is that of one in one piece; the checkpoint is one of the image."""
    folder = Path(COMM.bcast(tmp_path)) / "run"
    pieces, whole = Scan(), Scan()
    for targets, restart in (([10.0], False), ([10.0, 20.0], True)):
        pieces = Scan()
        pieces.unload(*targets, checkpoint=Checkpoint(folder, COMM, restart=restart))
    whole.unload(10.0, 20.0)
    equal(pieces.mesh.geometry.x, whole.mesh.geometry.x, 1e-6)


def test_steps_are_the_same_in_any_unit_of_length():
    """In millimetres, metres and micrometres."""
    lengths = (1.0, 1e-3, 1e3)
    scans = [Scan(length=length) for length in lengths]
    taken = [[len(step.all_steps) for step in scan.unload(20.0)] for scan in scans]
    agree(taken[1] == taken[0] and taken[2] == taken[0], taken)
    for scan, length in zip(scans, lengths, strict=True):
        equal(scan.mesh.geometry.x / length, scans[0].mesh.geometry.x, 1e-7)


@pytest.mark.processes(1, 2)
def test_failure_leaves_the_image():
    """A wall that nothing unloads in one step: mesh, load and displacement are the last good."""
    scan, seen = Scan(), []
    with raises(ConvergenceError, "No equilibrium was found beyond a load of 0"):
        scan.unload(
            4e4,
            steps=Steps(first=4e4, least=2e4),
            on_move=lambda: seen.append(scan.mesh.geometry.x.copy()),
        )
    equal(scan.mesh.geometry.x, scan.nodes.initial)
    equal(seen[-1], scan.nodes.initial)
    agree(float(scan.body.load.value) == 0.0 and not scan.body.u.x.array.any())


@pytest.mark.processes(1, 2)
def test_failure_of_the_last_move_leaves_the_image():
    """When on_move raises after the last solve; it is called once more, for the image."""
    moves = []
    Scan().unload(10.0, on_move=lambda: moves.append(None))
    scan, last = Scan(), len(moves)
    moves.clear()

    def on_move() -> None:
        moves.append(scan.mesh.geometry.x.copy())
        if len(moves) == last and COMM.rank == COMM.size - 1:
            raise ZeroDivisionError("the last move")

    with raises(ZeroDivisionError, "the last move"):
        scan.unload(10.0, on_move=on_move)
    agree(len(moves) == last + 1 and np.any(moves[-2] != scan.nodes.initial))
    equal(moves[-1], scan.nodes.initial)
    equal(scan.mesh.geometry.x, scan.nodes.initial)


def test_inverted_cells_are_counted():
    scan = Scan()
    agree(scan.nodes.inverted() == 0)
    scan.mesh.geometry.x[:, 0] *= -1.0
    agree(scan.nodes.inverted() == scan.mesh.topology.index_map(3).size_global)


def test_cell_inside_out_on_the_way(monkeypatch):
    """A guess that a solve cannot begin with is taken back by half, and the wall is found."""
    scan, calls = Scan(), []
    solve = scan.problem.solve

    def refuse_second(**arguments):
        calls.append(scan.body.u.x.array.copy())
        if len(calls) == 2:
            scan.problem.solver.setConvergedReason(INADMISSIBLE)
            raise ConvergenceError("a cell is inside out")
        solve(**arguments)

    monkeypatch.setattr(scan.problem, "solve", refuse_second)
    (step,) = scan.unload(10.0)
    agree(step.failures == 0 and step.load == 10.0)
    equal(calls[2], (calls[0] + calls[1]) / 2, 1e-15)
    small(scan.distance(), 1e-12)
