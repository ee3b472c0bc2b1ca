# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What depends on the pattern of a torn matrix alone: dofs, gluing, and orders of elimination."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from functools import partial

from petsc4py import PETSc

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.feti.gluing.bodies import Bodies, find_bodies
from dolfinx_feti.feti.gluing.jump import Dofs, Gluing, sort_dofs
from dolfinx_feti.feti.options import FETIOptions, asks_for_dual
from dolfinx_feti.feti.subdomain.analysis import Analysis, analyse
from dolfinx_feti.runtime.connectivity import has_joined_copies
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.matrix import Torn


@dataclass(frozen=True, slots=True)
class Pattern:
    """The symbolic part of the method; no number of a matrix is in it.

    Attributes:
        options: The choices made.
        prefix: Options prefix of the sub-solvers, ``…feti_``.
        torn: Subdomains and copies; its products are those of the present matrix.
        symmetric: Whether K is symmetric, which the factors rely on.
        bodies: The connected components of the assembled problem.
        gluing: The jumps B.
        dofs: Interface and interior of each subdomain.
        analysis: How the blocks of the subdomains are factored.
        of_part: The same of ½ (K + Kᵀ), if K is not symmetric.
    """

    options: FETIOptions
    prefix: str
    torn: Torn
    symmetric: bool
    bodies: Bodies
    gluing: Gluing
    dofs: Dofs
    analysis: Analysis
    of_part: Analysis | None


def create_pattern(A: PETSc.Mat, options: FETIOptions, prefix: str, within: Lifetime) -> Pattern:
    """Build what depends on the pattern, for an owner of its objects. Collective.

    Raises:
        SetUpError: A subdomain holds two copies of a dof; or K is not symmetric, but has to be.
    """
    prefix += "feti_"
    torn = within.own(Torn(A))
    if has_joined_copies(A, torn.subdomains):
        raise SetUpError(
            "A subdomain holds two copies of a dof: the local matrix couples subdomains that "
            "share it. Remove these entries, or tear the mesh so that they are one subdomain."
        )
    symmetric = torn.is_symmetric()
    if not symmetric:
        _require_primal(options, prefix)
    with event("FETIGluing"):
        gluing = within.own(Gluing(torn, all_floating=options.all_floating))
    dofs = sort_dofs(torn, gluing.glued, all_floating=options.all_floating)
    find = partial(
        analyse,
        dofs=dofs,
        choice=options.interior,
        with_interior=options.pc_type == "dirichlet",
        prefix=prefix,
    )
    of_part: Analysis | None = None
    with event("FETIFactor"):
        analysis = find(torn, symmetric=symmetric)
        if not symmetric:
            with symmetric_part(torn) as part:
                of_part = find(part, symmetric=True)
    bodies = find_bodies(torn)
    return Pattern(options, prefix, torn, symmetric, bodies, gluing, dofs, analysis, of_part)


def _require_primal(options: FETIOptions, prefix: str) -> None:
    """Refuse options of which none is for an unsymmetric matrix."""
    dual = asks_for_dual(options, prefix)
    needed = {
        "formulation": "primal" if dual else "",
        "pc_type": "dirichlet" if options.pc_type != "dirichlet" else "",
        "interior": "keep" if options.interior == "eliminate" else "",
    }
    if any(needed.values()):
        use = " ".join(f"-{prefix}{name} {value}" for name, value in needed.items() if value)
        raise SetUpError(
            "The matrix is not symmetric, which takes GMRES in the primal form, with the interior "
            f"kept: use {use}."
        )


@contextmanager
def symmetric_part(torn: Torn) -> Iterator[Torn]:
    """Yield the torn matrix with ½ (K + Kᵀ) and its pattern in the place of K's. Collective."""
    part, K = copy(torn), torn.K.copy()
    transposed = torn.K.transpose(PETSc.Mat())
    K.axpy(1.0, transposed, structure=PETSc.Mat.Structure.UNKNOWN_NONZERO_PATTERN)
    K.scale(0.5)
    transposed.destroy()
    part.K = K
    try:
        part.read_pattern()
        yield part
    finally:
        K.destroy()
