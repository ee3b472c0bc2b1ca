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
from collections.abc import Sequence
from types import ModuleType

from benchmarks.common import command
from benchmarks.common.pages import Fields
from benchmarks.common.records import Record, Records
from benchmarks.common.study import Arguments, Study
from benchmarks.common.verification import inf_sup, published, tube
from benchmarks.common.verification.cases import CASES
from benchmarks.common.walls.inflated_tube import ELEMENTS

PARTS = {"published": published, "tube": tube, "inf-sup": inf_sup}

#: The field that the records of each part have alone, and its values.
OWN = {
    published: ("case", list(CASES)),
    tube: ("element", list(ELEMENTS)),
    inf_sup: ("pair", list(inf_sup.PAIRS)),
}


def _part(record: Record) -> ModuleType | None:
    for part, (field, values) in OWN.items():
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


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="verification",
    known=lambda record: _part(record) is not None,
    options=_options,
    cases=lambda args, *rest: (case for n in args.part for case in PARTS[n].cases(args, *rest)),
    run=lambda case, *rest: _part(case).run(case, *rest),
    done=_done,
    fields=_fields,
    draw=lambda records, folder: tube.draw([r for r in records if _part(r) is tube], folder),
)

if __name__ == "__main__":
    STUDY.main()
