# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The solvers of an assembled matrix, and PETSc's BDDC of the torn one, with their settings.

Krylov methods are CG on a symmetric matrix and GMRES on another one, and lower the norm of the true
residual. Each function returns a solver that is set up, with the prefix of its name.
"""

from __future__ import annotations

from petsc4py import PETSc

from dolfinx_feti.comparison.pardiso import Pardiso
from dolfinx_feti.comparison.settings import in_force, prefix_of

__all__ = ["MAX_IT", "create_bddc", "create_direct", "create_multigrid", "ordering"]

MAX_IT = 2000

#: Parts of the interface of up to so many nodes are primal in BDDC as they are. PETSc's default is
#: one dof; then set-up may fail, as a subdomain of a ragged partition is held too loosely.
VERTEX_NODES = 2

#: MUMPS's orderings, by INFOG(7).
ORDERINGS = {0: "AMD", 2: "AMF", 3: "SCOTCH", 4: "PORD", 5: "METIS", 6: "QAMD"}


def create_direct(
    K: PETSc.Mat,
    solver: str = "mumps",
    *,
    symmetric: bool | None = None,
    definite: bool = False,
    rtol: float = 1e-8,
) -> PETSc.KSP:
    """Factor a matrix.

    Args:
        K: Assembled matrix.
        solver: ``mumps``, ``mumps-blr``, ``cholmod`` or ``pardiso``.
        symmetric: Whether the factorisation is; if K is marked as symmetric where not given.
        definite: Whether K is known to be symmetric positive definite, for PARDISO; the others are
            told by the matrix.
        rtol: On the true residual, where the factors are approximate.

    Returns:
        The KSP; the caller destroys it.

    Note:
        Collective.
    """
    if symmetric is None:
        symmetric = all(K.isSymmetricKnown())
    approximate = solver == "mumps-blr"
    ksp = _krylov(K, solver, rtol) if approximate else PETSc.KSP().create(K.comm)
    if not approximate:
        ksp.setOptionsPrefix(prefix_of(solver))
        ksp.setOperators(K)
        ksp.setType(PETSc.KSP.Type.PREONLY)
    pc = ksp.getPC()
    with in_force(solver):
        if solver == "pardiso":
            pc.setType(PETSc.PC.Type.PYTHON)
            pc.setPythonContext(Pardiso(symmetric=symmetric, definite=definite))
        else:
            pc.setType(PETSc.PC.Type.CHOLESKY if symmetric else PETSc.PC.Type.LU)
            pc.setFactorSolverType(solver.split("-")[0])
            pc.setFactorSetUpSolverType()
            factor = pc.getFactorMatrix()
            factor.setOptionsPrefix(prefix_of(solver))  # it was made before the options are read
            if solver != "cholmod" and K.getNullSpace().handle:
                factor.setMumpsIcntl(24, 1)  # zero pivots are expected
        ksp.setFromOptions()
        ksp.setUp()
    return ksp


def create_multigrid(K: PETSc.Mat, solver: str = "gamg", *, rtol: float) -> PETSc.KSP:
    """Set up a Krylov method with algebraic multigrid.

    Args:
        K: Assembled matrix, with a near kernel.
        solver: ``gamg``, ``gamg-elasticity``, ``hypre`` or ``hypre-elasticity``.
        rtol: On the true residual.

    Returns:
        The KSP; the caller destroys it.

    Note:
        Collective.
    """
    ksp = _krylov(K, solver, rtol)
    ksp.getPC().setType(solver.split("-")[0])
    with in_force(solver):
        ksp.setFromOptions()
        ksp.setUp()
    return ksp


def create_bddc(
    A: PETSc.Mat, solver: str = "bddc", *, rtol: float, symmetric: bool, definite: bool
) -> PETSc.KSP:
    """Set up a Krylov method with balancing domain decomposition by constraints.

    The subdomains are FETI's. Primal are small parts of the interface, and on edges and faces the
    averages that PETSc takes from the near kernel; the local factors are MUMPS's.

    Args:
        A: Torn matrix. The solver works on a copy with unit rows and columns at Dirichlet dofs.
        solver: ``bddc`` or ``bddc-deluxe``.
        rtol: On the true residual.
        symmetric: Whether the assembled matrix is symmetric.
        definite: Whether it is known to be symmetric positive definite.

    Returns:
        The KSP; the caller destroys it.

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
    ksp = _krylov(B, solver, rtol)
    ksp.getPC().setType(PETSc.PC.Type.BDDC)
    with in_force(solver, pc_bddc_vertex_size=VERTEX_NODES * A.getBlockSize()):
        ksp.setFromOptions()
        if dirichlet is not None:
            ksp.getPC().setBDDCDirichletBoundaries(dirichlet)
        ksp.setUp()
    B.destroy()  # the KSP keeps it
    return ksp


def ordering(ksp: PETSc.KSP) -> str:
    """Tell how the rows of a direct solver's matrix were ordered; nothing of another solver.

    MUMPS tells by INFOG(7); CHOLMOD takes the better one of two, and does not tell which.
    """
    pc = ksp.getPC()
    if pc.getType() == PETSc.PC.Type.PYTHON:
        return "METIS"  # PARDISO's default
    if pc.getType() not in (PETSc.PC.Type.CHOLESKY, PETSc.PC.Type.LU):
        return ""
    if pc.getFactorSolverType() != PETSc.Mat.SolverType.MUMPS:
        return "AMD or METIS"
    found = int(pc.getFactorMatrix().getMumpsInfog(7))
    return ORDERINGS.get(found, f"INFOG(7) = {found}")


def _krylov(A: PETSc.Mat, solver: str, rtol: float) -> PETSc.KSP:
    """Return CG or GMRES on the true residual."""
    ksp = PETSc.KSP().create(A.comm)
    ksp.setOptionsPrefix(prefix_of(solver))
    ksp.setOperators(A)
    if all(A.isSymmetricKnown()):
        ksp.setType(PETSc.KSP.Type.CG)
    else:
        ksp.setType(PETSc.KSP.Type.GMRES)
        ksp.setPCSide(PETSc.PC.Side.RIGHT)
    ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
    ksp.setTolerances(rtol=rtol, max_it=MAX_IT)
    return ksp
