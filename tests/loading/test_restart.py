# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Load steps that go on from a checkpoint."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import pytest
from collective import COMM, agree, equal, raises, small
from states import ROUNDING
from wall_files import on_first
from walls import tube, wall

from dolfinx_feti import loads
from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.loading.load_steps import follow_load
from dolfinx_feti.loading.steps import Steps


def follow(
    folder: Path, target: float, *, restart: bool, kappa: float = 1000.0, rtol: float | None = None
):
    body = wall(tube(around=4, along=2), degree=1, kappa=kappa)
    checkpoint = Checkpoint(folder, COMM, restart=restart)
    steps = follow_load(
        body.problem(3),
        lambda mmhg: setattr(body.load, "value", loads.mmhg(mmhg)),
        [1.0, target],
        Steps(first=0.9, least=0.1, growth=1.3, rtol=rtol),
        checkpoint=checkpoint,
    )
    return steps, body


def test_a_restart_goes_the_way_of_one_run(tmp_path):
    """Steps, increments, predictions and iterations: the equilibria of the past are kept, too."""
    whole, one = follow(tmp_path / "whole", 3.0, restart=False)
    agree(all(step.history[0].lag == 0 for step in whole), "a checkpoint has no preconditioner")

    class StoppedError(Exception):
        """Ends the run."""

    class Stopping(Checkpoint):
        def write(self, functions, record, past=(), **options) -> None:
            super().write(functions, record, past, **options)
            if len(record["steps"]) == 3:
                raise StoppedError

    with pytest.MonkeyPatch.context() as patch, raises(StoppedError, ""):
        patch.setitem(globals(), "Checkpoint", Stopping)
        follow(tmp_path / "parts", 3.0, restart=False)
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
    whole, _ = follow(tmp_path, 3.0, restart=False, rtol=rtol)
    on_the_way = next(s.load for s in whole if s.load > 1.0)
    path = tmp_path / "state.npz"
    head = on_first(lambda: json.loads(zipfile.ZipFile(path).read("head.json")))
    agree(head["record"]["met"] == [0.0, 1.0, 3.0] and on_the_way < 3.0)
    head["record"]["met"] = [0.0, 1.0]

    def change() -> None:
        with zipfile.ZipFile(path) as old:
            names = [name for name in old.namelist() if name != "head.json"]
            arrays = {name: old.read(name) for name in names}
        with zipfile.ZipFile(path, "w") as new:
            for name, data in (arrays | {"head.json": json.dumps(head)}).items():
                new.writestr(name, data)

    on_first(change)
    again, body = follow(tmp_path, 3.0, restart=True, rtol=rtol)
    more = [] if rtol is None else [0.0]
    agree([s.increment for s in again] == [*(s.increment for s in whole), *more])
    small(body.load.value - loads.mmhg(3.0), 0.0)


def test_a_foreign_record(tmp_path):
    body = wall(tube(around=4, along=2), degree=1)
    Checkpoint(tmp_path, COMM).write([body.u, body.p], {"t": 1.0})
    with raises(ValueError, "was not written by follow_load: name another folder"):
        follow(tmp_path, 1.0, restart=True)
