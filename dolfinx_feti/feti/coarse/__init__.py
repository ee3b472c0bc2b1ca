# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The coarse problem of each formulation: columns, coarse dofs, coarse matrix, and its solver.

A *column* is a displacement of the interface that one subdomain contributes; the *coarse dof* of a
column is its amplitude. The files, by the formulation that they serve:

- both: ``basis`` evaluates all columns on the interface of each subdomain, and keeps those of one
  subdomain in a ``SubdomainColumns``; ``dofmap`` has the owners of the coarse dofs; ``assembly``
  adds up the coarse matrix; ``solver`` solves with it, by a factor of ``fronts`` or ``group``, or
  by an ``inverse``; ``null_space`` makes the coarse matrix regular if a null space is attached to
  A. The checks of ``regularity`` solve with it, too.
- primal: ``adaptive`` computes columns in addition to the motions E of the subdomains; ``averaged``
  makes V of all columns; ``energy`` combines those that depend on each other; ``products`` stores
  Vᵀ A; ``zero_energy`` detects mechanisms; ``rounding`` bounds the errors of energies;
  ``primal_problem`` has A₀ = Vᵀ A V and the projection with it.
- dual: ``weighted_columns`` stores M G; ``dual_problem`` has G = B E and N = Gᵀ Q G + D. The
  columns are the motions E and no others: N contains the defect D, which is defined for E alone.

The paper is C. M. Augustin, G. A. Holzapfel and O. Steinbach, *IJNME* 99
(2014) 290-312.

**Further columns of the primal formulation**, such as unit displacements of corner dofs, are a
function that returns columns U_i of each subdomain, (n_{Γ,i}, any number), as ``adaptive`` does.
``primal.preconditioner`` appends them to E, before it computes adaptive columns. Nothing else
changes: owners, blocks and matrices follow from the widths of the U_i. An option for such columns
is a field of ``options.FETIOptions``, which ``Pattern.options`` has. An example is
``corner_columns`` in tests/feti/coarse/test_primal_problem.py: it takes the dofs with more than two
copies, which are corners in 2-D; in 3-D they are edges as well. For corners alone, take the nodes
whose set of subdomains no other node has.

**Columns in place of E** change more, because these parts rely on the span of V containing E:

- ``adaptive`` gets K⁺ as S_ρ⁻¹. They are equal only for forces F with Eᵀ F = 0, which U₀ = E
  ensures. Without E, pass ``SubdomainInverse.solve_regularised_on_interface``, which takes
  columns, too; or leave out adaptive columns.
- ``primal.soft_fields`` applies K⁺ instead of K_ρ⁻¹. The difference lies in the span of E.
- The check for mechanisms (``primal.formulation``) looks for fields of zero energy in the span of
  V. Without E it misses mechanisms outside of it.
- ``primal.formulation`` takes it that the spectrum begins at one unless stress softens a subdomain.
  Without E that is not so: compute soft fields always, or never.
- The number of negative eigenvalues of A₀ becomes a weaker bound of that of A, because buckling
  modes are part of E.
- Soft modes are part of E alone: set ``feti_coarse_modes 0``.
- A₀ is made regular along a given null space of A only if the span of V contains it.

In all cases M remains Tᵀ δ K_ρ⁻¹ δ T: its subdomain solves are not constrained at coarse dofs, as
those of BDDC and FETI-DP are.

A column has one contributor. Averaging spreads it to the neighbours: the unit vector of a dof in
one of its copies becomes δ times that of the assembled dof. If several subdomains contributed it,
their averages would be multiples of one field. That is allowed, but A₀ then has a zero pivot for
each repetition, and MUMPS factors it in place of the faster fronts. To select one contributor of a
dof, take the copy with the smallest number: ``Copies.pair_copies`` numbers the copies of each row
over all processes. Rows with a prescribed value have no pairs, and their columns average to zero.

In the order of the data: adaptive, basis, rounding, dofmap, assembly, averaged, energy, group,
fronts, inverse, solver, null_space, products, zero_energy, primal_problem, weighted_columns,
dual_problem.
"""
