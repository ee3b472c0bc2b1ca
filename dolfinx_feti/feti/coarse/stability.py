# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Is the assembled matrix indefinite? What the coarse fields prove.

At a limit point the assembled A, and not only a subdomain alone, gets negative eigenvalues. FETI
solves then, too, but for a saddle. The motions E of the subdomains, with their copies averaged,

.. math:: V = E - E_Γ B_D^⊤ B E,

are displacements of the whole body that meet the Dirichlet conditions, so that A has at least as
many negative eigenvalues as

.. math:: A_0 = V^⊤ K V = (D - ρ^{-1} D^2) - W - W^⊤ + G^⊤ M_K G, \qquad
          W = D\, (E_Γ^⊤ R)^⊤ B_D^⊤ G

has (Courant and Fischer), the *Galerkin matrix* of the coarse fields, of the size of N: from
:math:`K E = R D` and :math:`E^⊤ R = I - D/ρ`, see ``pseudoinverse``. :math:`M_K` is the
preconditioner without props, :math:`E_Γ^⊤ K E_Γ` scaled: the Dirichlet preconditioner, or the
lumped one if another is asked for. Neither needs a product with A.

R holds the soft modes and those that buckle in a subdomain alone, and where the body buckles it
is mostly along these; but A may well have negative eigenvalues that no combination of V shows. N,
with its props and Q in the place of M, proves nothing, and may have some where A has none.
"""

from __future__ import annotations

from petsc4py import PETSc

from dolfinx_feti.feti.coarse.coarse import DIFFERENT, Coarse
from dolfinx_feti.feti.coarse.gathered import GatheredSolver
from dolfinx_feti.feti.coarse.weighted import WeightedColumns
from dolfinx_feti.feti.gluing import Gluing
from dolfinx_feti.feti.preconditioner.base import Preconditioner
from dolfinx_feti.feti.preconditioner.choice import create_preconditioner
from dolfinx_feti.feti.subdomain.blocks import own_columns
from dolfinx_feti.feti.subdomain.modes import Modes
from dolfinx_feti.torn import Torn

__all__ = ["galerkin_matrix", "negative_eigenvalues"]

#: Share of the diagonal of Gᵀ M G by which an eigenvalue of A₀ has to be negative: rounding.
ROUNDING = 1e-9


def negative_eigenvalues(
    torn: Torn,
    gluing: Gluing,
    modes: Modes,
    preconditioner: Preconditioner,
    coarse: Coarse,
    *,
    prefix: str,
) -> int | None:
    """Count negative eigenvalues of A₀, which the assembled matrix has at least.

    Args:
        torn: The torn matrix, symmetric.
        gluing: Its jump operators.
        modes: E, R, D and ρ of every subdomain.
        preconditioner: M, with its props.
        coarse: G, D and M G.
        prefix: Options prefix of the coarse solver, which factors A₀ as well.

    Returns:
        Their number, but for rounding; None if the solver does not tell.

    Note:
        Collective.
    """
    A_0 = galerkin_matrix(torn, gluing, modes, preconditioner, coarse)
    solver = GatheredSolver(A_0, prefix=prefix, symmetric=True)
    negative = solver.pivots().negative
    solver.destroy()
    A_0.destroy()
    return negative


def galerkin_matrix(
    torn: Torn,
    gluing: Gluing,
    modes: Modes,
    preconditioner: Preconditioner,
    coarse: Coarse,
) -> PETSc.Mat:
    """Form A₀ = Vᵀ K V, (K, K), for the averaged coarse fields V; see :func:`negative_eigenvalues`.

    Returns:
        A₀, with a diagonal that is larger by rounding; the caller destroys it.

    Note:
        Collective.
    """
    energy = preconditioner
    if not energy.energetic:
        energy = create_preconditioner(
            "lumped", torn, gluing, preconditioner.matrices, symmetric=True, prefix=""
        )
        energy.update(modes.props)
    MG = coarse.MG
    if MG is None or coarse.exact or energy is not preconditioner:
        MG = WeightedColumns(gluing, modes, energy)
    A_0 = MG.galerkin_matrix.copy()  # Gᵀ M₊ G
    if MG is not coarse.MG:
        MG.destroy()
    least = A_0.getDiagonal()
    least.scale(ROUNDING)
    X = gluing.B_D.transposeMatMult(coarse.G)  # X = B_Dᵀ G
    R_Γ = [energy.to_interface(i, R_i) for i, R_i in enumerate(modes.R)]
    Y_Z, R = (own_columns(torn, energy.interface, blocks) for blocks in (energy.props, R_Γ))
    H, RX = Y_Z.transposeMatMult(X), R.transposeMatMult(X)
    HH = H.transposeMatMult(H)  # Gᵀ M₊ G − Hᵀ H = Gᵀ M_K G
    W = coarse.D.matMult(RX)  # W = D (E_Γᵀ R)ᵀ B_Dᵀ G
    Wt = W.copy().transpose()
    blocks = zip(modes.D, modes.rho, strict=True)
    own = coarse.block_diagonal([D - D @ D / ρ for D, ρ in blocks])  # Eᵀ K E = D − D²/ρ
    for sign, part in ((-1.0, HH), (-1.0, W), (-1.0, Wt), (1.0, own)):
        A_0.axpy(sign, part, structure=DIFFERENT)
    A_0.setDiagonal(least, addv=PETSc.InsertMode.ADD_VALUES)
    for owned in (least, X, Y_Z, R, H, RX, HH, W, Wt, own):
        owned.destroy()
    if energy is not preconditioner:
        energy.destroy()
    return A_0
