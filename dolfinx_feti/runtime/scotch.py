# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Partitions by Scotch, which dolfinx calls, that are the same in every run.

dolfinx seeds Scotch, but the result also depends on the timing of its threads and, with several
processes, on the order of messages. Two environment variables remove both effects; Scotch has no
function that does so for calls made by dolfinx. They are set only while a mesh is partitioned,
because other parts of the program may use Scotch as well.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

#: Variables of Scotch and their values: one thread; methods whose result does not depend on the
#: order of messages.
VARIABLES = {"SCOTCH_PTHREAD_NUMBER": "1", "SCOTCH_DETERMINISTIC": "1"}


@contextmanager
def repeatable_partitions() -> Iterator[None]:
    """Context in which dolfinx partitions meshes and graphs in the same way in every run.

    Variables that the user has set are not changed::

        with repeatable_partitions():
            mesh = dolfinx.mesh.create_box(comm, corners, cells)
    """
    missing = [name for name in VARIABLES if name not in os.environ]
    os.environ.update({name: VARIABLES[name] for name in missing})
    try:
        yield
    finally:
        for name in missing:
            os.environ.pop(name, None)
