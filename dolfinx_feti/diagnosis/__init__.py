# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Diagnosis of a problem: what a solver built, where its time went, and what would help.

A new piece of advice is a constant and an ``if`` in ``advice``. If no figure has its quantity yet,
``figures`` measures it.

In the order of the data: figures, advice, cell_volumes, cell_check, run.
"""
