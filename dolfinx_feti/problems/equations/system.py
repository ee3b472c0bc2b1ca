# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The equations that Newton's method solves: residual, tangent and potential at a state.

.. math:: K'(U)\, ΔU = -r(U), \qquad U ← U + ΔU

(eq. 26 of the paper; eq. 28 for the entries), with the residual r, internal minus external forces,
and fields condensed from both sides if there are any (``condensation``). The other files of this
folder are the parts of the system.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from mpi4py import MPI

import numpy as np

import dolfinx

from dolfinx_feti.fem import assembly
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.condensation.condensation import CellMatrices, Condensation
from dolfinx_feti.fem.decomposition import Decomposition, TornSpace, tear
from dolfinx_feti.fem.split_form import SplitForm, split_form
from dolfinx_feti.problems.equations.deformation_gradient import DeformationGradient
from dolfinx_feti.problems.equations.dirichlet import DirichletConditions
from dolfinx_feti.problems.equations.state import State, StateValues
from dolfinx_feti.problems.equations.tangent import TangentId, TornTangent
from dolfinx_feti.problems.equations.torn_dofs import TornDofs
from dolfinx_feti.problems.forms import Forms
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.scalars.equations import Coupling
from dolfinx_feti.scalars.system import ScalarSystem


@dataclass(frozen=True, slots=True)
class Residual:
    """The residual at one state.

    Forces and the gaps of Dirichlet dofs, which are lengths, are separate arrays: a norm of both
    together would depend on the units.

    Attributes:
        condensed: r, forces with the fields condensed into them, zero on Dirichlet dofs, (owned,).
        force: r_u, forces before condensation; on Dirichlet dofs the reactions, (owned,).
        gap: u − g of the Dirichlet dofs, zero on the free ones, (owned,).
        blocks: Blocks of the condensed fields; None without such fields.
        of_scalars: Residuals of the scalars' equations, (scalars,).
    """

    condensed: Array
    force: Array
    gap: Array
    blocks: CellMatrices | None
    of_scalars: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def of_u(self) -> Array:
        """Residual of the equations of u: a force on free dofs, a gap on Dirichlet dofs, (owned,).

        The right-hand side of a Newton step is its negative.
        """
        return self.condensed + self.gap


