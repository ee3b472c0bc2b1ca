# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Compilation of UFL: machine code for forms and expressions.

An error on one process is raised on all of them (``runtime.collective.on_all``). dolfinx caches
FFCx's code. The package's own kernels (``cell_kernels``) come from ``Compiler.kernels``.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from mpi4py import MPI

import dolfinx
import ufl
from ufl.corealg.traversal import traverse_unique_terminals

from dolfinx_feti.fem.cell_kernels.generator import KernelGenerator
from dolfinx_feti.fem.quadrature import quadrature_rule, same_points
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.native import logged_if_slow

T = TypeVar("T")


@dataclass(frozen=True)
class Compiler:
    """Compiler of the forms and expressions of one problem, with its options.

    The options do not change. The generator of kernels remembers whether it has warned.

    Attributes:
        comm: Communicator of the mesh.
        form_compiler_options: Options of FFCx, see ``ffcx --help``.
        jit_options: Options of the C compiler and its cache, see ``dolfinx.jit``.
        allow_kernels: False to compile all integrals by FFCx, for comparisons.
    """

    comm: MPI.Comm
    form_compiler_options: Mapping[str, object] | None = None
    jit_options: Mapping[str, object] | None = None
    allow_kernels: bool = True

    @cached_property
    def kernels(self) -> KernelGenerator:
        """Generator of the package's cell kernels.

        They are cached in the folder of the user's option ``cache_dir``; without that option, in
        the folder of the package's other C code (``runtime.native``).
        """
        default, _ = dolfinx.jit.DOLFINX_DEFAULT_JIT_OPTIONS["cache_dir"]
        if self._ffcx_cache == str(default):
            cache = None
        else:
            cache = Path(self._ffcx_cache).expanduser()
        return KernelGenerator(cache, is_enabled=self.allow_kernels)

    def form(self, form: ufl.Form) -> dolfinx.fem.Form:
        """Compile a form by FFCx. Collective.

        Raises:
            Exception: What FFCx or the C compiler raises, on all processes.
        """
        return self._compile("a form", lambda: dolfinx.fem.form(form, **self._options()))

    def expression(self, expression: ufl.core.expr.Expr, points: Array) -> dolfinx.fem.Expression:
        """Compile an expression at points of the reference cell by FFCx. Collective.

        Args:
            expression: The expression.
            points: Points of the reference cell, (points, dimension).

        Raises:
            ValueError: It has no value at these points: it contains a quantity of facets, or data
                at other quadrature points. On all processes.
            Exception: What FFCx or the C compiler raises, on all processes.
        """

        def compile_expression() -> dolfinx.fem.Expression:
            _check_points(expression, points)
            options = self._options()
            return dolfinx.fem.Expression(expression, points, comm=self.comm, **options)

        return self._compile("an expression", compile_expression)

    def _options(self) -> dict[str, Any]:
        """Return copies of the options: dolfinx adds entries to what it receives."""
        return {
            "form_compiler_options": dict(self.form_compiler_options or {}),
            "jit_options": dict(self.jit_options or {}),
        }

    @property
    def _ffcx_cache(self) -> str:
        """Folder of FFCx's code."""
        return str(dolfinx.jit.get_options(self._options()["jit_options"])["cache_dir"])

    def _compile(self, what: str, work: Callable[[], T]) -> T:
        """Call dolfinx's compiler on all processes; the first one logs a long compilation.

        Args:
            what: What is compiled, for the log.
            work: The call.

        Returns:
            Its result.
        """

        def compile_and_announce() -> T:
            is_first = self.comm.rank == 0
            with logged_if_slow(what, self._ffcx_cache) if is_first else contextlib.nullcontext():
                return work()

        return on_all(compile_and_announce, self.comm)


def _check_points(expression: ufl.core.expr.Expr, points: Array) -> None:
    """Check that an expression has values at points inside cells.

    FFCx compares the numbers of points, but not their positions.

    Raises:
        ValueError: It contains a quantity of facets, or data at other quadrature points.
    """
    for terminal in traverse_unique_terminals(expression):
        if isinstance(terminal, ufl.geometry.GeometricFacetQuantity):
            raise ValueError(
                f"The expression contains {terminal}, which is defined on facets: evaluate it on a "
                "submesh of facets, or replace it by a field of the cells."
            )
    rule = quadrature_rule(expression)
    if rule is not None and not same_points(rule[0], points):
        raise ValueError(
            f"The expression contains data at {len(rule[0])} quadrature points, but is evaluated "
            f"at {len(points)} others: project the data first, or take the same quadrature."
        )
