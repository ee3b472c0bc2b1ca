# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The dual formulation, the paper's method, with unknowns (λ, s).

λ are the multipliers of the gluing, and s the amplitudes of the motions of the subdomains. In one
solve, ``DualFormulation.solve`` calls, in this order,

1. ``DualSystem.start`` for λ₀ and s₀, which balance the load (``system``),
2. ``krylov.solve`` for what has to be added to them (``krylov``, on the operators of ``system``),
3. ``recover`` for the displacement u of λ and s (``recovery``).

The constraints are in ``interface/gluing``, M in ``preconditioners``, and the coarse problem in
``coarse/dual_problem``.

Arrays and their shapes are those of one process: (m,) are its multipliers, (n_c,) the coarse
unknowns of its subdomains, (n,) its torn dofs. The *dofs of K⁺* are all torn dofs if the interior
is kept, and those of the interface if it is eliminated; arrays on them are (n,) in both cases, and
their interior entries count in the first case alone. Equations "(eq. 47)" are those of Augustin,
Holzapfel, Steinbach 2014.

Comments on constants name one set of measurements. The *jump grids* are plane elasticity on 6 and
20 subdomains with 3 × 3 and 4 × 4 cells each. The stiffness jumps by 1, 10², 10⁴ or 10⁶ between
neighbours, and multiplicity scaling ignores it. Their solves have tolerances of 1e-4 to 1e-13.

In the order of the data: system, krylov, recovery, formulation.
"""
