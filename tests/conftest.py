# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What holds around every test, and factories that clean up after themselves."""

from __future__ import annotations

import functools
import gc
import itertools
import logging
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import hand_torn
import numpy as np
import primal_form
import pytest
from collective import agree, garbage
from problems import Problem, torn

import dolfinx

import dolfinx_feti
from dolfinx_feti.feti.dual.form import DualForm, create_dual_form
from dolfinx_feti.feti.options import FETIOptions
from dolfinx_feti.feti.pattern import Pattern, create_pattern
from dolfinx_feti.feti.primal.form import PrimalForm
from dolfinx_feti.feti.primal.krylov import conjugate_gradients
from dolfinx_feti.feti.setup import set_up
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.runtime.petsc_options import inserted

COMM = MPI.COMM_WORLD
PREFIX = "test_"

# Whether a compilation takes long depends on the machine; what tests expect in the log does not.
logging.getLogger("dolfinx_feti.compilation").disabled = True
TESTS = Path(__file__).parent

#: What belongs to one cell, one subdomain or one material, is a whole study, or stands upon the
#: solver: a third process has nothing to tell that two have not. Gluing, coarse spaces and
#: decompositions, which may join three processes at a node, are no part of it.
AT_MOST_TWO = [
    TESTS / name
    for name in (
        "benchmarks",
        "comparison",
        "demos",
        "fem/test_cell_kernels.py",
        "fem/test_condensation.py",
        "feti/subdomain",
        "feti/test_options.py",
        "feti/test_prestress.py",
        "loading",
        "mechanics",
        "meshes",
        "output",
        "problems",
        "scalars/test_windkessel.py",
        "wall/test_conditions.py",
    )
]

#: Meshes of the present test, whose communicators PETSc's objects of their problems are on.
_meshes: list[dolfinx.mesh.Mesh] = []


def remembered(init: Callable[..., None]) -> Callable[..., None]:
    """Keep each new mesh until its test has ended, and with it its communicator."""

    @functools.wraps(init)
    def remember(mesh: dolfinx.mesh.Mesh, *args: object, **kwargs: object) -> None:
        init(mesh, *args, **kwargs)
        _meshes.append(mesh)

    return remember


dolfinx.mesh.Mesh.__init__ = remembered(dolfinx.mesh.Mesh.__init__)  # type: ignore[method-assign]


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what is not tried on so many processes.

    That is, on several, the work of the first one alone, and what :func:`each_choice` leaves out;
    on more than two, ``AT_MOST_TWO``; on more than three all that is not marked with the number.
    """

    def is_tried(item: pytest.Item) -> bool:
        if marker := item.get_closest_marker("processes"):
            return COMM.size in marker.args
        if item.get_closest_marker("serial"):
            return COMM.size == 1
        few = any(path in (item.path, *item.path.parents) for path in AT_MOST_TWO)
        return COMM.size <= (2 if few else 3)

    tried = [item for item in items if is_tried(item)]
    if COMM.size > 1:
        tests: dict[object, list[pytest.Item]] = {}
        for item in tried:
            test = item if item.get_closest_marker("processes") else item.nodeid.split("[")[0]
            tests.setdefault(test, []).append(item)
        chosen = {item for same in tests.values() for item in each_choice(same)}
        tried = [item for item in tried if item in chosen]
    left_out = set(items).difference(tried)
    config.hook.pytest_deselected(items=list(left_out))
    items[:] = tried


def each_choice(items: list[pytest.Item]) -> Iterable[pytest.Item]:
    """Choose as few of a test's parametrisations as have every value of every parameter.

    One process tries all combinations. Two try each value with the first others that need one, and
    three with the last ones, so that the two have different combinations where there are more.
    """
    rest = items if COMM.size == 2 else items[::-1]
    missing = set[object]().union(*map(values, rest))
    while missing:
        item = max(rest, key=lambda item: len(values(item) & missing))
        missing -= values(item)
        yield item


def values(item: pytest.Item) -> set[object]:
    """Return what a test is given; parameters that are listed together are one value."""
    given = getattr(item, "callspec", None)
    if given is None:
        return {item}
    together = [re.findall(r"\w+", str(mark.args[0])) for mark in item.iter_markers("parametrize")]
    fixtures = given.params.keys() - {name for names in together for name in names}
    together += [[name] for name in fixtures]
    return {tuple((name, id(given.params[name])) for name in names) for names in together}


def pytest_collection_finish() -> None:
    """Spare the collector what the imports have made."""
    collect()


def collect() -> None:
    """Collect garbage, and spare the next collection what is left of this one."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def clean() -> Iterator[None]:
    """Find the options database as it was, and no object that processes have to end together."""
    before = PETSc.Options().getAll()
    yield
    collect()
    comms = [COMM, *(mesh.comm for mesh in _meshes if mesh.comm.size > 1)]
    left = [garbage(comm) for comm in comms]
    for comm in comms:
        PETSc.garbage_cleanup(comm)
    _meshes.clear()
    COMM.Barrier()
    assert not any(left), "".join(left)
    assert PETSc.Options().getAll() == before


