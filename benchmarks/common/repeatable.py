# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The same decomposition in every run: Scotch draws its random numbers from a fixed seed.

It takes a seed from the clock otherwise, and the subdomains, and with them the iterations, differ
from run to run by some ten per cent. Cases that are to be compared need the same subdomains, also
those of a study that was interrupted.
"""

from __future__ import annotations

import os

__all__ = ["fix_partitions"]

#: What Scotch reads from the environment when it begins to partition.
SETTINGS = ("SCOTCH_DETERMINISTIC", "SCOTCH_RANDOM_FIXED_SEED", "SCOTCH_PTHREAD_NUMBER")


def fix_partitions() -> None:
    """Let Scotch partition alike in every run; what the environment says already stays."""
    for name in SETTINGS:
        os.environ.setdefault(name, "1")
