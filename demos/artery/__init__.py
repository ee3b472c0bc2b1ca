# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The input of `demo_artery.py`: its command line, a case in a file, and how long it takes."""
