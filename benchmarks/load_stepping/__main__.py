# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""``python3 -m benchmarks.load_stepping``; words with a single dash are options of PETSc."""

import sys

import petsc4py

petsc4py.init([word for word in sys.argv if not word.startswith("--")])

from benchmarks.load_stepping.run import main

sys.exit(main())
