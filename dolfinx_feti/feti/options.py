# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Options of the solver, read from PETSc's database and checked.

An option ``-<prefix>feti_…`` is a field of :class:`FETIOptions`, with its default. Its type
determines the allowed values: one of the words of a ``Literal``, a count for an int
(:data:`COUNT`), a share between 0 and 1 for a float (:data:`SHARE`). A new field needs no further
code to be read, checked, and proposed for a misspelt name. All parts of the solver have it in
``Pattern.options``. docs/options.md explains each option.

The file has three parts: the options of the solver, checks of the numbers that PETSc reads, and
proposals for options that are unknown or unread.

Options of PETSc's solvers are checked here, because PETSc reports a wrong one by an error number;
``subsolver_options`` has those that this package reads.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal, get_args, get_type_hints

from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_feti.feti.interface.scaling import SCALINGS
from dolfinx_feti.feti.preconditioners.registry import PRECONDITIONERS
from dolfinx_feti.feti.subsolver_options import (
    COARSE_PREFIX,
    DUAL_PREFIX,
    OPTIONS_OF_SUBSOLVERS,
    SubsolverOptions,
    options_under,
)
from dolfinx_feti.runtime.collective import warn

#: Krylov methods of the dual form. PETSc's other ones need transposed products, do not give access
#: to the iterate in each iteration, or were not tested against a direct solver.
DUAL_METHODS = ("cg", "fcg", "groppcg", "pipecg", "cr", "minres", "gmres", "fgmres")

#: The value of ``pc_type`` with which the primal formulation may be used. Any other one is a
#: preconditioner that only the dual formulation has, and selects it.
PRIMAL_PC_TYPE = "dirichlet"


@dataclass(frozen=True, slots=True)
class NumberKind:
    """A kind of numbers ≥ 0 that an option may take.

    Attributes:
        description: What it is, for the error message.
        is_count: Whether it is a whole number.
        upper_bound: Largest number.
        includes_bound: Whether the upper bound itself is allowed.
    """

    description: str
    is_count: bool = False
    upper_bound: float = math.inf
    includes_bound: bool = True

    def contains(self, value: float) -> bool:
        """Return True if a number is of this kind."""
        if value == self.upper_bound:
            return self.includes_bound
        return 0 <= value < self.upper_bound


COUNT = NumberKind("a whole number ≥ 0", is_count=True)
SHARE = NumberKind("a number between 0 and 1", upper_bound=1.0)
BELOW_ONE = NumberKind("a number ≥ 0 and < 1", upper_bound=1.0, includes_bound=False)
NOT_NEGATIVE = NumberKind("a number ≥ 0")

#: Numbers that PETSc's KSP and SNES read, for the outer solvers and for sub-solvers.
PETSC_NUMBERS = {
    "ksp_rtol": BELOW_ONE,
    "snes_rtol": BELOW_ONE,
    "ksp_atol": NOT_NEGATIVE,
    "ksp_divtol": NOT_NEGATIVE,
    "snes_atol": NOT_NEGATIVE,
    "snes_stol": NOT_NEGATIVE,
    "ksp_max_it": COUNT,
    "snes_max_it": COUNT,
    "snes_max_funcs": COUNT,
    "ksp_gmres_restart": COUNT,
    "ksp_fcg_mmax": COUNT,
}

#: Options of PETSc's KSP, without ``ksp_``, that are proposed for a misspelt name, for the user's
#: solver and for sub-solvers alike.
KSP_OPTIONS = ("type", "rtol", "atol", "max_it", "monitor", "converged_reason", "view")

#: Options of PETSc's SNES, without ``snes_``, that are proposed for a misspelt name.
SNES_OPTIONS = ("rtol", "atol", "max_it", "monitor", "converged_reason", "view", "ksp_ew")

#: Prefixes of the options of the solvers of this package, after the prefix of the user.
SOLVER_PREFIXES = ("ksp_", "snes_", "feti_")

#: Smallest similarity (difflib's ratio) at which a known option is proposed for one that nothing
#: has read: 0.94 for ksp_rtoll, 0.8 for snes_tol. Names of two different options have up to 0.7.
MIN_SIMILARITY = 0.75

