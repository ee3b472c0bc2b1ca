# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""``python3 -m benchmarks.load_stepping``; words with a single dash are options of PETSc."""

import sys

import petsc4py

from meshes.arguments import without_petsc

petsc4py.init([sys.argv[0], *without_petsc(sys.argv[1:])[1]])

from benchmarks.load_stepping.run import main

sys.exit(main())
