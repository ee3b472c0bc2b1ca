# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Errors in the work on a subdomain: they get its number, and are raised on all processes.

Work on a subdomain may fail on a single process. :class:`NumberedErrors` adds the number of the
subdomain to the error; :func:`on_subdomains` raises it on all processes, with a remedy. Mistakes in
the program, such as a ``TypeError``, are passed on unchanged.
"""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import TypeVar

from mpi4py import MPI

from dolfinx_feti.errors import FactorError, SetUpError, SingularBlockError, SingularError
from dolfinx_feti.runtime.collective import error_message, on_all

T = TypeVar("T")

#: Mistakes in the program, which other data or options cannot avoid. They are raised unchanged.
#: ``ValueError`` is none of them: numpy and LAPACK raise it for NaN and Inf.
PROGRAM_ERRORS = (AssertionError, AttributeError, LookupError, NameError, TypeError)


class RemediedFactorError(FactorError):
    """A block could not be factored; the message says what to do."""


class NumberedErrors:
    """Context that adds the number of a subdomain to the errors of the work inside.

    A ``FactorError`` or ``MemoryError`` keeps its class, but not its attributes. Any other error
    that the data cause, such as an error of LAPACK, becomes a ``FactorError``.

    Args:
        subdomain: Number of the subdomain over all processes.
    """

    # Not a contextlib.contextmanager: a generator would leave a reference cycle through the
    # traceback, and PETSc objects would stay alive until Python collects garbage.

    def __init__(self, subdomain: int) -> None:
        self._subdomain = subdomain

    def __enter__(self) -> None:
        """Enter the context."""

    def __exit__(
        self,
        _kind: type[BaseException] | None,
        error: BaseException | None,
        _traceback: TracebackType | None,
    ) -> None:
        """Raise the error of the work again, with the number of the subdomain."""
        if not isinstance(error, Exception) or isinstance(error, PROGRAM_ERRORS):
            return
        kind: type[Exception] = FactorError
        if isinstance(error, FactorError | MemoryError):
            kind = type(error)
        name = "" if isinstance(error, FactorError) else f"{type(error).__name__}: "
        raise kind(f"subdomain {self._subdomain}: {name}{error_message(error)}") from error


def on_subdomains(work: Callable[[], T], comm: MPI.Comm) -> T:
    """Do work on the subdomains of each process; raise on all if it fails on one. Collective.

    Unlike :func:`on_all`, it adds a remedy to the message, and changes the class of the error.

    Args:
        work: Not collective; its errors have the number of the subdomain (:class:`NumberedErrors`).
        comm: The processes.

    Returns:
        The result of this process.

    Raises:
        SetUpError: The work failed on some process. The message contains the error of this process,
            or else that of the first process where the work failed. It is a SingularError if that
            error is a SingularBlockError.
    """
    try:
        return on_all(work, comm)
    except PROGRAM_ERRORS:
        raise
    except Exception as error:
        remedy = ": check coefficients and supports, or take other subdomains"
        if isinstance(error, MemoryError):
            remedy = ": take more processes, or smaller subdomains"
        if isinstance(error, RemediedFactorError):
            remedy = ""
        kind = SingularError if isinstance(error, SingularBlockError) else SetUpError
        raise kind(f"Work on a subdomain failed ({error_message(error)}){remedy}.") from error
