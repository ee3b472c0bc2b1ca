# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Options of the solver, read from PETSc's database and checked.

An option ``-<prefix>feti_…`` is a field of :class:`FETIOptions`, with its default. Its type
determines the allowed values: one of the words of a ``Literal``, a count for an int
(``option_checks.COUNT``), a share between 0 and 1 for a float (``option_checks.SHARE``). A new
field of one of these types needs no further code to be read, checked, and proposed for a misspelt
name; a word of a registry is a str with an entry in ``CHOICES``. All parts of the solver have the
options in ``Pattern.options``. docs/options.md explains each of them.

``subsolver_options`` has the options of the sub-solvers that this package reads.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass, fields
from typing import Any, Literal, get_args, get_type_hints

from petsc4py import PETSc

from dolfinx_feti.feti.interface.scaling import SCALINGS
from dolfinx_feti.feti.option_checks import (
    COUNT,
    SHARE,
    check_petsc_options,
    read_number,
    wrong_value,
)
from dolfinx_feti.feti.preconditioners.registry import PRECONDITIONERS
from dolfinx_feti.feti.subsolver_options import (
    OPTIONS_OF_SUBSOLVERS,
    SubsolverOptions,
    options_under,
)

#: The value of ``pc_type`` with which the primal formulation may be used. Any other one is a
#: preconditioner that only the dual formulation has, and selects it.
PRIMAL_PC_TYPE = "dirichlet"

#: Smallest similarity (difflib's ratio) at which an option is proposed for a name ``feti_…`` that
#: does not exist. It is difflib's default: the name is wrong in any case, and a wrong proposal
#: costs little.
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
    **{name: get_args(type_) for name, type_ in OPTION_TYPES.items() if get_args(type_)},
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
            values[name] = read_number(feti_prefix, name, kind, default)
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
    options that select the dual formulation for a symmetric matrix (:func:`requests_dual`), Q and
    the rest of ``feti_dual_…``, are ignored for an unsymmetric one.
    """
    if options.formulation != "auto":
        return options.formulation == "dual"
    chooses_method = subsolvers.dual.ksp_type is not None or subsolvers.dual.has_tolerance
    return chooses_method or options.pc_type != PRIMAL_PC_TYPE


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
        raise wrong_value(prefix, name, f"one of: {', '.join(CHOICES[name])}")
    return word


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
