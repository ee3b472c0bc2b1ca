# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The torn matrix, the input of the solver; its rounding errors and its null space.

The solver reads the matrix through the class ``matrix.Torn``. ``symmetry`` and ``connectivity`` are
used by that class; ``rounding`` and ``null_space`` use it.

In the order of the data: symmetry, connectivity, matrix, rounding, null_space.
"""
