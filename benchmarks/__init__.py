# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Benchmarks: a folder for each study, which writes records as JSON and makes a page of them.

``python3 -m benchmarks.<study>`` runs a study (``run.py``, each with ``--help``), and
``python3 -m benchmarks.<study>.page`` makes its page (``page.py``, from the template ``page.md``);
``paper.py`` has the paper's numbers where there are some. The studies: ``cube``, the paper's linear
study; ``tube``, the inflated tube beside its semi-analytical solution; ``compare``, FETI beside
other solvers; ``nonlinear``, iterations per Newton step; ``scaling``, strong scaling;
``load_stepping``, walls up to 300 mmHg; ``subdomains``, how many; ``inf_sup``, which elements are
stable; ``published``, numbers that others have published; ``random_walls``, robustness. A study
knows itself and ``common``. ``edit.py`` measures the first solve with a new energy.

In the order of the data: common, cube, tube, compare, nonlinear, scaling, load_stepping,
subdomains, inf_sup, published, random_walls, edit, run.
"""

from mpi4py import MPI  # noqa: F401  before all that is linked with the MPI library