@pytest.fixture
def tmp_path(tmp_path: Path) -> Path:
    """Give all processes the folder of the first one."""
    return COMM.bcast(tmp_path)


@pytest.fixture
def lifetime() -> Iterator[Lifetime]:
    """Own what a test makes."""
    with Lifetime() as owner:
        yield owner


@pytest.fixture
def without_collector() -> Iterator[None]:
    """Let reference counting alone do."""
    collect()
    gc.disable()
    yield
    gc.enable()


@pytest.fixture
def torn_grid(lifetime: Lifetime) -> Callable[..., hand_torn.HandTorn]:
    """Tear a brick by hand, see :func:`hand_torn.grid`."""
    return lambda *args, **how: lifetime.own(hand_torn.grid(*args, **how))


@pytest.fixture
def cautious(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the primal form end where its coarse space shows negative curvature."""

    def iterate(*args: Any, saddles: bool, **kwargs: Any) -> Any:
        return conjugate_gradients(*args, **kwargs)

    monkeypatch.setattr("dolfinx_feti.feti.primal.form.conjugate_gradients", iterate)


@pytest.fixture
def parts(pattern: Callable[..., Pattern], lifetime: Lifetime) -> Callable[..., DualForm]:
    """Build the dual form of a torn matrix, with options as keywords."""

    def create(A: PETSc.Mat, **options: object) -> DualForm:
        read = pattern(A, **options)
        return create_dual_form(read, set_up(read, lifetime, lifetime), lifetime)

    return create


@pytest.fixture
def double_products(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep A V in double precision, so that identities hold to its rounding."""
    monkeypatch.setattr("dolfinx_feti.feti.coarse.space.PRECISION", np.float64)


@pytest.fixture
def form(
    pattern: Callable[..., Pattern], double_products: None, lifetime: Lifetime
) -> Callable[..., PrimalForm]:
    """Build the primal form of a torn problem, see :func:`primal_form.create`."""
    return lambda problem, more=None, **options: primal_form.create(
        pattern(problem.A, deflation=0, **options), lifetime, more
    )


@pytest.fixture
def pattern(lifetime: Lifetime) -> Callable[..., Pattern]:
    """Read the pattern of a torn matrix, with options as keywords."""

    def create(A: PETSc.Mat, **options: object) -> Pattern:
        given = FETIOptions(**{"interior": "keep", **options})
        return create_pattern(A, given, PREFIX, lifetime)

    return create


@pytest.fixture
def feti(lifetime: Lifetime) -> Callable[..., PETSc.KSP]:
    """Make a KSP with a FETI context for a torn matrix, options without prefix as keywords."""
    prefixes = (f"test{i}_" if i else PREFIX for i in itertools.count())

    def create(
        A: PETSc.Mat, context: dolfinx_feti.FETI | None = None, **options: object
    ) -> PETSc.KSP:
        prefix = next(prefixes)
        lifetime.enter_context(inserted(prefix, options))
        ksp = lifetime.own(PETSc.KSP().create(A.comm))
        ksp.setOptionsPrefix(prefix)
        ksp.setOperators(A)
        ksp.setType(PETSc.KSP.Type.PYTHON)
        ksp.setPythonContext(context or dolfinx_feti.FETI())
        ksp.setFromOptions()
        ksp.setUp()
        return ksp

    return create


@pytest.fixture
def solve() -> Callable[..., dolfinx_feti.LinearProblem]:
    """Solve a problem with LinearProblem; the values of ``options`` are without prefix."""

    def run(
        problem: Problem, subdomains: object, options: Mapping[str, object] | None = None
    ) -> dolfinx_feti.LinearProblem:
        linear = torn(problem, subdomains, PREFIX, **(options or {}))
        linear.solve()
        agree(linear.solver.getConvergedReason() > 0)
        return linear

    return run
