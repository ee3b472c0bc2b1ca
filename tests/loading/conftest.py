# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A fixture that creates fake problems and destroys their solvers after the test."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from fake_problem import FakeProblem


@pytest.fixture
def create_fake_problem() -> Iterator[Callable[..., FakeProblem]]:
    made: list[FakeProblem] = []

    def create(**arguments: object) -> FakeProblem:
        made.append(FakeProblem(**arguments))
        return made[-1]

    yield create
    for problem in made:
        problem.solver.destroy()
