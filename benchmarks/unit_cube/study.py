# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A study: cases run one after the other, each with a record, if the memory allows it."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from mpi4py import MPI

from benchmarks.common.machine import available_mib, bandwidth, describe, now, resident_mib
from benchmarks.common.progress import Bar, say
from benchmarks.common.records import Record, Records
from benchmarks.unit_cube.case import Case, run
from benchmarks.unit_cube.problem import CubeProblem
from dolfinx_feti import ConvergenceError
from dolfinx_feti.collective import on_first

__all__ = ["Study", "is_solved"]

HEAD = f"{'':<52}{'it.':>5}{'κ':>10}{'L2 error':>10}{'set-up':>10}{'solve':>10}{'MiB':>7}"

#: Parameters of the mesh and the form; cases that agree in them share a problem.
SHARED = ("degree", "level", "subdomains_per_edge", "jump", "pattern", "source")


class NoRoomError(MemoryError):
    """A case does not fit into the memory; the message says how much it needs.

    Attributes:
        mib: What it needs [MiB].
        there: What there is [MiB].
    """

    def __init__(self, case: Case, mib: float, there: float) -> None:
        self.mib, self.there = mib, there
        super().__init__(
            f"{case} needs about {_gib(mib)}, and {_gib(there)} are available: choose a lower "
            "--level, fewer --subdomains-per-edge, or --pc lumped or identity."
        )


class Study:
    """Cases to be run one after the other.

    Attributes:
        refused: How many cases did not fit.
        failed: How many did not converge.
    """

    def __init__(
        self, cases: Sequence[Case], records: Records, comm: MPI.Comm, *, limit: float, again: bool
    ) -> None:
        """Plan the study.

        Args:
            cases: All cases; those next to each other share a mesh, if they can.
            records: What has been run, and what is to be. A case that was refused or has failed
                is there, too, without results, and tried again.
            comm: Communicator of the meshes.
            limit: Most memory that may be taken [MiB]; never more than there is.
            again: Also run cases that are in the records.
        """
        self._records, self._comm, self._limit = records, comm, limit
        self._cases = [case for case in cases if again or not is_solved(records.find(case.key()))]
        self._known = len(cases) - len(self._cases)
        self._bar = Bar(len(self._cases), comm)
        self._problem: tuple[object, CubeProblem] | None = None
        self.refused = self.failed = 0

    def run(self) -> None:
        """Run the cases; the records are written after each. Collective."""
        if self._known:
            say(f"{self._known} case(s) are in the records already", self._comm)
        if not self._cases:
            return
        say(HEAD, self._comm)
        speed = bandwidth(self._comm)
        for case in self._cases:
            try:
                record = self._measure(case, speed)
            except NoRoomError as refusal:
                self.refused += 1
                room = {"estimated_mib": refusal.mib, "available_mib": refusal.there}
                self._keep(case, room | {"processes": self._comm.size})
                self._bar.end()
                say(f"refused: {refusal}", self._comm, sys.stderr)
            except ConvergenceError as failure:
                self.failed += 1
                self._keep(case, {"failure": str(failure), "processes": self._comm.size})
                self._bar.end()
                say(f"failed: {case}: {failure}", self._comm, sys.stderr)
            else:
                record = self._keep(case, record)
                self._bar.end()
                say(_row(case, record), self._comm)

    def _measure(self, case: Case, speed: float) -> Record:
        """Estimate a case and solve it."""
        self._bar.begin(f"{case}: estimate")
        estimated = on_first(lambda: case.estimate(self._comm.size), self._comm)
        self._reserve(case, estimated.mib)
        self._bar.begin(f"{case}: mesh")
        problem = self._shared_problem(case)
        self._bar.begin(f"{case}: set-up")
        monitor = self._bar.monitor if self._bar.shown else None
        record = run(case, problem, self._comm, monitor)
        return record | {
            "estimated_mib": estimated.mib,
            "seconds_streaming": estimated.streamed / speed,
            "bandwidth_gb_s": speed / 1e9,
        }

    def _keep(self, case: Case, found: Record) -> Record:
        """Add what came of a case to the records."""
        key = case.key()
        return self._records.put(key, key | found | {"machine": describe(), "date": now()})

    def _reserve(self, case: Case, mib: float) -> None:
        """Refuse a case that needs more than there is.

        Raises:
            NoRoomError: On all processes.
        """
        there = min(resident_mib(self._comm) + available_mib(self._comm), self._limit)
        if mib > there:
            raise NoRoomError(case, mib, there)

    def _shared_problem(self, case: Case) -> CubeProblem:
        """Return the last problem if the case can share it, or a new one."""
        key = tuple(getattr(case, name) for name in SHARED)
        if self._problem is None or self._problem[0] != key:
            self._problem = None  # its memory goes first
            self._problem = (key, case.problem(self._comm))
        return self._problem[1]


def is_solved(record: Record | None) -> bool:
    """Tell whether a record holds results, and no refusal or failure."""
    return record is not None and "iterations" in record


def _row(case: Case, record: Record) -> str:
    """Format a record as a line below :data:`HEAD`."""
    condition = _format(record["condition_number"], ".4g", 10)
    error = _format(record["l2_error"], ".2e", 10)
    times = "".join(f"{record[f'seconds_{phase}']:>8.2f} s" for phase in ("setup", "solve"))
    peak = _format(record["peak_mib"], ".0f", 7)
    return f"{case!s:<52}{record['iterations']:>5}{condition}{error}{times}{peak}"


def _format(value: object, form: str, width: int) -> str:
    return ("–" if value is None else format(value, form)).rjust(width)


def _gib(mib: float) -> str:
    return f"{mib / 2**10:.1f} GiB"
