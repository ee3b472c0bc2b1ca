# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""PETSc's iterative solvers to compare FETI with, set up for elasticity: GAMG, BoomerAMG and BDDC.

All of them run CG on a symmetric matrix and GMRES on another one, until the norm of the true
residual has fallen by the same factor. Options with the prefixes ``gamg_``, ``hypre_``, ``bddc_``
(and ``mumps_``, see ``assembled``) change them.
"""

from __future__ import annotations

from collections.abc import Mapping

from petsc4py import PETSc

from dolfinx_feti.runtime.petsc_options import inserted

__all__ = ["create_bddc", "create_gamg", "create_hypre", "missing"]

MAX_IT = 2000

#: Solvers that PETSc has from packages which it may be built without.
PACKAGES = {"mumps": "mumps", "hypre": "hypre"}

#: Parts of the interface of up to so many nodes are primal in BDDC as they are. PETSc's default is
#: one dof; then set-up may fail, as a subdomain of a ragged partition is held too loosely.
VERTEX_NODES = 2


def create_gamg(K: PETSc.Mat, *, rtol: float) -> PETSc.KSP:
    """Return a Krylov method with smoothed aggregation and the near kernel of the matrix.

    Args:
        K: Assembled matrix.
        rtol: On the true residual.

    Returns:
        The KSP, with the prefix ``gamg_``; the caller destroys it.
    """
    return _krylov(K, "gamg_", PETSc.PC.Type.GAMG, rtol)


def create_hypre(K: PETSc.Mat, *, rtol: float) -> PETSc.KSP:
    """Return a Krylov method with BoomerAMG, which takes the unknowns of a node together.

    Args:
        K: Assembled matrix.
        rtol: On the true residual.

    Returns:
        The KSP, with the prefix ``hypre_``; the caller destroys it.
    """
    return _krylov(K, "hypre_", PETSc.PC.Type.HYPRE, rtol)


def create_bddc(A: PETSc.Mat, *, rtol: float, symmetric: bool, definite: bool) -> PETSc.KSP:
    """Return a Krylov method with balancing domain decomposition by constraints.

    The subdomains are FETI's. Primal are small parts of the interface, and on edges and faces the
    averages that PETSc takes from the near kernel; the local factors are MUMPS's, as FETI's.

    Args:
        A: Torn matrix. The solver works on a copy with unit rows and columns at Dirichlet dofs.
        rtol: On the true residual.
        symmetric: Whether the assembled matrix is symmetric.
        definite: Whether it is known to be symmetric positive definite.

    Returns:
        The KSP, with the prefix ``bddc_``; the caller destroys it.

    Note:
        Collective.
    """
    dirichlet = A.query("dirichlet")
    B = A.duplicate(copy=True)
    if dirichlet is not None:
        B.zeroRowsColumns(dirichlet.getIndices(), 1.0)
    B.setOption(PETSc.Mat.Option.SYMMETRIC, symmetric)
    if definite:
        B.setOption(PETSc.Mat.Option.SPD, True)
    near_kernel = A.getNearNullSpace()
    if near_kernel.handle:
        B.setNearNullSpace(near_kernel)
    ksp = _krylov(
        B,
        "bddc_",
        PETSc.PC.Type.BDDC,
        rtol,
        defaults={
            "pc_bddc_vertex_size": VERTEX_NODES * A.getBlockSize(),
            "pc_bddc_neumann_pc_factor_mat_solver_type": "mumps",
            "pc_bddc_dirichlet_pc_factor_mat_solver_type": "mumps",
        },
    )
    if dirichlet is not None:
        ksp.getPC().setBDDCDirichletBoundaries(dirichlet)
    B.destroy()  # the KSP keeps it
    return ksp


def missing(name: str) -> str:
    """Say why this PETSc has no solver of this name, or nothing if it has.

    Args:
        name: ``feti``, ``mumps``, ``gamg``, ``hypre`` or ``bddc``.
    """
    package = PACKAGES.get(name)
    if package is not None and not PETSc.Sys.hasExternalPackage(package):
        return f"this PETSc was built without {package}"
    return ""


def _krylov(
    A: PETSc.Mat,
    prefix: str,
    preconditioner: str,
    rtol: float,
    defaults: Mapping[str, object] | None = None,
) -> PETSc.KSP:
    """Return CG or GMRES with a preconditioner, set from the options; those given are defaults."""
    ksp = PETSc.KSP().create(A.comm)
    ksp.setOptionsPrefix(prefix)
    ksp.setOperators(A)
    if all(A.isSymmetricKnown()):
        ksp.setType(PETSc.KSP.Type.CG)
    else:
        ksp.setType(PETSc.KSP.Type.GMRES)
        ksp.setPCSide(PETSc.PC.Side.RIGHT)
    ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
    ksp.setTolerances(rtol=rtol, max_it=MAX_IT)
    ksp.getPC().setType(preconditioner)
    users = PETSc.Options(prefix)
    unset = {k: v for k, v in (defaults or {}).items() if not users.hasName(k)}
    with inserted(prefix, unset):
        ksp.setFromOptions()
    return ksp
