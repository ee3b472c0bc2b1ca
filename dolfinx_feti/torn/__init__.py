# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The torn matrix, the input of the solver; its rounding errors and its null space.

``matrix`` has the class ``Torn``, from which the solver reads the matrix; the other files serve it
or take it as an argument.

In the order of the data: symmetry, connectivity, matrix, rounding, null_space.
"""
