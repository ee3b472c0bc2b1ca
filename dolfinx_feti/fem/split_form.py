# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Forms in two parts: one for the cell kernels of the package, the other for dolfinx.

======================================================  ==========================================
integral                                                assembled by
======================================================  ==========================================
over cells, of functions with scalar basis functions    kernels of the package, ``cell_kernels``
over cells, otherwise                                   FFCx's code in dolfinx's assemblers
over exterior facets and vertices                       FFCx's code in dolfinx's assemblers
over interior facets                                    a ValueError, as they couple subdomains
======================================================  ==========================================

FFCx compiles integrals over cells with second derivatives or cell sizes, and those with mixed,
H(div), H(curl) or quadrature elements.

In the form for dolfinx, test and trial functions are replaced by those of torn spaces, if these are
given. Kernels return the entries of each cell, whatever the dof map. The sums of both parts are
computed in ``assembly`` (matrices, vectors, scalars) and in ``condensation.cellwise_forms`` (arrays
cell by cell).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import dolfinx
import ufl

from dolfinx_feti.fem.cell_kernels.kernel import Kernel
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.decomposition import TornSpace
from dolfinx_feti.runtime import compat


@dataclass(frozen=True, slots=True)
class SplitForm:
    """A compiled form, the sum of two parts.

    Attributes:
        kernels: One for each region of cells and quadrature degree. Each computes this form and no
            other one, as ``Kernel.add_to`` needs it.
        dolfinx_part: All other integrals; None if there are none.
    """

    kernels: tuple[Kernel, ...]
    dolfinx_part: dolfinx.fem.Form | None


def split_form(
    form: ufl.Form, mesh: dolfinx.mesh.Mesh, compiler: Compiler, spaces: Sequence[TornSpace] = ()
) -> SplitForm:
    """Split and compile a form. Collective.

    Args:
        form: Form of any rank.
        mesh: Its mesh.
        compiler: Compiler of the problem.
        spaces: Torn space of each argument; none to compile the form as it is.

    Returns:
        The compiled parts.
    """
    generated = compiler.kernels.generate([form], mesh)
    (remaining,) = generated.remaining
    if remaining.empty():
        return SplitForm(tuple(generated.kernels), None)
    return SplitForm(tuple(generated.kernels), dolfinx_form(remaining, spaces, compiler))


def split_torn_form(form: ufl.Form, space: TornSpace, compiler: Compiler) -> SplitForm:
    """Split and compile a bilinear form for the local matrices of subdomains. Collective.

    Args:
        form: Bilinear form with both arguments in the space that is torn.
        space: The torn space.
        compiler: Compiler of the problem.

    Raises:
        ValueError: The form has integrals that couple subdomains.
    """
    check_integral_types(form)
    return split_form(form, space.V.mesh, compiler, (space, space))


def dolfinx_form(
    form: ufl.Form, spaces: Sequence[TornSpace], compiler: Compiler
) -> dolfinx.fem.Form:
    """Compile all integrals of a form by FFCx, with its arguments on torn spaces. Collective.

    Args:
        form: Form of any rank.
        spaces: Torn space of each argument, by its number; none to compile the form as it is.
        compiler: Compiler of the problem.
    """
    if not spaces:
        return compiler.form(form)
    arguments = form.arguments()
    assert all(a.number() < len(spaces) for a in arguments), "a torn space for each argument"
    torn = {a: ufl.Argument(spaces[a.number()].V_torn, a.number()) for a in arguments}
    return compiler.form(ufl.replace(form, torn))


def first_component(argument: ufl.Argument) -> ufl.core.expr.Expr:
    """Return the first component of a scalar or blocked argument, for forms of one component."""
    if not argument.ufl_shape:
        return argument
    return argument[(0,) * len(argument.ufl_shape)]


def check_integral_types(form: ufl.Form) -> None:
    """Check that a form has integrals over cells, exterior facets and vertices only.

    Raises:
        ValueError: It has others; they couple subdomains, or dolfinx is too old for them.
    """
    types = {integral.integral_type() for integral in form.integrals()}
    if "vertex" in types and not compat.has_vertex_integrals():
        raise ValueError(
            "The form has integrals over vertices, dP, which dolfinx assembles from 0.10 on: "
            "install that, or add the forces to the vector that problem.solver.solve takes."
        )
    for integral_type in sorted(types - {"cell", "exterior_facet", "vertex"}):
        name = integral_type.replace("_", "-")
        raise ValueError(
            f"The form has {name} integrals, which couple subdomains and have no torn "
            "counterpart: use a form with dx and ds only, and dP over vertices. For values "
            "on a surface inside, as of a membrane, use a ds with the cells of "
            "dolfinx_feti.fem.facets.one_side. For jumps and gradients across facets, solve the "
            "problem by dolfinx, with MUMPS."
        )
