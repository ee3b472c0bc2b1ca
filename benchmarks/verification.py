# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Answers that are known otherwise: published numbers, a tube in closed form, inf-sup constants.

    python3 -m benchmarks.verification --json build/verification.json
    python3 -m benchmarks.verification --part published --case land-1 --mesh 1,2
    python3 -m benchmarks.verification --part tube --element q2-p1d --kappa 1e5
    python3 -m benchmarks.verification --part inf-sup --pair q2-p1d,p2-p0 --cells 2,4,6

Options with a single dash are PETSc's; those of the tube have the prefix `tube_`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

from mpi4py import MPI

from benchmarks.common import command
from benchmarks.common.pages import Fields
from benchmarks.common.records import Record, Records
from benchmarks.common.study import Arguments, Keep, Study
from benchmarks.common.verification.inf_sup import INF_SUP
from benchmarks.common.verification.part import Part
from benchmarks.common.verification.published import PUBLISHED
from benchmarks.common.verification.tube import TUBE

#: Parts by name, in the order of the page.
PARTS = {"published": PUBLISHED, "tube": TUBE, "inf-sup": INF_SUP}


def _part(record: Record) -> Part | None:
    """Return the part of the study that a record belongs to, or None."""
    return next((part for part in PARTS.values() if part.has(record)), None)


def _is_known(record: Record) -> bool:
    """Return True if a record is one of this study."""
    return _part(record) is not None


def _options(parser: argparse.ArgumentParser) -> None:
    """Add the choice of parts, and the options of all parts."""
    command.add_choices(parser, "--part", list(PARTS))
    for part in PARTS.values():
        part.options(parser)


def _cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    """Yield the cases of the parts that a command line chooses."""
    for name in args.part:
        yield from PARTS[name].cases(args, comm)


def _run(case: Record, keep: Keep, args: Arguments, comm: MPI.Comm) -> None:
    """Run a case of its part. Collective."""
    _part(case).run(case, keep, args, comm)


def _is_done(case: Record, records: Records, args: Arguments) -> bool:
    """Return True if a case has all records of its part."""
    return _part(case).done(case, records, args)


def _fields(records: Sequence[Record]) -> Fields:
    """Return the values of all parts."""
    fields: dict[str, object] = {}
    for part in PARTS.values():
        fields |= part.fields([record for record in records if part.has(record)])
    return fields


def _draw(records: Sequence[Record], folder: Path) -> Sequence[Fields]:
    """Draw the pictures of all parts."""
    return [
        picture
        for part in PARTS.values()
        for picture in part.draw([record for record in records if part.has(record)], folder)
    ]


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="verification",
    known=_is_known,
    options=_options,
    cases=_cases,
    run=_run,
    done=_is_done,
    fields=_fields,
    draw=_draw,
)

if __name__ == "__main__":
    STUDY.main()
