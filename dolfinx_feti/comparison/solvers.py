# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The assembled counterpart of a torn system, and the solvers that FETI is compared with.

A solver has a name and a dict of PETSc's options. Unless the options name a Krylov method, it is CG
for a symmetric matrix and GMRES for any other. It stops by the norm of the true residual. The name
is also the prefix of the solver's options in PETSc's database, which override those of the dict.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass

from petsc4py import PETSc

from dolfinx_feti.runtime.petsc_options import inserted
from dolfinx_feti.torn.symmetry import is_symmetric

__all__ = [
    "REFERENCE",
    "SOLVERS",
    "Solver",
    "SolverKind",
    "assembled_system",
    "create_solver",
    "is_marked_symmetric",
    "relative_difference",
    "relative_residual",
]

#: Default solvers of a comparison, and their options without prefix. If the matrix is not
#: symmetric, LU replaces Cholesky. FETI and BDDC use the torn matrix, the others the assembled one.
SOLVERS: dict[str, Mapping[str, object]] = {
    "feti": {},
    "mumps": {
        "ksp_type": "preonly",
        "pc_type": "cholesky",
        "pc_factor_mat_solver_type": "mumps",
        "mat_mumps_icntl_14": 50,
    },
    "gamg": {"pc_type": "gamg"},
    "bddc": {
        "pc_type": "bddc",
        "pc_bddc_neumann_pc_factor_mat_solver_type": "mumps",
        "pc_bddc_dirichlet_pc_factor_mat_solver_type": "mumps",
    },
}

#: Name of the solver whose solution is the reference for the others, whatever its options. With the
#: options of :data:`SOLVERS`, LU factors are tried if Cholesky factors are inaccurate.
REFERENCE = "mumps"

#: Packages that PETSc may be built without, under their names in PETSc's options. A solver needs a
#: package if its ``pc_type`` or a ``pc_factor_mat_solver_type``, also of an inner solver, names it.
PACKAGES = ("mumps", "cholmod", "superlu_dist", "hypre", "ml")

#: Largest number of Krylov iterations: a choice, some twenty times what FETI needs.
MAX_IT = 2000

#: Largest number of nodes in a part of the interface for which BDDC makes each node of the part a
#: primal vertex. With PETSc's default of a single dof, a subdomain of a ragged partition may have
#: too few constraints, and the set-up fails.
VERTEX_NODES = 2


class SolverKind(enum.Enum):
    """How a solver of a comparison is created, and which matrix it gets."""

    #: By the problem, with its torn matrix.
    FETI = enum.auto()
    #: A KSP with the torn matrix.
    TORN = enum.auto()
    #: A KSP with the assembled matrix.
    ASSEMBLED = enum.auto()
    #: The reference with its default options: a KSP with the assembled matrix, created again with
    #: LU factors if Cholesky factors leave too large a residual.
    REFERENCE = enum.auto()