#: The same for an option ``feti_…`` that does not exist, difflib's default: such a name is wrong in
#: any case, and a wrong proposal costs little.
MIN_SIMILARITY_OF_UNKNOWN = 0.6


@dataclass(frozen=True, slots=True)
class FETIOptions:
    """Options of one FETI solver, ``-<prefix>feti_…``.

    Attributes:
        type: Dirichlet dofs as rows of B, or fixed in the local matrices.
        formulation: The dual or the primal system; ``auto`` is the primal one, unless another
            option needs the dual one, or the primal one is proved unsuitable for the matrix.
        pc_type: Preconditioner M, one of ``PRECONDITIONERS``.
        scaling: Weights of the copies, one of ``SCALINGS``.
        interior: Sparse factors of K, or dense Schur complements.
        right_side: Whether right-hand sides are lifted already (``lifting``). It has no effect on
            problems of this package, which assemble theirs.
        coarse_q: Weight Q of the projection (dual).
        coarse_modes: Largest number of soft modes of a subdomain.
        coarse_threshold: Share of the interface stiffness below which a mode is soft.
        coarse_adaptive: Largest number of adaptive columns of a subdomain (primal).
        lag: Largest age of a preconditioner, in matrices of Newton's method (primal). The solver
            reads it as ``max_age``.
        deflation: Largest number of Ritz vectors that later solves are deflated by (primal).
    """

    type: Literal["all_floating", "classical"] = "all_floating"
    formulation: Literal["auto", "dual", "primal"] = "auto"
    pc_type: str = PRIMAL_PC_TYPE
    scaling: str = "stiffness"
    interior: Literal["auto", "keep", "eliminate"] = "auto"
    right_side: Literal["unlifted", "lifted"] = "unlifted"
    coarse_q: Literal["preconditioner", "diagonal", "identity"] = "preconditioner"
    coarse_modes: int = 12
    coarse_threshold: float = 0.01
    coarse_adaptive: int = 108
    lag: int = 6
    deflation: int = 20

    @property
    def all_floating(self) -> bool:
        """Whether Dirichlet dofs are rows of B."""
        return self.type == "all_floating"

    @property
    def max_age(self) -> int:
        """Largest number of matrices since the one that a preconditioner was built for."""
        return self.lag


#: The defaults.
DEFAULTS = FETIOptions()

#: Type of each option.
OPTION_TYPES = get_type_hints(FETIOptions)

#: The words that an option may take.
CHOICES = {
    **{name: get_args(kind) for name, kind in OPTION_TYPES.items() if get_args(kind)},
    "pc_type": tuple(PRECONDITIONERS),
    "scaling": tuple(SCALINGS),
}


def read_options(prefix: str) -> FETIOptions:
    """Read the options ``-<prefix>feti_…`` of the solver itself.

    Args:
        prefix: Options prefix of the KSP.

    Raises:
        ValueError: An option has a value that is not allowed, an option does not exist, or two
            options exclude each other.
    """
    check_petsc_options(prefix)
    feti_prefix = f"{prefix}feti_"
    values: dict[str, Any] = {}
    for field in fields(FETIOptions):
        name = field.name
        default: Any = field.default
        if name in CHOICES:
            values[name] = _read_word(feti_prefix, name, default)
        else:
            kind = COUNT if OPTION_TYPES[name] is int else SHARE
            values[name] = _read_number(feti_prefix, name, kind, default)
    _reject_unknown(feti_prefix)
    options = FETIOptions(**values)
    if options.formulation == "primal" and options.pc_type != PRIMAL_PC_TYPE:
        raise ValueError(
            f"Options -{feti_prefix}formulation primal and -{feti_prefix}pc_type "
            f"{options.pc_type} exclude each other: the primal form has the {PRIMAL_PC_TYPE} "
            "preconditioner only. Set the formulation to dual or auto."
        )
    return options