class System:
    """Equations of a displacement u, condensed fields p and scalars s.

    Attributes:
        comm: Communicator.
        forms: The forms.
        state: Values of the unknowns.
        condensation: Condensed fields; None without any.
        scalars: Scalar unknowns with their equations; of size zero without any.
        conditions: Dirichlet conditions; :meth:`prescribe` replaces them.
        tangent: Torn matrix.
        torn_dofs: Map from dofs to torn dofs.
        deformation: Deformation gradient, if the forms contain one; else None.
        lengths: ``DeformationGradient.lengths`` when the last tangent was assembled, (n,); zeros
            before that, and without a deformation gradient.
        owned: Number of dofs of u that this process owns.
    """

    def __init__(
        self,
        forms: Forms,
        *,
        bcs: Sequence[dolfinx.fem.DirichletBC],
        decomposition: Decomposition,
        compiler: Compiler | None = None,
        scalars: Sequence[Coupling] = (),
        before_assembly: Callable[[], object] | None = None,
    ) -> None:
        """Tear the space and compile all forms. Collective.

        Args:
            forms: The forms.
            bcs: Dirichlet conditions.
            decomposition: Subdomain of each owned cell.
            compiler: Compiles the forms; with dolfinx's options if not given.
            scalars: Scalar unknowns with their equations.
            before_assembly: Called on all processes before the forms are assembled at a state; see
                :class:`NonlinearProblem`.
        """
        V = forms.u.function_space
        self.comm: MPI.Comm = V.mesh.comm
        self.forms = forms
        compiler = compiler or Compiler(self.comm)
        space = tear(V, decomposition)
        self.torn_dofs = TornDofs(space)
        self._F_u = split_form(forms.F_u, V.mesh, compiler)
        self._energy: SplitForm | None = None
        if forms.energy is not None:
            self._energy = split_form(forms.energy, V.mesh, compiler)
        self._contact_virtual_works = [
            compiler.form(contact.law.virtual_work) for contact in forms.contacts
        ]
        self.condensation = _create_condensation(forms, space, compiler)
        self.tangent = TornTangent(forms, space, self.torn_dofs, self.condensation, compiler)
        self.conditions = DirichletConditions(bcs, forms.u, forms.mixed)
        self.tangent.prescribe(self.conditions.mask)
        u_of_scalars = forms.u
        residual_with_scalars = forms.F_u
        if forms.scalar_forms is not None:
            u_of_scalars, residual_with_scalars = forms.scalar_forms
        self.scalars = ScalarSystem(
            scalars, u_of_scalars, residual_with_scalars, compiler, is_free=~self.conditions.mask
        )
        self.state = State(
            forms.u,
            self.condensation,
            self.scalars,
            mixed=forms.mixed,
            before_assembly=before_assembly,
        )
        self.deformation: DeformationGradient | None = None
        if forms.volume_ratio is not None:
            self.deformation = DeformationGradient(
                forms.volume_ratio,
                space,
                quadrature_degree=forms.volume_ratio_degree,
                compiler=compiler,
            )
        self.lengths: Array = np.zeros(len(self.torn_dofs.local))
        self.owned = V.dofmap.index_map.size_local * V.dofmap.index_map_bs

    def prescribe(self, bcs: Sequence[dolfinx.fem.DirichletBC]) -> None:
        """Replace the Dirichlet conditions. Collective.

        Raises:
            ValueError: They leave a scalar unknown without a solution.
        """
        conditions = DirichletConditions(bcs, self.forms.u, self.forms.mixed)
        self.scalars.prescribe(bcs, is_free=~conditions.mask)
        self.conditions = conditions
        self.tangent.prescribe(conditions.mask)

    @property
    def has_contacts(self) -> bool:
        """Whether contacts may support the body where no condition does."""
        return bool(self.forms.contacts)

    @property
    def has_potential(self) -> bool:
        """Whether the equations are derivatives of a known energy."""
        return self._energy is not None

    # -- at the present state; all collective ------------------------------------------------------

    def residual(self) -> Residual:
        """Assemble the residual."""
        self.state.call_before_assembly()  # the user may have changed the state
        b, from_fields, blocks = on_all(self._residual_on_process, self.comm)
        b.scatter_reverse(dolfinx.la.InsertMode.add)
        force = b.array[: self.owned].copy()  # r_u
        condensed = force
        if blocks is not None:
            condensed = force + self.torn_dofs.assemble(from_fields)  # r_u − K_up K_pp⁻¹ r_p
        return Residual(
            self.conditions.free(condensed),
            force,
            self.conditions.gap(),
            blocks,
            self.scalars.residual(),
        )

    def _residual_on_process(self) -> tuple[dolfinx.la.Vector, Array, CellMatrices | None]:
        """Assemble over the cells of this process.

        Returns:
            r_u with ghosts; −K_up K_pp⁻¹ r_p on the torn dofs, (n,); blocks of condensed fields.
        """
        b = assembly.assemble_vector(self._F_u, self.forms.u.function_space)
        if self.condensation is None:
            return b, np.zeros(0), None
        blocks = self.condensation.assemble()
        return b, self.condensation.residual(blocks, len(self.torn_dofs.local)), blocks

    def residual_of_last_tangent(self, residual: Residual) -> Residual:
        r"""Return a residual with fields condensed by the blocks of the tangent that A holds.

        .. math:: r = r_u - \hat K_{up} \hat K_{pp}^{-1} r_p

        Hats denote blocks of the state where the matrix was assembled. A step with them is a step
        of the mixed problem with an older tangent. The present K_up and K_pp would not match the
        condensed matrix, and the error of a step would be of the size κ ‖ΔU‖².
        """
        if self.condensation is None or residual.blocks is None or self.tangent.blocks is None:
            return residual
        blocks = replace(self.tangent.blocks, excess=residual.blocks.excess)
        from_fields = self.condensation.residual(blocks, len(self.torn_dofs.local))
        condensed = residual.force + self.torn_dofs.assemble(from_fields)
        return replace(residual, condensed=self.conditions.free(condensed), blocks=blocks)

    def linearise(self, residual: Residual | None = None) -> TangentId:
        """Assemble the tangent at the present state, without a shift.

        It goes into three places: the torn matrix, ``lengths``, and the border of the scalars.

        Args:
            residual: Residual at this state, if it is known: its blocks are not assembled again.

        Returns:
            Identity of the tangent, which is valid until the next assembly.
        """
        if residual is None:
            self.state.call_before_assembly()
        else:
            self.state.call_before_assembly_once()
        if self.deformation is not None:
            self.lengths = on_all(self.deformation.lengths, self.comm)
        blocks = None if residual is None else residual.blocks
        self.tangent.assemble(self.state.owned_u, blocks)
        self.scalars.linearise()
        return self.tangent.id

    def assembled_stiffness(self) -> Array:
        """Assemble and return the diagonal of the tangent before condensation, (owned,).

        The matrix holds no tangent of a Newton step afterwards.
        """
        self.state.call_before_assembly()
        return self.tangent.assemble_diagonal()

    def increment(self, residual: Residual, du: Array, ds: Array | None = None) -> StateValues:
        """Return ΔU of a Newton step.

        Condensed fields follow their own linearised equations, Δp = −K_pp⁻¹ (r_p + K_pu Δu).

        Args:
            residual: Residual where the step begins.
            du: Δu, (owned,).
            ds: Δs, (scalars,); zeros if not given.

        Returns:
            Δu, Δp and Δs.
        """
        if ds is None:
            ds = np.zeros(self.scalars.size)
        if self.condensation is None or residual.blocks is None:
            return StateValues(du, np.zeros(0), ds)
        dp = self.condensation.increment(residual.blocks, self.torn_dofs.tear(du))
        return StateValues(du, dp, ds)

    def smallest_volume_ratio(self) -> float:
        """Return the smallest det F over all quadrature points; ∞ if the forms contain no F."""
        if self.deformation is None:
            return np.inf
        return self.deformation.smallest_volume_ratio()

    def potential(self) -> float:
        """Return Π(u), or Π(u, p) with the p that satisfies its own equation at u."""
        self.state.call_before_assembly_once()
        return float(self.comm.allreduce(on_all(self._potential_on_process, self.comm)))

    def _potential_on_process(self) -> float:
        """Integrate the potential over the cells of this process; p stays as it is."""
        assert self._energy is not None
        if self.condensation is None:
            return assembly.integrate(self._energy)
        p = self.condensation.values()
        try:
            self.condensation.relax()
            return assembly.integrate(self._energy) + self.condensation.multiplier_potential()
        finally:
            self.condensation.set_values(p)

    def contact_forces(self) -> list[Array]:
        """Assemble the forces of each contact, (owned,)."""
        return [assembly.assemble_owned(work) for work in self._contact_virtual_works]

    def destroy(self) -> None:
        """Destroy the matrices."""
        self.tangent.destroy()


def _create_condensation(forms: Forms, space: TornSpace, compiler: Compiler) -> Condensation | None:
    """Compile what condenses the fields of a problem; None without any. Collective."""
    if not forms.field_equations:
        return None
    F_p, fields = zip(*forms.field_equations, strict=True)
    return Condensation(
        forms.F_u,
        F_p,
        forms.u,
        fields,
        space=space,
        compiler=compiler,
        tangent=forms.blocks,
        compression=None if forms.compression is None else forms.compression.terms,
    )
