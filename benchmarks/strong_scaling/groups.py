# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Which records of the scaling study belong together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from benchmarks.common.records import Record

__all__ = ["ARTERIES", "CHOICES", "TYPES", "Series", "is_known", "series"]

#: Variant by layers of the wall: the paper's aorta, its carotid artery.
TYPES = {1: "all_floating", 2: "classical"}
ARTERIES = {1: "aorta", 2: "carotid artery"}
CHOICES = {"paper": "the paper's choices", "default": "the package's defaults"}

#: What cases share that differ in their number of processes alone.
NAMES = ("geometry", "size", "subdomains", "layers", "choices")


class Series(NamedTuple):
    """Cases that differ in their number of processes alone, in rising order.

    Attributes:
        layers: Of the wall.
        choices: Key of :data:`CHOICES`.
        measured: Records of measured cases.
        counted: Records of counted cases.
    """

    layers: int
    choices: str
    measured: list[Record]
    counted: list[Record]

    @property
    def title(self) -> str:
        """Name it."""
        kind = TYPES[self.layers].replace("_", "-")
        one = (self.measured or self.counted)[0]
        what = f"{kind}, {CHOICES[self.choices]}, {one['pc']}"
        return f"{what}, {one['geometry']} with {one['subdomains']} subdomains"


def is_known(record: Record) -> bool:
    """Tell whether a record is one of this study."""
    return record.get("study") == "scaling"


def series(records: Sequence[Record]) -> Iterator[Series]:
    """Yield the series, the paper's choices first."""
    keys = dict.fromkeys(tuple(record[name] for name in NAMES) for record in records)
    for key in sorted(keys, key=lambda key: (list(CHOICES).index(key[-1]), key[-2])):
        mine = [r for r in records if tuple(r[name] for name in NAMES) == key]
        mine.sort(key=lambda record: record["processes"])
        tasks = ([r for r in mine if r["task"] == task] for task in ("measure", "count"))
        yield Series(int(key[-2]), str(key[-1]), *tasks)
