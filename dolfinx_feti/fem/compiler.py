# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""From UFL to code, on all processes or on none."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from mpi4py import MPI

import dolfinx
import ufl
from ufl.corealg.traversal import traverse_unique_terminals

from dolfinx_feti.fem.quadrature import quadrature_rule, same_points
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.native import announced

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Compiler:
    """How forms and expressions are compiled."""

    comm: MPI.Comm  # of the mesh
    form_compiler_options: Mapping[str, object] | None = None  # of FFCx, see ``ffcx --help``
    jit_options: Mapping[str, object] | None = None  # of C and its cache, see ``dolfinx.jit``

    @property
    def cache(self) -> Path | None:
        """Folder for the package's own code, if dolfinx's options name one."""
        default, _ = dolfinx.jit.DOLFINX_DEFAULT_JIT_OPTIONS["cache_dir"]
        return None if self._folder == str(default) else Path(self._folder).expanduser()

    def form(self, form: ufl.Form) -> dolfinx.fem.Form:
        """Compile a form, or raise on all processes what the compiler raises. Collective."""
        return self._compile("a form", lambda: dolfinx.fem.form(form, **self._options()))

    def expression(self, expression: ufl.core.expr.Expr, points: Array) -> dolfinx.fem.Expression:
        """Compile an expression at points of the reference cell, (points, dimension). Collective.

        Raises:
            ValueError: It has no value at these points: it holds a quantity of facets, or data at
                other quadrature points. On all processes, as what the compiler raises.
        """

        def compiled() -> dolfinx.fem.Expression:
            _check_points(expression, points)
            options = self._options()
            return dolfinx.fem.Expression(expression, points, comm=self.comm, **options)

        return self._compile("an expression", compiled)

    def _options(self) -> dict[str, Any]:
        """Return copies of the options, to which dolfinx may add."""
        return {
            "form_compiler_options": dict(self.form_compiler_options or {}),
            "jit_options": dict(self.jit_options or {}),
        }

    @property
    def _folder(self) -> str:
        """Where FFCx keeps its code."""
        return str(dolfinx.jit.get_options(self._options()["jit_options"])["cache_dir"])

    def _compile(self, what: str, work: Callable[[], T]) -> T:
        """Let dolfinx compile on all processes; the first one tells what takes long."""

        def told() -> T:
            with contextlib.nullcontext() if self.comm.rank else announced(what, self._folder):
                return work()

        return on_all(told, self.comm)


def _check_points(expression: ufl.core.expr.Expr, points: Array) -> None:
    """Require that an expression has values at points inside cells: FFCx compares their number."""
    for terminal in traverse_unique_terminals(expression):
        if isinstance(terminal, ufl.geometry.GeometricFacetQuantity):
            raise ValueError(
                f"The expression holds {terminal}, which lives on facets: evaluate it on a submesh "
                "of facets, or replace it by a field of the cells."
            )
    rule = quadrature_rule(expression)
    if rule is not None and not same_points(rule[0], points):
        raise ValueError(
            f"The expression holds data at {len(rule[0])} quadrature points, but is evaluated at "
            f"{len(points)} others: project the data first, or take the same quadrature."
        )
