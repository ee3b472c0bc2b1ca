# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Options of PETSc's sub-solvers on which decisions of this package depend.

PETSc reads the same options, and all others, when it sets up a sub-solver. Words are read here
without being marked as used in PETSc's database: if a sub-solver is never created, its options are
reported as unread. Numbers are marked as used here, so that they are never reported.
"""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

from dolfinx_feti.feti.krylov_limits import GMRES_DIRECTIONS

#: Prefix of the Krylov method for (λ, s), after ``…feti_``.
DUAL_PREFIX = "dual_"

#: Prefix of the factors of K_ρ.
LOCAL_PREFIX = "local_"

#: Prefix of the factors of K_II.
DIRICHLET_PREFIX = "dirichlet_"

#: Prefix of the solver of the coarse matrix N or A₀.
COARSE_PREFIX = "coarse_"

#: Prefixes of the sub-solvers, and those of the options that PETSc reads for them.
OPTIONS_OF_SUBSOLVERS = {
    DUAL_PREFIX: ("ksp_",),
    LOCAL_PREFIX: ("pc_", "mat_"),
    DIRICHLET_PREFIX: ("pc_", "mat_"),
    COARSE_PREFIX: ("ksp_", "pc_", "mat_"),
}

#: No limit: the largest integer of PETSc with 32-bit integers.
UNLIMITED = 2**31 - 1


@dataclass(frozen=True, slots=True)
class KrylovOptions:
    """Options of PETSc's Krylov method for (λ, s), ``-…feti_dual_ksp_…``.

    Attributes:
        prefix: Options prefix, ``…feti_dual_``.
        is_given: Whether any option begins with it.
        ksp_type: ``ksp_type``, PETSc's name of the method; None if not given.
        has_tolerance: Whether rtol or atol is given. Then PETSc's test ends the method, instead of
            one of the residual of the assembled system.
        has_norm_type: Whether the norm for PETSc's test is given.
        fcg_mmax: Largest number of directions that flexible CG stores; by default all.
        gmres_restart: Iterations after which GMRES restarts.
    """

    prefix: str
    is_given: bool = False
    ksp_type: str | None = None
    has_tolerance: bool = False
    has_norm_type: bool = False
    fcg_mmax: int = UNLIMITED
    gmres_restart: int = GMRES_DIRECTIONS


@dataclass(frozen=True, slots=True)
class DirectOptions:
    """Options of a direct solver, ``-…feti_coarse_…`` for instance.

    Attributes:
        prefix: Options prefix.
        ksp_type: ``ksp_type``; None if not given.
        pc_type: ``pc_type``; likewise.
        package: ``pc_factor_mat_solver_type``; likewise.
    """

    prefix: str
    ksp_type: str | None = None
    pc_type: str | None = None
    package: str | None = None

    @property
    def names_solver(self) -> bool:
        """Whether a solver of PETSc's replaces this package's multifrontal factors."""
        return any(name is not None for name in (self.ksp_type, self.pc_type, self.package))

    @property
    def allows_ldlt(self) -> bool:
        """Whether MUMPS may factor by L Δ Lᵀ: no other package or factorisation is set."""
        return self.package in (None, "mumps") and self.pc_type in (None, "cholesky")


@dataclass(frozen=True, slots=True)
class SubsolverOptions:
    """Options of the sub-solvers.

    Attributes:
        prefix: Options prefix of all of them, ``…feti_``.
        dual: The Krylov method for (λ, s).
        local: The factors of K_ρ.
        dirichlet: The factors of K_II.
        coarse: The solver of N or A₀.
    """

    prefix: str = "feti_"
    dual: KrylovOptions = KrylovOptions("feti_dual_")
    local: DirectOptions = DirectOptions("feti_local_")
    dirichlet: DirectOptions = DirectOptions("feti_dirichlet_")
    coarse: DirectOptions = DirectOptions("feti_coarse_")


def read_subsolver_options(prefix: str) -> SubsolverOptions:
    """Read the options ``-<prefix>feti_<sub-solver>_…``.

    Args:
        prefix: Options prefix of the KSP.
    """
    feti_prefix = f"{prefix}feti_"
    return SubsolverOptions(
        feti_prefix,
        dual=read_krylov_options(feti_prefix + DUAL_PREFIX),
        local=read_direct_options(feti_prefix + LOCAL_PREFIX),
        dirichlet=read_direct_options(feti_prefix + DIRICHLET_PREFIX),
        coarse=read_direct_options(feti_prefix + COARSE_PREFIX),
    )


def read_krylov_options(prefix: str) -> KrylovOptions:
    """Read the options of the Krylov method for (λ, s) under its prefix."""
    given = options_under(prefix)
    options = PETSc.Options(prefix)
    return KrylovOptions(
        prefix,
        is_given=bool(given),
        ksp_type=given.get("ksp_type"),
        has_tolerance="ksp_rtol" in given or "ksp_atol" in given,
        has_norm_type="ksp_norm_type" in given,
        fcg_mmax=_count_or_unlimited(options, "ksp_fcg_mmax", default=UNLIMITED),
        gmres_restart=_count_or_unlimited(options, "ksp_gmres_restart", default=GMRES_DIRECTIONS),
    )


def read_direct_options(prefix: str) -> DirectOptions:
    """Read the options of a direct solver under its prefix."""
    given = options_under(prefix)
    return DirectOptions(
        prefix,
        ksp_type=given.get("ksp_type"),
        pc_type=given.get("pc_type"),
        package=given.get("pc_factor_mat_solver_type"),
    )


def options_under(prefix: str) -> dict[str, str]:
    """Return the options of PETSc's database under a prefix, without it, not marked as used."""
    return {
        key.removeprefix(prefix): value or ""  # None of a flag
        for key, value in PETSc.Options().getAll().items()
        if key.startswith(prefix)
    }


def _count_or_unlimited(options: PETSc.Options, name: str, *, default: int) -> int:
    """Return a count from the options; PETSc reads ``unlimited`` as a negative number."""
    count = int(options.getInt(name, default))
    return count if count > 0 else UNLIMITED
