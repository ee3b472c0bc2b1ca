# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The choice of a preconditioner by its name."""

from __future__ import annotations

from dolfinx_feti.feti.gluing import Gluing
from dolfinx_feti.feti.preconditioner.base import Preconditioner
from dolfinx_feti.feti.preconditioner.dirichlet import Dirichlet, ImplicitDirichlet
from dolfinx_feti.feti.preconditioner.identity import Identity, Unpreconditioned
from dolfinx_feti.feti.preconditioner.lumped import Lumped
from dolfinx_feti.feti.subdomain.matrices import SubdomainMatrices
from dolfinx_feti.torn import Torn

__all__ = ["PRECONDITIONERS", "create_preconditioner"]

PRECONDITIONERS: dict[str, type[Preconditioner]] = {
    "dirichlet": ImplicitDirichlet,
    "identity": Identity,
    "lumped": Lumped,
    "none": Unpreconditioned,
}


def create_preconditioner(
    kind: str,
    torn: Torn,
    gluing: Gluing,
    matrices: SubdomainMatrices,
    *,
    symmetric: bool,
    prefix: str,
) -> Preconditioner:
    """Choose the preconditioner, and for S the way it is applied.

    Args:
        kind: A key of :data:`PRECONDITIONERS`.
        torn: The torn matrix.
        gluing: Its jump operators.
        matrices: The matrix of each subdomain; S is applied as it is where these are S.
        symmetric: Whether K is symmetric.
        prefix: Options prefix of the interior factorisations.

    Note:
        Collective.
    """
    choice = PRECONDITIONERS[kind]
    if kind == "dirichlet" and matrices.condensed:
        choice = Dirichlet
    return choice(torn, gluing, matrices, symmetric=symmetric, prefix=prefix)
