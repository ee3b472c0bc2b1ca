# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Mechanics of arterial walls in UFL: kinematics, materials, loads, supports, residual stress.

"The paper" in these files is Augustin, Holzapfel, Steinbach, International Journal for Numerical
Methods in Engineering 2014 (docs/references.md). Public names are imported from the files, or from
``dolfinx_feti.kinematics``, ``.materials``, ``.loads`` and ``.supports``.

- ``trial_displacements`` has the numerical test of symmetry for loads.
- All others write energies and forms in UFL. ``supports`` also finds dashpots among the
  Constants of forms.

In the order of the data: kinematics, residual_stress, materials, memory, trial_displacements,
loads, supports.
"""
