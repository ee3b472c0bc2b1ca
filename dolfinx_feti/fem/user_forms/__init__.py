# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Forms as the user writes them: what is wrong with them, and what they contain.

=======================  ==========================================================================
``checks``               spaces, ranks, meshes and condensed fields, before any work
``deformation``          deformation gradients in the forms, of which det F has to stay positive
``random_fields``        the numerical tests by which ``deformation`` recognises them
``forgotten_pressures``  pressures of an energy that are neither unknowns nor condensed
``form_content``         Functions, Constants and a signature, for a checkpoint
=======================  ==========================================================================

``problems`` calls ``checks`` and ``deformation`` before it compiles the forms;
``forgotten_pressures`` compiles forms of its own, and ``form_content`` serves ``loading``.

In the order of the data: checks, random_fields, deformation, forgotten_pressures, form_content.
"""
