# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Scotch, with which dolfinx partitions: the same parts in every run.

dolfinx seeds Scotch before each partition. What is left to chance since Scotch 7 is the race of its
threads and, between processes, the order in which messages arrive. Two variables of the environment
settle both (Scotch and libScotch 7.0 User's Guide, environment variables); Scotch reads them at
each partition.
"""

from __future__ import annotations

import os

__all__ = ["repeat_partitions"]

#: One thread; methods whose result does not depend on the order of messages.
SETTINGS = ("SCOTCH_PTHREAD_NUMBER", "SCOTCH_DETERMINISTIC")


def repeat_partitions() -> None:
    """Let Scotch partition alike in every run; what the environment says already stays."""
    for name in SETTINGS:
        os.environ.setdefault(name, "1")
