# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Benchmarks: a file for each study, on the harness ``common/study.py``, and its page's template.

``python3 -m benchmarks`` lists the studies. ``python3 -m benchmarks.<study> --help`` shows the
options of one. ``--page FOLDER`` makes its page from records. A study imports ``common``, and no
other study.

To add a study, write ``<study>.py`` with a :class:`~benchmarks.common.study.Study` and
``<study>.md`` with its page, and name it below. To add a body or a solver to ``compare``, see
``common/compare/geometries.py`` and ``opponents.py``. To add a published case to ``verification``,
see ``common/verification/cases.py``.

In the order of the data: common, factors, cell_kernels, cube, verification, compare, nonlinear,
scaling, load_stepping, random_walls, distorted_cells, edit, contact.
"""

from mpi4py import MPI  # noqa: F401  before all that is linked with the MPI library
