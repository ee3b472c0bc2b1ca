# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Benchmarks: a file for each study, on the harness ``common/study.py``, and its page's template.

``python3 -m benchmarks`` lists the studies, ``python3 -m benchmarks.<study> --help`` says what one
takes; ``--page FOLDER`` makes its page of records. A study knows itself and ``common``.

In the order of the data: common, factors, cell_kernels, cube, verification, compare, nonlinear,
scaling, load_stepping, random_walls, distorted_cells, edit, contact.
"""

from mpi4py import MPI  # noqa: F401  before all that is linked with the MPI library
