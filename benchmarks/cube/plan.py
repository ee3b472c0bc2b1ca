# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The cases of the linear study, in sets: the paper's table first, then what goes beyond it."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace

from benchmarks.cube.case import Case

__all__ = ["SETS", "plan"]

TYPES = ("all_floating", "classical")
PRECONDITIONERS = ("identity", "lumped", "dirichlet")

#: Coefficients of the stiff subcubes, and the scalings and weights Q that are tried on them.
JUMPS = (1e2, 1e4, 1e6)
WEIGHTS = tuple(itertools.product(("multiplicity", "stiffness"), ("identity", "preconditioner")))


def papers() -> Iterator[Case]:
    """The paper's table, and the same with quadratic elements."""
    for degree, levels in ((1, (1, 2, 3)), (2, (1, 2))):
        for level in levels:
            yield from _all(Case(degree=degree, level=level))


def choices() -> Iterator[Case]:
    """One choice at a time that is not the paper's, and this package's own."""
    own = {"scaling": "stiffness", "coarse_q": "preconditioner"}
    changes = (
        {"reorthogonalize": True},
        {"coarse_q": "diagonal"},
        {"coarse_q": "preconditioner"},
        {"scaling": "stiffness"},
        own,
        own | {"coarse_modes": 12},
    )
    for kind, change in itertools.product(TYPES, changes):
        yield Case(level=2, type=kind, **change)
    for kind, pc in itertools.product(TYPES, ("identity", "lumped")):
        yield Case(level=2, type=kind, pc=pc, reorthogonalize=True)


def jumps() -> Iterator[Case]:
    """Young's modulus jumps between subcubes: a checkerboard, and a stiff layer."""
    patterns = [("none", 1.0), *itertools.product(("checkerboard", "layer"), JUMPS)]
    for (pattern, jump), kind, (scaling, q) in itertools.product(patterns, TYPES, WEIGHTS):
        choice = {"type": kind, "scaling": scaling, "coarse_q": q}
        yield Case(subdomains_per_edge=4, level=2, pattern=pattern, jump=jump, **choice)


def growth() -> Iterator[Case]:
    """More cells in a subdomain, in a cube of 64."""
    for level in (1, 2, 3, 4):
        yield from _all(Case(subdomains_per_edge=4, level=level))


def numbers() -> Iterator[Case]:
    """More subdomains of the same size, with the paper's weight Q and this package's."""
    for level, edge, q in itertools.product((1, 2), (2, 4, 8, 16), ("identity", "preconditioner")):
        yield from _all(Case(level=level, subdomains_per_edge=edge, coarse_q=q), ["dirichlet"])
    yield from _all(Case(subdomains_per_edge=32), ["dirichlet"])


def largest() -> Iterator[Case]:
    """What takes the most memory: the paper's fourth level, and the third of quadratic elements."""
    for degree, level in ((1, 4), (2, 3)):
        yield from _all(Case(degree=degree, level=level))


#: Parts of the study by name.
SETS = {each.__name__: each for each in (papers, choices, jumps, growth, numbers, largest)}


def plan(sets: Sequence[str] = tuple(SETS)) -> list[Case]:
    """Return the cases of some sets, each once."""
    return list(dict.fromkeys(case for name in sets for case in SETS[name]()))


def _all(case: Case, preconditioners: Sequence[str] = PRECONDITIONERS) -> Iterator[Case]:
    """Both types with some preconditioners."""
    for kind, pc in itertools.product(TYPES, preconditioners):
        yield replace(case, type=kind, pc=pc)
