# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Krylov methods for A x = b on the assembled interface, a file for each.

A new method is a file like ``gmres`` and an entry in ``registry``. The file has a function with the
contract of ``base.KrylovMethod``, and a class with that of ``iteration.KrylovIteration``, which
``iteration.iterate`` steps. The entry says with which matrices the method solves.
``registry.select_method`` chooses by this; no option does.

``tests/feti/primal/test_krylov_methods.py`` runs each entry on a symmetric definite system.

In the order of the data: base, iteration, conjugate_gradients, gmres, registry.
"""