def requests_dual(options: FETIOptions, subsolvers: SubsolverOptions) -> bool:
    """Return True if the options select the dual formulation for a symmetric matrix.

    They do so by its name, or by a part that it alone has: a preconditioner other than
    :data:`PRIMAL_PC_TYPE`, a weight Q other than the default, or any option of its Krylov method.
    """
    if options.formulation != "auto":
        return options.formulation == "dual"
    if options.pc_type != PRIMAL_PC_TYPE or options.coarse_q != DEFAULTS.coarse_q:
        return True
    return subsolvers.dual.is_given


def excludes_primal(options: FETIOptions, subsolvers: SubsolverOptions) -> bool:
    """Return True if the options cannot be followed for an unsymmetric matrix.

    Only the primal formulation solves with such a matrix. These options are the name of the dual
    formulation, another preconditioner, and the type or tolerances of the dual Krylov method. Other
    options of the dual formulation, such as Q, are ignored for an unsymmetric matrix.
    """
    if options.formulation != "auto":
        return options.formulation == "dual"
    chooses_method = subsolvers.dual.ksp_type is not None or subsolvers.dual.has_tolerance
    return chooses_method or options.pc_type != PRIMAL_PC_TYPE


def check_petsc_options(prefix: str) -> None:
    """Check the numbers that PETSc's KSP and SNES are about to read, and the preconditioner.

    Args:
        prefix: Options prefix of the KSP.

    Raises:
        ValueError: A number is not of its kind, the dual form does not support the Krylov method,
            the method has no norm to test, or ``pc_type`` names a preconditioner of PETSc's.
    """
    for solver in (prefix, f"{prefix}feti_{DUAL_PREFIX}", f"{prefix}feti_{COARSE_PREFIX}"):
        for name, kind in PETSC_NUMBERS.items():
            is_unlimited = PETSc.Options(solver).getString(name, "") == "unlimited"
            if not (kind.is_count and is_unlimited):
                _read_number(solver, name, kind, 0)  # raises the error; PETSc reads the value
    _check_dual_method(f"{prefix}feti_{DUAL_PREFIX}")
    pc_type = PETSc.Options(prefix).getString("pc_type", "none")
    if pc_type != "none":
        raise ValueError(
            f"Option -{prefix}pc_type is '{pc_type}', but no preconditioner of PETSc's fits a torn "
            f"matrix: leave it out. FETI has its own, -{prefix}feti_pc_type."
        )


def _check_dual_method(prefix: str) -> None:
    """Check that the dual form supports the Krylov method, and that the method computes a norm.

    Args:
        prefix: Options prefix of the method, ``…feti_dual_``.

    Raises:
        ValueError: The dual form does not support the method, or it computes no norm.
    """
    options = PETSc.Options(prefix)
    if options.getString("ksp_type", "cg") not in DUAL_METHODS:
        raise _wrong_value(prefix, "ksp_type", f"one of: {', '.join(DUAL_METHODS)}")
    if options.getString("ksp_norm_type", "default") == "none":
        raise _wrong_value(prefix, "ksp_norm_type", "a norm that can be tested")


def _read_word(prefix: str, name: str, default: str) -> str:
    """Read one of the words of :data:`CHOICES`.

    Args:
        prefix: Prefix of the option, ``…feti_``.
        name: Name of the option without it.
        default: Its word if it is not set.

    Raises:
        ValueError: It is another word.
    """
    word = str(PETSc.Options(prefix).getString(name, default))
    if word not in CHOICES[name]:
        raise _wrong_value(prefix, name, f"one of: {', '.join(CHOICES[name])}")
    return word


def _read_number(prefix: str, name: str, kind: NumberKind, default: float) -> float:
    """Read a number of a kind; an int for a count.

    Raises:
        ValueError: It is not of the kind.
    """
    options = PETSc.Options(prefix)
    read = options.getInt if kind.is_count else options.getReal
    try:
        value: float = read(name, default)
    except PETSc.Error:
        raise _wrong_value(prefix, name, kind.description) from None
    if not kind.contains(value):
        raise _wrong_value(prefix, name, kind.description)
    return value


def _wrong_value(prefix: str, name: str, expected: str) -> ValueError:
    """Return the error for an option with a value other than expected."""
    value = PETSc.Options(prefix).getString(name)
    return ValueError(f"Option -{prefix}{name} is '{value}'; it takes {expected}.")


