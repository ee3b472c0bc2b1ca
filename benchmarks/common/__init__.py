# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What all benchmarks need: command lines, records, the machine, simple bodies, tables.

In the order of the data: records, arguments, machine, clock, stopwatch, repeatable, traffic,
progress, bodies, table, pages.
"""