@dataclass(frozen=True, slots=True)
class Solver:
    """A solver of a comparison.

    Attributes:
        name: Its name.
        options: PETSc's options without prefix; empty for FETI with the options of the problem.
    """

    name: str
    options: Mapping[str, object]

    def __post_init__(self) -> None:
        """Check that the options are those of FETI, or have none of FETI.

        Raises:
            ValueError: Options of FETI and others are mixed under a name of one's own.
        """
        others = [key for key in self.options if not key.startswith("feti_")]
        if self.name != "feti" and 0 < len(others) < len(self.options):
            raise ValueError(
                f"Solver {self.name!r} mixes options of FETI with others ({', '.join(others)}): "
                "give options that begin with feti_ alone. All solvers have the tolerance of the "
                "problem."
            )

    @property
    def prefix(self) -> str:
        """The prefix of its options, such as ``gamg_elasticity_`` for ``gamg-elasticity``."""
        return self.name.replace("-", "_") + "_"

    @property
    def kind(self) -> SolverKind:
        """How it is created.

        A solver is FETI by its name, or if all of its options begin with ``feti_``. Otherwise its
        ``pc_type`` decides whether it needs the torn matrix, as BDDC does. A ``pc_type`` in PETSc's
        database takes precedence over that of ``options``.
        """
        has_options_of_feti = all(key.startswith("feti_") for key in self.options)
        if self.name == "feti" or (self.options and has_options_of_feti):
            return SolverKind.FETI
        of_user = PETSc.Options(self.prefix)
        pc_type = of_user.getString("pc_type", str(self.options.get("pc_type", "")))
        if pc_type == PETSc.PC.Type.BDDC:
            return SolverKind.TORN
        if self.name == REFERENCE and self.options == SOLVERS[REFERENCE]:
            return SolverKind.REFERENCE
        return SolverKind.ASSEMBLED

    def missing_package(self) -> str:
        """Return a package that the solver needs and PETSc lacks; empty if there is none."""
        used = {
            value
            for key, value in self.options.items()
            if key == "pc_type" or key.endswith("pc_factor_mat_solver_type")
        }
        for package in PACKAGES:
            if package in used and not PETSc.Sys.hasExternalPackage(package):
                return package
        return ""


def assembled_system(A: PETSc.Mat, b: PETSc.Vec) -> tuple[PETSc.Mat, PETSc.Vec]:
    r"""Convert a torn matrix and its right-hand side to the assembled system. Collective.

    .. math:: K = \begin{pmatrix} A_{FF} & 0 \\ 0 & I \end{pmatrix}, \qquad
        f = \begin{pmatrix} b_F - A_{FD}\, b_D \\ b_D \end{pmatrix}

    with the free dofs F and the Dirichlet dofs D, on which b holds the prescribed values.

    Args:
        A: Torn matrix (MATIS).
        b: Right-hand side, (N,).

    Returns:
        K, (N, N), marked as symmetric if the matrices of all subdomains are, with the near kernel
        and the null space of A; and f, (N,), without its component in the null space. The caller
        destroys them.
    """
    K = PETSc.Mat()
    f = b.copy()
    A.convert(PETSc.Mat.Type.AIJ, K)
    dirichlet = A.query("dirichlet")
    if dirichlet is not None:
        K.zeroRowsColumns(dirichlet.getIndices(), 1.0, b, f)
    if is_symmetric(A):
        K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    near_kernel = A.getNearNullSpace()
    if near_kernel.handle:
        K.setNearNullSpace(near_kernel)
    null_space = A.getNullSpace()
    if null_space.handle:
        K.setNullSpace(null_space)
        null_space.remove(f)
    return K, f


def is_marked_symmetric(A: PETSc.Mat) -> bool:
    """Return True if a matrix is marked as symmetric."""
    is_known, is_known_symmetric = A.isSymmetricKnown()
    return bool(is_known and is_known_symmetric)


def relative_residual(K: PETSc.Mat, f: PETSc.Vec, x: PETSc.Vec) -> float:
    """Return ‖f − K x‖/‖f‖. Collective."""
    r = f.duplicate()
    K.mult(x, r)
    r.aypx(-1.0, f)  # r = f − K x
    norm = r.norm()
    r.destroy()
    return norm / f.norm()


def relative_difference(x: PETSc.Vec, reference: PETSc.Vec) -> float:
    """Return ‖x − reference‖/‖reference‖. Collective."""
    y = x.copy()
    y.axpy(-1.0, reference)
    norm = y.norm()
    y.destroy()
    return norm / reference.norm()


