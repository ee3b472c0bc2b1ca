# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Names of array types, by what the numbers are."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Single = npt.NDArray[np.float32]

#: dofs, nodes and cells of one process, as dolfinx and PETSc number them.
Indices = npt.NDArray[np.int32]

#: Those of all processes, and counts.
Numbers = npt.NDArray[np.int64]

Integers = npt.NDArray[np.integer]
Mask = npt.NDArray[np.bool_]
