# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Static condensation of fields whose dofs no two cells share, such as pressures and dilations.

To read in this order: ``condensed_fields`` numbers the dofs of all fields. ``mixed_tangent``
derives the blocks K_up, K_pu and K_pp as forms. ``cellwise_forms`` assembles forms into one array
for each, cell by cell. ``cell_inverse`` inverts K_pp in each cell. ``cell_means`` computes the
means by which changes of multipliers are judged, ``multipliers`` keeps what these add to the
equations. ``condensation`` subtracts K_up K_pp⁻¹ K_pu from the local matrix, by a loop in C. One
field and several are treated alike: an array of a cell has the dofs of all fields, field by field.

An element with several condensed fields needs no new code: the user lists the fields in
``condense``. Together they have to be determined in each cell. If only the sum of two fields occurs
in an energy, K_pp is singular where their spaces have a function in common.

In the order of the data: condensed_fields, mixed_tangent, cellwise_forms, cell_inverse, cell_means,
multipliers, condensation.
"""
