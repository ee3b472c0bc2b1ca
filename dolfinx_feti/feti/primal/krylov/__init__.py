# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Krylov methods for A x = b on the assembled interface, a file for each.

A new method is a file like ``gmres``, a function with the contract of ``base.KrylovMethod``, and an
entry in ``registry``. The entry says with which matrices the method solves. The first entry that
serves a matrix is used, and no option chooses another one: a method after one that serves the same
matrices is never used.

``tests/feti/primal/test_krylov_methods.py`` runs each entry on a symmetric definite system. One of
its tests needs a method that stores vectors for Ritz vectors (``base.KrylovBasis``).

In the order of the data: base, conjugate_gradients, gmres, registry.
"""