def _reject_unknown(prefix: str) -> None:
    """Raise a ValueError for an option with the prefix ``…feti_`` that does not exist."""
    known = [field.name for field in fields(FETIOptions)]
    of_subsolvers = tuple(
        subsolver + start for subsolver, starts in OPTIONS_OF_SUBSOLVERS.items() for start in starts
    )
    for name in options_under(prefix):
        if name in known or name.startswith(of_subsolvers):
            continue
        similar = difflib.get_close_matches(
            name, [*known, *of_subsolvers], n=1, cutoff=MIN_SIMILARITY_OF_UNKNOWN
        )
        hint = f"did you mean -{prefix}{similar[0]}?" if similar else "see docs/options.md."
        raise ValueError(f"Option -{prefix}{name} does not exist; {hint}")


def known_options() -> list[str]:
    """Return names of options, without prefix, that are proposed for a misspelt one."""
    names = [f"ksp_{name}" for name in KSP_OPTIONS]
    names += [f"snes_{name}" for name in SNES_OPTIONS]
    names += PETSC_NUMBERS
    names += [f"feti_{field.name}" for field in fields(FETIOptions)]
    for subsolver, starts in OPTIONS_OF_SUBSOLVERS.items():
        if "ksp_" in starts:
            names += [f"feti_{subsolver}ksp_{name}" for name in KSP_OPTIONS]
        if "pc_" in starts:
            names += [f"feti_{subsolver}pc_type", f"feti_{subsolver}pc_factor_mat_solver_type"]
    return list(dict.fromkeys(names))


def nearest_option(name: str) -> str | None:
    """Return the known option, without prefix, most similar to a name; None if none is similar."""
    known = known_options()
    if name in known:
        return name
    suffixes = [option for option in known if name.endswith(option)]  # -ksp_rtol, artery_ksp_rtol
    if suffixes:
        return max(suffixes, key=len)
    similar = difflib.get_close_matches(name, known, n=1, cutoff=MIN_SIMILARITY)
    return similar[0] if similar else None


def may_be_solver_option(name: str) -> bool:
    """Return True if an option under the prefix of a solver may be meant for this solver.

    Not all options under a prefix are: another solver may have a longer prefix that begins with
    this one, and the user's program may have options of its own. For example, for the solver with
    the prefix ``a_`` beside another one with the prefix ``a_b_``:

    - ``-a_ksp_rtol``: yes, an option of this solver;
    - ``-a_b_ksp_rtol``: no, a known option under a longer prefix;
    - ``-a_kps_rtol``: yes, similar to a known option;
    - ``-a_thickness``: no, not similar to any option of a solver.

    Args:
        name: Name of the option without the prefix of this solver.
    """
    if name.startswith(SOLVER_PREFIXES):
        return True
    known = known_options()
    if any(name.endswith(f"_{option}") for option in known):
        return False
    return bool(difflib.get_close_matches(name, known, n=1, cutoff=MIN_SIMILARITY))


def warn_of_unread(prefix: str, unread: Mapping[str, str], comm: MPI.Comm) -> None:
    """Log the options that no process has read, with the nearest known ones. Collective.

    Args:
        prefix: Prefix of the solver.
        unread: Options that nothing has read on this process, without prefix, and their values.
        comm: Processes of the solver.
    """
    per_process = comm.allgather(dict(unread))
    hints = []
    for name, value in _common_items(per_process).items():
        nearest = nearest_option(name)
        if nearest == name:
            hint = "this solver does not use it."
        elif nearest is None:
            hint = "see docs/petsc_options.md."
        else:
            hint = f"did you mean -{prefix}{nearest}?"
        hints.append(f"-{prefix}{name} {value}".rstrip() + f": {hint}")
    if hints:
        warn(f"Options that nothing has read: {' '.join(hints)}", comm)


def _common_items(dictionaries: Iterable[Mapping[str, str]]) -> dict[str, str]:
    """Return the items whose keys are in all dictionaries, in the order of the first one."""
    first, *others = dictionaries
    return {key: value for key, value in first.items() if all(key in other for other in others)}
