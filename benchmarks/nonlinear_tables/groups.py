# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Which records of the nonlinear study belong together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from benchmarks.common.records import Record

__all__ = [
    "CHOICES",
    "LAYERS",
    "PRECONDITIONERS",
    "TYPES",
    "is_known",
    "is_solved",
    "pairs",
    "seconds",
    "usual",
]

TYPES = {"all_floating": "all-floating", "classical": "classical"}
PRECONDITIONERS = ("identity", "lumped", "dirichlet")
CHOICES = {"paper": "the paper's choices", "default": "the package's defaults"}
LAYERS = {1: "one layer", 2: "two layers"}

#: What a case is told by, in the order of the tables.
NAMES = ("geometry", "size", "degree", "layers", "subdomains", "processes", "contact", "kappa")
NAMES += ("pressure", "type", "pc", "choices")


def is_known(record: Record) -> bool:
    """Tell whether a record is one of this study."""
    return "contact" in record and "linear_iterations_per_newton" in record


def is_solved(record: Record) -> bool:
    """Tell whether the wall arrived."""
    return "failure" not in record and "iterations_exceed" not in record


def usual(records: Sequence[Record]) -> list[Record]:
    """Return the records with the decomposition as it came."""
    return [record for record in records if record["contact"] == "whole"]


def pairs(
    records: Sequence[Record], name: str, first: object, second: object
) -> Iterator[tuple[Record, Record]]:
    """Yield the records that differ in one parameter alone, which has these two values."""
    others = [other for other in NAMES if other != name]
    of_second = {
        tuple(record[other] for other in others): record
        for record in records
        if record[name] == second
    }
    for record in records:
        key = tuple(record[other] for other in others)
        if record[name] == first and key in of_second:
            yield record, of_second[key]


def seconds(record: Record) -> float:
    """Return the seconds of a Newton step, set-up and Krylov method."""
    return sum(float(record[f"seconds_{part}_per_newton"]) for part in ("setup", "krylov"))
