# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Scalar unknowns coupled to u: equations, cavities with a volume, Windkessels, mean values.

In this room m is the number of scalars, and N the number of dofs that a process owns. A *coupling*
is a kind of scalars: its unknowns, their equations, and what a step of a path changes in them. A
problem has its couplings in ``scalars=``.

- What a coupling is: ``equations``; ``real_spaces`` creates them from scalars of scifem.
- Kinds: ``constraints``, ``arc_length``, ``cavity``, ``windkessel``; ``case_cavities`` has those
  of a case file, and ``couplings`` checks those of a problem.
- A step of Newton's method: ``system`` assembles the ``border`` by ``border_forms``, which derive
  it by ``derivatives``, and solves by ``bordered``: a ``bordered_system`` by block elimination with
  the ``columns`` X, and ``refinement``, all by solves of a ``matrix_solver``. ``springs`` support a
  body that is free to move; ``independence`` is checked before the first step.

In the order of the data: equations, derivatives, real_spaces, border, border_forms, independence,
springs, matrix_solver, bordered_system, columns, refinement, bordered, system, constraints,
arc_length, cavity, windkessel, couplings, case_cavities.
"""

from dolfinx_feti.scalars.arc_length import ArcLength
from dolfinx_feti.scalars.case_cavities import create_cavities
from dolfinx_feti.scalars.cavity import Cavity
from dolfinx_feti.scalars.constraints import mean_value, rigid_motions
from dolfinx_feti.scalars.equations import ScalarEquation
from dolfinx_feti.scalars.windkessel import Windkessel

__all__ = [
    "ArcLength",
    "Cavity",
    "ScalarEquation",
    "Windkessel",
    "create_cavities",
    "mean_value",
    "rigid_motions",
]
