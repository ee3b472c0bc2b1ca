# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Parameters that many tests have: choices of the solver, and tables of cases with names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import pytest
from ids import typable

from dolfinx_feti.feti.interface.scaling import SCALINGS

every_type = pytest.mark.parametrize("kind", ["all_floating", "classical"])
every_interior = pytest.mark.parametrize("interior", ["keep", "eliminate"])
every_formulation = pytest.mark.parametrize("formulation", ["dual", "primal"])
every_scaling = pytest.mark.parametrize("scaling", SCALINGS)
every_q = pytest.mark.parametrize("q", ["identity", "diagonal", "preconditioner"])


def case(subdomains: tuple, cells: tuple, components: int = 1, **more: object) -> dict:
    """Return the arguments of :func:`hand_torn.grid`."""
    return {"subdomains": subdomains, "cells": cells, "components": components, **more}


def each(names: str | tuple[str, ...], table: Mapping[str, object]) -> pytest.MarkDecorator:
    """Parametrise a test over a table of cases by name; blanks become hyphens in the ids."""
    return pytest.mark.parametrize(names, table.values(), ids=map(typable, table))


def wrong_values(table: Iterable[tuple]) -> pytest.MarkDecorator:
    """Parametrise a test over wrong values of arguments, one wrong argument at a time.

    The test's arguments are ``call``, ``right``, ``name`` and ``wrong``.

    Args:
        table: Rows of a function, its right arguments, and the wrong values of an argument by name.
    """
    rows = [
        pytest.param(call, right, name, value, id=f"{call.__name__}-{typable(f'{name}={value}')}")
        for call, right, columns in table
        for name, values in columns.items()
        for value in values
    ]
    return pytest.mark.parametrize(("call", "right", "name", "wrong"), rows)
