# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Detection and description of motions that the assembled matrix does not resist.

``detection`` is what the formulations call: it raises a SingularError, or returns. A *motion* is a
single-valued displacement w of the torn dofs, (n,), with A w = 0 to rounding accuracy: a rigid
motion of a body, or a mechanism.

The constants of these files are margins between rounding and resistance. Where a comment says that
half of one changes no test, all of these were halved together, and tests/feti/regularity passed.

In the order of the data: bodies, tsqr, scaled_assembled, rigid_motions, coarse_matrix, messages,
detection.
"""
