# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Finite elements: a mesh cut into subdomains, and forms assembled on them.

Two ways lead from an integral to numbers; ``split_form`` chooses between them:

=====================  ==================================  =====================================
way                    integrals                           result
=====================  ==================================  =====================================
``cell_kernels``       over cells, of functions with       entries of eight cells at a time, by
                       scalar basis functions              one C program that reads forms as data
dolfinx                all others                          entries by FFCx's code, a file for
                                                           each form
=====================  ==================================  =====================================

If a problem has condensed fields, ``condense=p``, both ways also assemble the blocks of the mixed
tangent cell by cell, and ``condensation`` subtracts K_up K_pp⁻¹ K_pu from the local matrix.

``assembly`` adds the entries of both integrators into the local matrix K, whose diagonal blocks
belong to subdomains, and into vectors. ``torn_matrix`` wraps K for PETSc.

The files by topic ("the paper" in them is Augustin, Holzapfel, Steinbach 2014):

========================  =======================================================================
elements and meshes       elements, quadrature, nodes, facets
compilation, evaluation   cell_kernels, compiler, cell_samples
from forms to A           decomposition, split_form, assembly, torn_matrix, near_kernel
condensed fields          condensation
materials with memory     internal_variables
forms of users            user_forms
========================  =======================================================================

In the order of the data: elements, quadrature, nodes, cell_kernels, compiler, cell_samples, facets,
decomposition, split_form, assembly, torn_matrix, near_kernel, condensation, internal_variables,
user_forms.
"""
