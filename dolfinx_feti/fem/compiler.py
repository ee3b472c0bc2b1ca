# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""From UFL to code, on all processes or on none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl

from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.native import processor_flags

__all__ = ["Compiler"]

#: Flags that leave NaN alone.
FAST = ["-O3", "-fno-inline-small-functions", "-fno-math-errno", "-fno-trapping-math"]


@dataclass(frozen=True, slots=True)
class Compiler:
    """How forms and expressions are compiled.

    Attributes:
        comm: Communicator of the mesh.
        form_compiler_options: Options of FFCx, see ``ffcx --help``.
        jit_options: Options of the C compiler and its cache, see ``dolfinx.jit``.
    """

    comm: MPI.Comm
    form_compiler_options: Mapping[str, object] | None = None
    jit_options: Mapping[str, object] | None = None

    def flags(self) -> list[str]:
        """Return the flags of the C compiler for code of this package.

        They are those of dolfinx's options where these are not the default ones, and for processors
        of this kind, with whose wide registers the compiler is done in a third of the time. Sums
        keep their order, and NaN are seen.
        """
        options = dolfinx.jit.get_options(_copy(self.jit_options))
        flags = [str(flag) for flag in options["cffi_extra_compile_args"]]
        default, _ = dolfinx.jit.DOLFINX_DEFAULT_JIT_OPTIONS["cffi_extra_compile_args"]
        return [*(FAST if flags == default else flags), *processor_flags(), "-Wno-psabi"]

    def form(self, form: ufl.Form) -> dolfinx.fem.Form:
        """Compile a form.

        Raises:
            Exception: It cannot be compiled, on all processes.

        Note:
            Collective.
        """
        return on_all(
            lambda: dolfinx.fem.form(
                form,
                form_compiler_options=_copy(self.form_compiler_options),
                jit_options=_copy(self.jit_options),
            ),
            self.comm,
        )

    def expression(
        self, expression: ufl.core.expr.Expr, points: npt.NDArray[np.float64]
    ) -> dolfinx.fem.Expression:
        """Compile an expression.

        Args:
            expression: The expression.
            points: Where it is evaluated in the reference cell, (points, dimension).

        Raises:
            Exception: It cannot be compiled, on all processes.

        Note:
            Collective.
        """
        return on_all(
            lambda: dolfinx.fem.Expression(
                expression,
                points,
                comm=self.comm,
                form_compiler_options=_copy(self.form_compiler_options),
                jit_options=_copy(self.jit_options),
            ),
            self.comm,
        )


def _copy(options: Mapping[str, object] | None) -> dict[str, object]:
    """Return options that dolfinx may add to."""
    return dict(options or {})
