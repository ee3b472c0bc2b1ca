# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Benchmarks: commands that write records as JSON, and the pages that are made of them.

The files of this folder are the commands, each with its own ``--help``: ``compare`` (FETI, MUMPS
and others on a Newton step or a load path), ``subdomains`` (how many), ``cube``, ``linear`` and
``cube_solvers`` (the linear study), ``tube`` and ``load_stepping`` (walls under pressure),
``nonlinear`` (iterations per Newton step), ``scaling`` (strong scaling), and for pages and pictures
``report``, ``load_figures``, ``nonlinear_page``, ``scaling_page`` and ``speed_page``. What they are
made of is in the rooms: ``unit_cube`` holds the linear study, ``walls`` the artery walls,
``nonlinear_tables`` and ``strong_scaling`` the pages of those two, ``speed`` the comparison of
solvers, and ``common`` what all need. A command imports from the rooms, a room from ``common``.

In the order of the data: common, unit_cube, walls, nonlinear_tables, strong_scaling, speed.
"""
