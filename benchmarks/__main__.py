# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""``python3 -m benchmarks``: the list of studies."""

from benchmarks.run import main

main()