def create_solver(
    A: PETSc.Mat,
    solver: str = "mumps",
    options: Mapping[str, object] | None = None,
    *,
    rtol: float = 1e-8,
    symmetric: bool | None = None,
    definite: bool = False,
) -> PETSc.KSP:
    """Set up a solver; the caller destroys it. Collective.

    Args:
        A: Assembled matrix; for BDDC the torn one, which is copied.
        solver: Name of the solver, which is also the prefix of its options in PETSc's database.
        options: Options of PETSc, without prefix; those of :data:`SOLVERS` if not given.
        rtol: Relative tolerance of a Krylov method, on the true residual.
        symmetric: Whether the matrix is symmetric; if not given, whether A is marked so.
        definite: Whether the assembled matrix is known to be symmetric positive definite.
    """
    chosen = Solver(solver, SOLVERS[solver] if options is None else options)
    if symmetric is None:
        symmetric = is_marked_symmetric(A)
    defaults = _adapted(chosen.options, A, is_symmetric=symmetric)
    dirichlet = None
    is_torn = chosen.kind is SolverKind.TORN
    if is_torn:
        dirichlet = A.query("dirichlet")
        A = _with_unit_rows(A, is_symmetric=symmetric, is_definite=definite)
        defaults.setdefault("pc_bddc_vertex_size", VERTEX_NODES * A.getBlockSize())
    of_user = PETSc.Options(chosen.prefix)  # these override ours
    defaults = {key: value for key, value in defaults.items() if not of_user.hasName(key)}
    ksp = PETSc.KSP().create(A.comm)
    ksp.setOptionsPrefix(chosen.prefix)
    ksp.setOperators(A)
    ksp.setType(PETSc.KSP.Type.CG if symmetric else PETSc.KSP.Type.GMRES)
    ksp.setTolerances(rtol=rtol, max_it=MAX_IT)
    with inserted(chosen.prefix, defaults):  # the set-up reads the options of levels and factors
        ksp.setFromOptions()
        if ksp.getType() not in (PETSc.KSP.Type.PREONLY, PETSc.KSP.Type.PYTHON):
            if ksp.getType() == PETSc.KSP.Type.GMRES:
                ksp.setPCSide(PETSc.PC.Side.RIGHT)
            ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        pc = ksp.getPC()
        if pc.getType() in (PETSc.PC.Type.CHOLESKY, PETSc.PC.Type.LU):
            pc.setFactorSetUpSolverType()
            pc.getFactorMatrix().setOptionsPrefix(chosen.prefix)  # PETSc creates it without one
        if dirichlet is not None:
            pc.setBDDCDirichletBoundaries(dirichlet)
        ksp.setUp()
    if is_torn:
        A.destroy()  # the KSP has a reference
    return ksp


def _adapted(
    options: Mapping[str, object], A: PETSc.Mat, *, is_symmetric: bool
) -> dict[str, object]:
    """Adapt the options of a direct solver to the matrix; all others remain as they are.

    Without symmetry LU replaces Cholesky. With a null space, MUMPS has to handle zero pivots.

    Args:
        options: PETSc's options without prefix.
        A: The matrix.
        is_symmetric: Whether it is symmetric.
    """
    adapted = dict(options)
    if not is_symmetric and adapted.get("pc_type") == "cholesky":
        adapted["pc_type"] = "lu"
    if adapted.get("pc_factor_mat_solver_type") == "mumps" and A.getNullSpace().handle:
        adapted.setdefault("mat_mumps_icntl_24", 1)  # zero pivots are expected
    return adapted


def _with_unit_rows(A: PETSc.Mat, *, is_symmetric: bool, is_definite: bool) -> PETSc.Mat:
    """Return a copy of a torn matrix with unit rows and columns at Dirichlet dofs. Collective.

    Args:
        A: Torn matrix.
        is_symmetric: Whether it is symmetric.
        is_definite: Whether the assembled matrix is known to be symmetric positive definite.
    """
    dirichlet = A.query("dirichlet")
    near_kernel = A.getNearNullSpace()
    B = A.duplicate(copy=True)
    if dirichlet is not None:
        B.zeroRowsColumns(dirichlet.getIndices(), 1.0)
    B.setOption(PETSc.Mat.Option.SYMMETRIC, is_symmetric)
    if is_definite:
        B.setOption(PETSc.Mat.Option.SPD, True)
    if near_kernel.handle:
        B.setNearNullSpace(near_kernel)
    return B
