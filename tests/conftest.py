# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Choice of tests by the number of processes, checks after each test, fixtures that clean up."""

from __future__ import annotations

import functools
import gc
import itertools
import logging
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import hand_torn
import primal_form
import pytest
from collective import agree, garbage
from ids import TYPABLE, id_of
from problems import Problem, torn

import dolfinx

import dolfinx_feti
from dolfinx_feti.feti.dual.formulation import DualFormulation, create_dual_formulation
from dolfinx_feti.feti.options import FETIOptions
from dolfinx_feti.feti.pattern import Pattern, create_pattern
from dolfinx_feti.feti.primal.formulation import PrimalFormulation
from dolfinx_feti.feti.primal.krylov.conjugate_gradients import conjugate_gradients
from dolfinx_feti.feti.primal.krylov.registry import KRYLOV_METHODS
from dolfinx_feti.feti.setup import set_up
from dolfinx_feti.feti.subsolver_options import read_subsolver_options
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.runtime.petsc_options import inserted
from dolfinx_feti.runtime.scotch import VARIABLES

# Meshes that tests create are distributed over the processes in the same way in every run.
for name, value in VARIABLES.items():
    os.environ.setdefault(name, value)

COMM = MPI.COMM_WORLD
PREFIX = "test_"

# The message of a long compilation depends on the machine; tests compare the log.
logging.getLogger("dolfinx_feti.compilation").disabled = True
TESTS = Path(__file__).parent

