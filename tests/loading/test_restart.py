# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Load steps that go on from a checkpoint."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from collective import COMM, agree, equal, raises, small
from states import ROUNDING
from walls import Wall, tube, wall

from dolfinx_feti import loads
from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.loading.load_steps import follow_load
from dolfinx_feti.loading.steps import LoadStep, Steps


def follow(
    folder: Path,
    target: float,
    *,
    restart: bool,
    rtol: float | None = None,
    on_step: Callable[[LoadStep], object] | None = None,
    body: Wall | None = None,
):
    body = body or wall(tube(around=4, along=2), degree=1)
    steps = follow_load(
        body.problem(3),
        lambda mmhg: setattr(body.load, "value", loads.mmhg(mmhg)),
        [1.0, target],
        Steps(first=0.9, least=0.1, growth=1.3, rtol=rtol),
        checkpoint=Checkpoint(folder, COMM, restart=restart),
        on_step=on_step,
    )
    return steps, body


def interrupted(folder: Path, rtol: float | None = None) -> LoadStep:
    """Go on until the second step beyond 1 mmHg, which is not kept; return the first one."""
    beyond: list[LoadStep] = []

    def stop(step: LoadStep) -> None:
        if beyond:
            raise InterruptedError
        beyond.extend([step] * (step.load > 1.0))

    with raises(InterruptedError, ""):
        follow(folder, 3.0, restart=False, rtol=rtol, on_step=stop)
    return beyond[0]


def test_a_restart_goes_the_way_of_one_run(tmp_path):
    """Steps, increments, predictions and iterations: the equilibria of the past are kept, too."""
    whole, one = follow(tmp_path / "whole", 3.0, restart=False)
    agree(all(step.history[0].lag == 0 for step in whole), "a checkpoint has no preconditioner")
    interrupted(tmp_path / "parts")
    parts, other = follow(tmp_path / "parts", 3.0, restart=True)
    agree([step.load for step in parts] == [step.load for step in whole])
    agree(len(parts) > 4 and other.load.value == one.load.value == loads.mmhg(3.0))
    for a, b in zip(parts, whole, strict=True):
        agree(len(a.history) == len(b.history) and a.failures == b.failures)
    equal(other.u.x.array, one.u.x.array, 1e-9)
    again, finished = follow(tmp_path / "parts", 3.0, restart=True)
    agree([step.load for step in again] == [step.load for step in parts], "nothing is left to do")
    equal(finished.u.x.array, other.u.x.array, ROUNDING)


@pytest.mark.parametrize("rtol", [None, 1e-2])
def test_a_target_that_was_met_on_the_way(rtol, tmp_path):
    """It is solved again if it was met roughly; otherwise there is nothing left to do."""
    kept = interrupted(tmp_path, rtol)
    again, body = follow(tmp_path, kept.load, restart=True, rtol=rtol)
    agree([step.increment for step in again[-1:]] == [kept.increment if rtol is None else 0.0])
    small(body.load.value - loads.mmhg(kept.load), 0.0)


def test_a_foreign_record(tmp_path):
    """Of something else, or of steps with other fields: nothing is touched."""
    _, body = follow(tmp_path / "steps", 1.0, restart=False)
    other = Checkpoint(tmp_path / "steps", COMM, restart=True)
    other.record["steps"][0]["history"][0]["renamed"] = 1.0
    other.record["loads"] = [1.0]
    other.write([body.u, body.p], other.record)
    Checkpoint(tmp_path / "else", COMM).write([body.u, body.p], {"t": 1.0})
    for name in ("steps", "else"):
        body = wall(tube(around=4, along=2), degree=1)
        with raises(ValueError, "not written by follow_load of this version: name another folder"):
            follow(tmp_path / name, 2.0, restart=True, body=body)
        agree(not body.u.x.array.any() and body.load.value == 0.0)
