# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Cell integrals without FFCx's code: forms are data for one C program, eight cells at a time.

From UFL to numbers:

1. ``integrand``: an integrand at one quadrature point becomes a list of scalar instructions, the
   ``tape``.
2. ``program``: tables of basis functions and the sums over points are added. A program is data.
3. ``kernel``: the C program ``kernel.c``, with the instructions in ``tape.h``, runs the data for
   eight cells at a time.
4. ``generator``: forms are split into ``regions`` of cells, each region gets kernels, and integrals
   without kernels remain for FFCx.

``docs/results/cell_kernels.md`` has the measured gain, and the private parts of FFCx that are used.

In the order of the data: tape, integrand, program, kernel, regions, generator.
"""
