# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The nonlinear system that Newton's method sees: residual, torn tangent, state.

.. math:: K'(U)\, ΔU = \mathcal F - K(U), \qquad U ← U + ΔU

(eq. 26, Augustin_eq:LGS; eq. 28 for the entries), with a pressure condensed from both sides if
there is one (``condensation``); residuals meet prescribed values (eq. 7, Augustin_eq:Dirichlet).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from mpi4py import MPI

import numpy as np

import dolfinx

from dolfinx_feti.fem import assembly
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.condensation import Blocks, Condensation
from dolfinx_feti.fem.decomposition import Decomposition, cell_sizes, tear
from dolfinx_feti.fem.near_kernel import attach_near_kernel
from dolfinx_feti.fem.quadrature import quadrature_points
from dolfinx_feti.problems.forms import Forms
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.connectivity import diagonal_places
from dolfinx_feti.scalars.border import ScalarSystem
from dolfinx_feti.scalars.equations import Coupling
from dolfinx_feti.torn.matrix import set_condensed
from dolfinx_feti.torn.rounding import EPS, product_rounding

#: Share of the greatest displacement below which a missed Dirichlet value is rounding.
MOVED = 1e-12


@dataclass(frozen=True, slots=True)
class Residual:
    """The residual at one state, (owned,) in u; forces and lengths are never added."""

    condensed: Array  # forces with the fields condensed into them, zero on Dirichlet dofs
    force: Array  # forces before condensation; reactions on Dirichlet dofs
    gap: Array  # u − g of the Dirichlet dofs, zero on the free ones
    blocks: Blocks | None  # of the condensed fields
    scalar: Array = field(default_factory=lambda: np.zeros(0))  # missed by the scalars, (m,)

    @property
    def equations(self) -> Array:
        """Newton's right-hand side but for its sign: a force or a length of each dof."""
        return self.condensed + self.gap


class Tangent:
    """Names the tangent that a torn matrix holds, until another one takes its place."""


