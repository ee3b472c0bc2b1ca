# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Played problems."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from played import Played


@pytest.fixture
def played() -> Iterator[Callable[..., Played]]:
    made: list[Played] = []

    def create(**arguments: object) -> Played:
        made.append(Played(**arguments))
        return made[-1]

    yield create
    for problem in made:
        problem.solver.destroy()
