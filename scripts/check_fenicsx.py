# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Check if this Python has the required FEniCSx: exit status, and one line on stderr if not.

Run by `scripts/with-fenicsx` and `scripts/debian-tree`. With the argument `docs`, what `make docs`
imports has to be installed, too.
"""

import sys
from importlib.util import find_spec

NEEDED = ["dolfinx", "petsc4py", "mpi4py"]
DOCS = ["gmsh", "ipykernel", "jupytext", "matplotlib", "meshio", "myst_nb", "nbclient"]
DOCS += ["pyvista", "sphinx", "sphinx_book_theme", "sphinx_copybutton", "sphinx_design"]

for name in NEEDED + (DOCS if sys.argv[1:] == ["docs"] else []):
    if find_spec(name) is None:
        sys.exit(f"it has no {name}")

try:
    from mpi4py import MPI  # noqa: F401  before all that is linked with the MPI library
    from petsc4py import PETSc

    import numpy as np

    import dolfinx
except Exception as error:
    sys.exit(f"its dolfinx cannot be imported ({error})")

if tuple(int(part) for part in dolfinx.__version__.split(".")[:2]) < (0, 9):
    sys.exit(f"its dolfinx is {dolfinx.__version__}")
if PETSc.ScalarType is not np.float64:
    sys.exit(f"its petsc4py computes with {np.dtype(PETSc.ScalarType).name}")
