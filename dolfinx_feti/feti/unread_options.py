# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Options that nothing has read: whether a solver is meant, and the most similar known options."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import fields

from mpi4py import MPI

from dolfinx_feti.feti.option_checks import PETSC_NUMBERS
from dolfinx_feti.feti.options import FETIOptions
from dolfinx_feti.feti.subsolver_options import OPTIONS_OF_SUBSOLVERS
from dolfinx_feti.runtime.collective import warn

#: Options of PETSc's KSP, without ``ksp_``, that are proposed for a misspelt name, for the user's
#: solver and for sub-solvers alike.
KSP_OPTIONS = ("type", "rtol", "atol", "max_it", "monitor", "converged_reason", "view")

#: Options of PETSc's SNES, without ``snes_``, that are proposed for a misspelt name.
SNES_OPTIONS = ("rtol", "atol", "max_it", "monitor", "converged_reason", "view", "ksp_ew")

#: Prefixes of the options of the solvers of this package, after the prefix of the user.
SOLVER_PREFIXES = ("ksp_", "snes_", "feti_")

#: Smallest similarity (difflib's ratio) at which a known option is proposed for one that nothing
#: has read: 0.94 for ksp_rtoll and snes_tol, and 0.4 for my_size, an option of a script.
MIN_SIMILARITY = 0.75


def known_options() -> list[str]:
    """Return names of options, without prefix, that are proposed for a misspelt one."""
    names = [f"ksp_{name}" for name in KSP_OPTIONS]
    names += [f"snes_{name}" for name in SNES_OPTIONS]
    names += list(PETSC_NUMBERS)
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
    """Return True if an option with the prefix of a solver may be one of this solver.

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
            Those that another process has read are not logged.
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
