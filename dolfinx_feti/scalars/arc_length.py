# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Arc length: the load as an unknown, for paths over limit points.

.. math:: \tfrac12 \Bigl[ \frac{ψ^2}{|Ω|} \int_Ω t_u · (u - u_n)\, \mathrm dX
          + t_λ\, (λ - λ_n) \Bigr] = Δs

with the last equilibrium (u_n, λ_n) and the direction t of the secant through the last two, of
length one in the norm :math:`\|(u, λ)\|^2 = ½ (ψ^2 \int |u|^2 / |Ω| + λ^2)` (Keller, Numerical
solution of bifurcation and nonlinear eigenvalue problems, 1977). The first step is one of the load,
λ − λ_n = Δs. It determines ψ, a load per length, such that both terms have the same weight. s has
the unit of the load.
"""

from __future__ import annotations

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.runtime.values import require_finite
from dolfinx_feti.scalars.equations import Coupling, ScalarEquation

__all__ = ["ArcLength"]


class ArcLength(Coupling):
    """Equation of the arc's length for an unknown load, for ``follow_load``.

    Example::

        arc = ArcLength(u, pressure)
        problem = NonlinearProblem(energy, u, bcs=bcs, scalars=[arc])
        follow_load(problem, lambda s: None, [0.2], Steps(first=0.1, least=1e-3))
        print(pressure.value)

    Attributes:
        load: λ, a constant in the residual.
        functions: u_n and t_u. The numbers λ_n, t_λ, ψ² and Δs are Constants of the equation: paths
            restore them with the other Constants of the forms.
    """

    def __init__(self, u: dolfinx.fem.Function, load: dolfinx.fem.Constant) -> None:
        """Create an arc from the present state, an equilibrium. Collective.

        Args:
            u: The unknown.
            load: λ, a scalar constant in the residual.

        Raises:
            ValueError: The load is no scalar constant, or is not finite.
        """
        if not isinstance(load, dolfinx.fem.Constant) or load.ufl_shape:
            raise ValueError(f"load is {load!r}: give the scalar Constant that is in the forms.")
        require_finite(load=float(load.value))
        V = u.function_space
        mesh = u.function_space.mesh
        self.load = load
        self._u = u
        self._last = dolfinx.fem.Function(V)
        self._secant = dolfinx.fem.Function(V)
        self.functions = (self._last, self._secant)
        self._last.x.array[:] = u.x.array
        # With t_λ = 2 and ψ = 0 the first step has the equation λ − λ_n = Δs.
        self._last_load = dolfinx.fem.Constant(mesh, np.float64(load.value))  # λ_n
        self._load_secant = dolfinx.fem.Constant(mesh, np.float64(2.0))  # t_λ
        self._ψ2 = dolfinx.fem.Constant(mesh, np.float64(0.0))
        self._length = dolfinx.fem.Constant(mesh, np.float64(0.0))  # Δs
        dx = ufl.Measure("dx", mesh)
        one = dolfinx.fem.form(dolfinx.fem.Constant(mesh, np.float64(1.0)) * dx)
        self._comm = mesh.comm
        self._dx = dx
        self._size = self._comm.allreduce(dolfinx.fem.assemble_scalar(one))  # |Ω|
        moved = u - self._last
        self._moved = dolfinx.fem.form(ufl.inner(moved, moved) / self._size * dx)

    def begin_step(self, length: float) -> None:
        """Prepare a step of the length Δs, in the unit of the load."""
        self._length.value = length

    def accept(self) -> None:
        """Store the present state as the last one, and the secant to it. Collective."""
        squares = self._comm.allreduce(dolfinx.fem.assemble_scalar(self._moved))
        step = float(self.load.value - self._last_load.value)
        if self._ψ2.value == 0.0 and squares > 0.0:
            self._ψ2.value = step**2 / squares
        norm = np.sqrt((float(self._ψ2.value) * squares + step**2) / 2.0)
        if norm > 0.0:
            # t points to larger s, also after a step back.
            sign = float(np.sign(self._length.value)) or 1.0
            self._secant.x.array[:] = sign * (self._u.x.array - self._last.x.array) / norm
            self._load_secant.value = sign * step / norm
            self._last_load.value = self.load.value
        self._last.x.array[:] = self._u.x.array

    @property
    def equation(self) -> ScalarEquation:
        """The equation of the arc's length, with λ as unknown.

        All of its terms are means over the body, those without u as well, because an equation is a
        sum of integrals.
        """
        along_u = self._ψ2 * ufl.inner(self._secant, self._u - self._last)
        along_load = self._load_secant * (self.load - self._last_load)
        mean = ((along_u + along_load) / 2.0 - self._length) / self._size
        return ScalarEquation(self.load, (mean * self._dx,))