#: Tests to which a third process adds no coverage: of a cell, a subdomain or a material, of whole
#: studies, and of code that uses the solver. Gluing, coarse spaces and decompositions run on three
#: processes, which may share a node.
AT_MOST_TWO = [
    TESTS / name
    for name in (
        "benchmarks",
        "comparison",
        "contact/test_oracles.py",
        "contact/test_paths.py",
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

#: Meshes of the current test; :func:`clean` looks for PETSc's garbage on their communicators.
_meshes: list[dolfinx.mesh.Mesh] = []

#: PETSc's copies of these communicators. PETSc makes one, collectively, with the first object on a
#: communicator and frees it with the last: here both happen at the same time on all processes, also
#: if the collector frees an object earlier on one of them.
_comms: list[PETSc.Comm] = []


def remembered(init: Callable[..., None]) -> Callable[..., None]:
    """Return a constructor of meshes that also adds to ``_meshes`` and ``_comms``. Collective."""

    @functools.wraps(init)
    def remember(mesh: dolfinx.mesh.Mesh, *args: object, **kwargs: object) -> None:
        init(mesh, *args, **kwargs)
        _meshes.append(mesh)
        if mesh.comm.size > 1:
            _comms.append(PETSc.Comm(mesh.comm).duplicate())

    return remember


dolfinx.mesh.Mesh.__init__ = remembered(dolfinx.mesh.Mesh.__init__)  # type: ignore[method-assign]


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Refuse ids that one cannot type; deselect tests that do not run on this number of processes.

    On several processes these are the tests marked ``serial``, and the parametrisations that
    :func:`each_choice` does not choose. On more than two they are also those of ``AT_MOST_TWO``. On
    more than three only tests that are marked with the number run.
    """
    ids = {item.nodeid: item.callspec.id for item in items if hasattr(item, "callspec")}
    renamed = [str(path) for path in AT_MOST_TWO if not path.exists()]
    if renamed:
        raise pytest.UsageError(
            f"AT_MOST_TWO in conftest.py has paths that do not exist: {renamed}"
        )
    untypable = [node for node, name in ids.items() if not TYPABLE.fullmatch(name)]
    if untypable:
        raise pytest.UsageError(f"Give ids without blanks and quotes, by cases.each: {untypable}")

    def is_tried(item: pytest.Item) -> bool:
        if marker := item.get_closest_marker("processes"):
            return COMM.size in marker.args
        if item.get_closest_marker("serial"):
            return COMM.size == 1
        needs_no_third = any(path in (item.path, *item.path.parents) for path in AT_MOST_TWO)
        return COMM.size <= (2 if needs_no_third else 3)

    tried = [item for item in items if is_tried(item)]
    if COMM.size > 1:
        tests: dict[object, list[pytest.Item]] = {}  # with a mark, each combination is one
        for item in tried:
            test = item if item.get_closest_marker("processes") else item.nodeid.split("[")[0]
            tests.setdefault(test, []).append(item)
        chosen = {item for same in tests.values() for item in each_choice(same)}
        tried = [item for item in tried if item in chosen]
    left_out = set(items).difference(tried)
    config.hook.pytest_deselected(items=list(left_out))
    items[:] = tried


def each_choice(items: list[pytest.Item]) -> Iterable[pytest.Item]:
    """Yield a few parametrisations of a test that together have every value of every parameter.

    One process runs all combinations. On two processes the choice goes through them from the first
    to the last, on three from the last to the first, so that they run different combinations.
    """
    rest = items if COMM.size == 2 else items[::-1]
    missing = set[object]().union(*map(parameter_values, rest))
    while missing:
        item = max(rest, key=lambda item: len(parameter_values(item) & missing))
        missing -= parameter_values(item)
        yield item


def parameter_values(item: pytest.Item) -> set[object]:
    """Return the values of a test's parameters; parameters of one decorator are one value."""
    parameters = getattr(item, "callspec", None)
    if parameters is None:
        return {item}
    together = [re.findall(r"\w+", str(mark.args[0])) for mark in item.iter_markers("parametrize")]
    fixtures = parameters.params.keys() - {name for names in together for name in names}
    together += [[name] for name in fixtures]
    return {tuple((name, id(parameters.params[name])) for name in names) for names in together}


def pytest_make_parametrize_id(val: object, argname: str) -> str | None:
    """Return an id of a parameter that one can type without quotes; None if pytest's is one."""
    return id_of(val, argname)


def pytest_collection_finish() -> None:
    """Exclude objects that imports have created from later collections of garbage."""
    collect()


def collect() -> None:
    """Collect garbage, and exclude the remaining objects from later collections."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def clean() -> Iterator[None]:
    """Fail if a test leaves PETSc options, or objects whose ``destroy`` is collective."""
    before = PETSc.Options().getAll()
    yield
    collect()
    comms = [COMM, *(mesh.comm for mesh in _meshes if mesh.comm.size > 1)]
    left = [garbage(comm) for comm in comms]
    for comm in comms:
        PETSc.garbage_cleanup(comm)
    _meshes.clear()
    while _comms:
        _comms.pop().destroy()
    COMM.Barrier()
    assert not any(left), "".join(left)
    assert PETSc.Options().getAll() == before


@pytest.fixture
def tmp_path(tmp_path: Path) -> Path:
    """The temporary folder of the first process, on all processes."""
    return COMM.bcast(tmp_path)


@pytest.fixture
def lifetime() -> Iterator[Lifetime]:
    """An owner of PETSc's objects, which are destroyed after the test."""
    with Lifetime() as owner:
        yield owner


@pytest.fixture
def without_collector() -> Iterator[None]:
    """Disable the garbage collector during a test, so that only reference counts free objects."""
    collect()
    gc.disable()
    yield
    gc.enable()


@pytest.fixture
def torn_grid(lifetime: Lifetime) -> Callable[..., hand_torn.HandTorn]:
    """Return a function that tears a brick by hand, see :func:`hand_torn.grid`."""

    def create(*args: Any, **options: Any) -> hand_torn.HandTorn:
        return lifetime.own(hand_torn.grid(*args, **options))

    return create


@pytest.fixture
def stops_at_negative_curvature(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the primal formulation stop at negative curvature in its coarse space."""

    def iterate(*args: Any, allow_indefinite: bool, **kwargs: Any) -> Any:
        return conjugate_gradients(*args, allow_indefinite=False, **kwargs)

    monkeypatch.setitem(KRYLOV_METHODS, "cg", replace(KRYLOV_METHODS["cg"], solve=iterate))


@pytest.fixture
def create_dual(
    read_pattern: Callable[..., Pattern], lifetime: Lifetime
) -> Callable[..., DualFormulation]:
    """Return a function that builds the dual form of a torn matrix; options are keywords.

    Their defaults are those of :func:`read_pattern`.
    """

    def create(A: PETSc.Mat, **options: object) -> DualFormulation:
        read = read_pattern(A, **options)
        setup = set_up(read, matrix_objects=lifetime, preconditioner_objects=lifetime)
        return create_dual_formulation(read, setup, lifetime)

    return create


@pytest.fixture
def double_precision_products(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep Vᵀ A in double precision, so that identities hold to its rounding."""
    monkeypatch.setattr("dolfinx_feti.feti.coarse.products.MIN_SINGLE_PRECISION_RATIO", 2.0)


@pytest.fixture
def create_primal(
    read_pattern: Callable[..., Pattern], double_precision_products: None, lifetime: Lifetime
) -> Callable[..., PrimalFormulation]:
    """Return a function that builds the primal form of a problem torn by hand.

    Further columns of its coarse space are an argument, see :func:`primal_form.create`; options are
    keywords. Unlike in the solver, there are no deflation vectors and no products in single
    precision; other defaults are those of :func:`read_pattern`.
    """

    def create(problem: Any, further_columns: Any = None, **options: object) -> PrimalFormulation:
        return primal_form.create(
            read_pattern(problem.A, deflation=0, **options), lifetime, further_columns
        )

    return create


@pytest.fixture
def read_pattern(lifetime: Lifetime) -> Callable[..., Pattern]:
    """Return a function that reads the pattern of a torn matrix; options are keywords.

    They are fields of :class:`FETIOptions`, with their defaults, except that the interior is kept.
    """

    def create(A: PETSc.Mat, **options: object) -> Pattern:
        settings = FETIOptions(**{"interior": "keep", **options})
        return create_pattern(A, settings, read_subsolver_options(PREFIX), lifetime)

    return create


@pytest.fixture
def create_ksp(lifetime: Lifetime) -> Callable[..., PETSc.KSP]:
    """Return a function that creates a KSP with a FETI context; options have no prefix."""
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
def solve_linear() -> Callable[..., dolfinx_feti.LinearProblem]:
    """Return a function that solves a problem by LinearProblem; options have no prefix."""

    def run(
        problem: Problem, subdomains: object, options: Mapping[str, object] | None = None
    ) -> dolfinx_feti.LinearProblem:
        linear = torn(problem, subdomains, PREFIX, **(options or {}))
        linear.solve()
        agree(linear.solver.getConvergedReason() > 0)
        return linear

    return run
