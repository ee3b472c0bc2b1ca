# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Answers that are known otherwise: published numbers, a tube in closed form, inf-sup constants.

In the order of the data: part, cases, published, tube, inf_sup.
"""
