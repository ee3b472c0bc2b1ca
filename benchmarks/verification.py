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
from types import ModuleType

from mpi4py import MPI

from benchmarks.common import command
from benchmarks.common.pages import Fields
from benchmarks.common.records import Record, Records
from benchmarks.common.study import Arguments, Keep, Study
from benchmarks.common.verification import inf_sup, published, tube
from benchmarks.common.verification.cases import CASES
from benchmarks.common.walls.inflated_tube import ELEMENTS

PARTS = {"published": published, "tube": tube, "inf-sup": inf_sup}

#: By part: the field that only its records have, and the values of this field.
FIELD_OF = {
    published: ("case", list(CASES)),
    tube: ("element", list(ELEMENTS)),
    inf_sup: ("pair", list(inf_sup.PAIRS)),
}


def _part(record: Record) -> ModuleType | None:
    """Return the part of the study that a record belongs to, or None."""
    for part, (field, values) in FIELD_OF.items():
        if record.get(field) in values:
            return part
    return None


def _options(parser: argparse.ArgumentParser) -> None:
    command.add_choices(parser, "--part", list(PARTS))
    for part in PARTS.values():
        part.options(parser)


def _done(case: Record, records: Records, args: Arguments) -> bool:
    if _part(case) is tube:
        return all(records.all(case | {"pressure_mmhg": p}) for p in args.pressures)
    return bool(records.all(case))


def _fields(records: Sequence[Record]) -> Fields:
    fields: dict[str, object] = {}
    for part in PARTS.values():
        fields |= part.fields([record for record in records if _part(record) is part])
    return fields


def _is_known(record: Record) -> bool:
    return _part(record) is not None


def _cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    """Yield the cases of the parts that a command line chooses."""
    for name in args.part:
        yield from PARTS[name].cases(args, comm)


def _run(case: Record, keep: Keep, args: Arguments, comm: MPI.Comm) -> None:
    """Run a case of its part. Collective."""
    _part(case).run(case, keep, args, comm)


def _draw(records: Sequence[Record], folder: Path) -> Sequence[Fields]:
    """Draw the errors of the tube."""
    return tube.draw([record for record in records if _part(record) is tube], folder)


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="verification",
    known=_is_known,
    options=_options,
    cases=_cases,
    run=_run,
    done=_done,
    fields=_fields,
    draw=_draw,
)

if __name__ == "__main__":
    STUDY.main()