class System:
    """Residual and tangent of a displacement u and of what is condensed, such as a pressure p.

    The state is what the user's Functions hold. Its methods are collective.

    Attributes:
        A: Torn matrix.
        tangent: Names the tangent that it holds.
        dirichlet: Mask of the dofs of ``bcs``, (owned,).
        is_held: Whether a tangent has been regular with these conditions: then they are enough.
        owned: Number of dofs of u that this process owns.
        is_displacement: Whether u is one, with a det F to watch.
        has_potential: Whether an energy is known.
        scalars: Scalar unknowns beside u.
    """

    def __init__(
        self,
        forms: Forms,
        *,
        bcs: Sequence[dolfinx.fem.DirichletBC],
        decomposition: Decomposition,
        compiler: Compiler | None = None,
        scalars: Sequence[Coupling] = (),
    ) -> None:
        """Tear the space and compile all forms, with dolfinx's options if no compiler is given."""
        self.u, V, F_u = forms.u, forms.u.function_space, forms.F_u
        self.comm = V.mesh.comm
        self._n_cells = len(decomposition.subdomain)
        self._space = tear(V, decomposition)
        compiler = compiler or Compiler(self.comm)
        self._residual = assembly.split_form(F_u, V.mesh, compiler)
        self._tangent = assembly.torn_form(forms.J, self._space, compiler)
        self.condensation = None
        if forms.condense:
            F_p, fields = zip(*forms.condense, strict=True)
            self.condensation = Condensation(
                F_u, F_p, self.u, fields, space=self._space, compiler=compiler
            )
        self._K = assembly.create_local_matrix(self._space, compiler)
        self._diagonal = diagonal_places(self._K.mat)  # none is missing
        self._stiffness = k = np.zeros(len(self._diagonal))
        self.A = assembly.create_matis(self._space, self._K.mat, bcs, k, forms.symmetric)
        self.tangent = Tangent()
        if self.condensation is not None:
            set_condensed(self.A, self.condensation.constraints)
        energy, self.has_potential = forms.energy, forms.energy is not None
        self._energy = energy if energy is None else assembly.split_form(energy, V.mesh, compiler)
        self._shift = 0.0
        self._blocks: Blocks | None = None  # of the tangent
        dirichlet = assembly.dirichlet_mask(V, bcs)
        self.bcs, self.dirichlet, self.is_held = list(bcs), dirichlet, False
        self.scalars = ScalarSystem(scalars, self.u, F_u, compiler, free=~dirichlet)
        self.is_displacement, self._volume_ratio = forms.volume_ratio is not None, None
        if forms.volume_ratio is not None:
            points = quadrature_points(V.mesh, forms.degree)
            self._volume_ratio = compiler.expression(forms.volume_ratio, points)
        bs = V.dofmap.index_map_bs
        #: Local dof of V of each torn dof, (n_torn,).
        self._local = (self._space.dof[:, None] * bs + np.arange(bs)).ravel()
        self.owned = V.dofmap.index_map.size_local * bs
        self._size: Array | float = 0.0  # h, of a displacement

    def prescribe(self, bcs: Sequence[dolfinx.fem.DirichletBC]) -> None:
        """Meet other Dirichlet conditions.

        Raises:
            ValueError: They leave a scalar unknown without a solution.
        """
        dirichlet = assembly.dirichlet_mask(self.u.function_space, bcs)
        self.scalars.prescribe(bcs, free=~dirichlet)
        self.bcs, self.dirichlet, self.is_held = list(bcs), dirichlet, False
        assembly.prescribe(self.A, dirichlet)

    # -- state ------------------------------------------------------------------------------------

    @property
    def _own_u(self) -> Array:
        """Owned entries of u."""
        return self.u.x.array[: self.owned]

    def state(self) -> tuple[Array, Array, Array]:
        """Copy the state: owned entries of u, all of the condensed fields, and the scalars."""
        p = self.condensation.values() if self.condensation else np.zeros(0)
        return self._own_u.copy(), p, self.scalars.values()

    def set_state(self, state: Sequence[Array]) -> None:
        """Set the state and update ghosts."""
        self._own_u[:] = state[0]
        self.u.x.scatter_forward()
        if self.condensation:
            self.condensation.set_values(state[1])
            for p in self.condensation.fields:
                p.x.scatter_forward()
        self.scalars.set_values(state[2])

    def increment(self, here: Residual, du: Array) -> tuple[Array, Array, Array]:
        """Complete ΔU, (owned,), from a residual: increments of the state, see :meth:`state`.

        Those of the condensed fields obey their own linearised equations.
        """
        ds = self.scalars.increment
        if self.condensation is None or here.blocks is None:
            return du, np.zeros(0), ds
        whole = dolfinx.fem.Function(self.u.function_space).x
        whole.array[: self.owned] = du
        whole.scatter_forward()
        return du, self.condensation.increment(here.blocks, whole.array[self._local]), ds

    def least_volume_ratio(self) -> float:
        """Return the least det F over all quadrature points, or inf."""
        return self.comm.allreduce(on_all(self._own_volume_ratio, self.comm), op=MPI.MIN)

    def _own_volume_ratio(self) -> float:
        """Return the least det F over the quadrature points of this process."""
        if self._volume_ratio is None or not self._n_cells:
            return np.inf
        cells = np.arange(self._n_cells, dtype=np.int32)
        values = self._volume_ratio.eval(self.u.function_space.mesh, cells)
        return float(values.min()) if np.all(np.isfinite(values)) else -np.inf

    def potential(self) -> float:
        """Return Π(u), or Π(u, p) with the p that its own equation demands."""
        return self.comm.allreduce(on_all(self._own_potential, self.comm))

    def _own_potential(self) -> float:
        """Integrate the potential over the cells of this process."""
        assert self._energy is not None
        if self.condensation is None:
            return assembly.integrate(self._energy)
        before = self.condensation.values()
        try:
            self.condensation.relax()
            return assembly.integrate(self._energy) + self.condensation.held_potential()
        finally:
            self.condensation.set_values(before)

    # -- equations --------------------------------------------------------------------------------

    def residual(self) -> Residual:
        """Assemble the residual at the present state."""
        b, torn, blocks = on_all(self._own_residual, self.comm)
        b.scatter_reverse(dolfinx.la.InsertMode.add)
        force = b.array[: self.owned].copy()
        condensed = force if blocks is None else force + self._assembled(torn)
        gap = np.zeros(self.owned)
        for bc in self.bcs:
            bc.set(gap, self.u.x.array, -1.0)
        return Residual(self.free(condensed), force, gap, blocks, self.scalars.residual())

    def _own_residual(self) -> tuple[dolfinx.la.Vector, Array, Blocks | None]:
        """Assemble over the cells of this process: r_u, what condensation adds, and its blocks."""
        b = assembly.assemble_vector(self._residual, self.u.function_space)
        if self.condensation is None:
            return b, np.zeros(0), None
        blocks = self.condensation.assemble()
        return b, self.condensation.residual(blocks, len(self._local)), blocks

    def seen_by_tangent(self, here: Residual) -> Residual:
        """Return a residual with fields condensed by the matrix's own K_up and K_pp."""
        if self.condensation is None or here.blocks is None or self._blocks is None:
            return here
        blocks = replace(self._blocks, excess=here.blocks.excess)
        condensed = self._assembled(self.condensation.residual(blocks, len(self._local)))
        return replace(here, condensed=self.free(here.force + condensed), blocks=blocks)

    def linearise(self, here: Residual | None = None) -> Tangent:
        """Assemble the torn tangent and its near kernel at the present state, of this residual."""
        on_all(lambda: self._fill(here), self.comm)
        self.scalars.linearise()
        V = self.u.function_space
        attach_near_kernel(self.A, V, self._own_u.reshape(-1, V.dofmap.index_map_bs))
        return self.tangent

    def _fill(self, here: Residual | None) -> None:
        """Assemble K and, before condensation, the diagonal that weighs the copies of a dof."""
        self._shift, self.tangent = 0.0, Tangent()  # before what may fail
        assembly.assemble(self._K, self._tangent)
        if self.is_displacement:  # of the present mesh, which may have moved
            self._size = cell_sizes(self._space, self._n_cells)
        self._stiffness[:] = self._K.csr.data[self._diagonal]
        self.A.query("stiffness").array[:] = self._stiffness
        if self.condensation is not None:
            self._blocks = (here and here.blocks) or self.condensation.assemble()
            self.condensation.subtract_from(self._K, self._blocks)

    def rounding(self) -> float:
        r"""Return the size of the rounding errors of the residual, by the assembled tangent k.

        .. math:: ε\, \Bigl\| \Bigl(\sum_j k_{ij}^2 (u_j^2 + h_j^2)\Bigr)^{1/2} \Bigr\|

        h is the size of the cells, whose displacement is rounded like the ones in F = I + Grad u.
        """
        return self._root(partial(product_rounding, self._K.mat))

    def least_rounding(self) -> float:
        r"""Return less than it before condensation: :math:`ε \|k_{ii} (u_i^2 + h_i^2)^{1/2}\|`."""
        return self._root(lambda rounded: (EPS * self._stiffness * rounded) ** 2)

    def _root(self, squares: Callable[[Array], Array]) -> float:
        """Return the root of the sum over free dofs of squares, made of (u² + h²)^½, (n_torn,)."""
        torn = squares(np.hypot(self.u.x.array[self._local], self._size))
        return float(np.sqrt(self.comm.allreduce(self.free(self._assembled(torn)).sum())))

    def _assembled(self, torn: Array) -> Array:
        """Sum the copies of each owned dof, (n_torn,) → (owned,)."""
        sums = dolfinx.fem.Function(self.u.function_space).x
        sums.array[:] = np.bincount(self._local, torn, minlength=len(sums.array))
        sums.scatter_reverse(dolfinx.la.InsertMode.add)
        return sums.array[: self.owned].copy()

    def shift(self, sigma: float) -> None:
        """Let the tangent be K + σ diag|k|, k the stiffness of its own dofs, with another σ ≥ 0."""
        if sigma != self._shift:
            self._K.csr.data[self._diagonal] += (sigma - self._shift) * np.abs(self._stiffness)
            self._K.mat.stateIncrease()
            self._shift, self.tangent = sigma, Tangent()

    def multiply(self, d: Array) -> Array:
        """Return A d for the tangent that the matrix holds, (owned,)."""
        x, y = self.A.createVecs()
        x.array[:] = d
        self.A.mult(x, y)
        product = y.array_r.copy()
        for owned in (x, y):
            owned.destroy()
        return product

    def free(self, r: Array) -> Array:
        """Return a vector, (owned,), with zeros on Dirichlet dofs."""
        return np.where(self.dirichlet, 0.0, r)

    def dot(self, a: Array, b: Array) -> float:
        """Return a·b of two vectors, (owned,), of finite entries or not."""
        with np.errstate(over="ignore", invalid="ignore"):
            return float(self.comm.allreduce(a @ b))

    def norm(self, r: Array) -> float:
        """Return ‖r‖ of a vector, (owned,)."""
        return float(np.sqrt(self.dot(r, r)))

    def greatest(self, values: Array) -> float:
        """Return the greatest abs of all entries."""
        return self.comm.allreduce(float(np.abs(values).max(initial=0.0)), op=MPI.MAX)

    def reaction(self, here: Residual) -> float:
        """Return the norm of the reactions on Dirichlet dofs and of the scalars."""
        reactions = self.norm(here.force - self.free(here.force))
        return max(reactions, self.norm(self.free(self.scalars.force())))

    def boundary_moves(self, here: Residual) -> bool:
        """Tell whether Dirichlet values, or equations of scalars, are missed."""
        missed, reach = self.greatest(here.gap), self.greatest(self._own_u)
        h = np.max(self._size, initial=0.0)
        return missed > MOVED * reach or not self.scalars.met(here.scalar, self._own_u, h)

    def destroy(self) -> None:
        """Free the matrices."""
        self.A.destroy()
        self._K.mat.destroy()
