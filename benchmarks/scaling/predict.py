# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What the model foresees for a wall of so many dofs on so many processes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from benchmarks.common.records import Record
from benchmarks.common.walls.first_step import CHOICES, TYPES
from benchmarks.scaling import paper
from benchmarks.scaling.model import create_model, efficiency

__all__ = ["predict"]

PARTS = ("reading", "local", "coarse", "krylov", "rest", "fixed", "total")


def predict(records: Sequence[Record], dofs: int, processes: int) -> Iterator[str]:
    """Yield the lines of a table: seconds of a load step, for each series that was measured."""
    first = min(paper.FIRST, processes)
    yield f"A load step of {dofs} dofs on {processes} processes, modelled [s]:"
    yield " ".join(f"{name:>8}" for name in (*PARTS, "eff")) + f"  (eff: against {first})"
    for choices in CHOICES:
        for kind in TYPES:
            mine = [r for r in records if (r["choices"], r["type"]) == (choices, kind)]
            mine.sort(key=lambda r: r["processes"])
            tasks = ([r for r in mine if r["task"] == task] for task in ("measure", "count"))
            model = create_model(*tasks)
            if model is None:
                continue
            refined = dofs / model.base["dofs"]
            there, here = (model.predict(P, refined) for P in (first, processes))
            numbers = [getattr(here, part) for part in PARTS]
            numbers.append(efficiency(first, there.total, processes, here.total))
            its = sum(model.base["linear_iterations_per_newton"])
            steps = model.base["newton_iterations"]
            yield (
                " ".join(f"{number:8.3g}" for number in numbers)
                + f"  {TYPES[kind]}, {CHOICES[choices]}: {steps} Newton steps, {its} iterations"
            )
