# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""``python3 -m benchmarks.cube``."""

import sys

from benchmarks.cube.run import main

sys.exit(main())
