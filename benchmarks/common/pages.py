# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Commands that make pages and pictures of records, on one process."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks.common.records import Record, read_records

__all__ = ["by_mesh", "provenance", "run_command"]


def run_command(
    name: str,
    description: str,
    arguments: Sequence[str] | None,
    *,
    known: Callable[[Record], bool],
    writer: str,
    write: Callable[[Path, Sequence[Record], str], None],
) -> int:
    """Read the records that a command line names, and write the pages into its folder.

    Args:
        name: Name of the command.
        description: What ``--help`` says about it.
        arguments: The command line without the program's name.
        known: Tells whether a record is one of the pages'.
        writer: The benchmark that writes the records.
        write: Writes the pages: folder, records, and a remark about the runs.

    Returns:
        The exit status, 0.

    Raises:
        SystemExit: Bad input.
    """
    parser = argparse.ArgumentParser(
        name, description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("records", type=Path, nargs="+", metavar="JSON", help=f"files of {writer}")
    parser.add_argument("--output", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--remark", default="", help="remark about the runs")
    args = parser.parse_args(arguments)
    try:
        records = [r for path in args.records for r in read_records(path, known, writer)]
        args.output.mkdir(parents=True, exist_ok=True)
        write(args.output, records, args.remark)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    return 0


class Mesh(NamedTuple):
    """Records of one mesh.

    Attributes:
        name: For a file's name, such as ``vessel_1.6``.
        about: For a text, such as ``vessel, edges of 1.6 mm``.
        records: The records.
    """

    name: str
    about: str
    records: list[Record]


def by_mesh(records: Sequence[Record]) -> Iterator[Mesh]:
    """Sort records by wall and size of the mesh, None for the generator's default."""
    for key in dict.fromkeys((record["geometry"], record["size"]) for record in records):
        mine = [record for record in records if (record["geometry"], record["size"]) == key]
        geometry, size = key
        if size is None:
            yield Mesh(geometry, geometry, mine)
        else:
            yield Mesh(f"{geometry}_{size:g}", f"{geometry}, edges of {size:g} mm", mine)


def provenance(
    name: str, records: Sequence[Record], remark: str = "", *, writer: str = ""
) -> list[str]:
    """Return the lines of a page that say where its records come from.

    Args:
        name: Of the JSON file; the page is made by ``<name>_page``.
        records: Of all cases, with ``machine`` and ``date``.
        remark: Remark about the runs, at the end.
        writer: The benchmark, if it has another name.
    """
    machines = dict.fromkeys(
        ", ".join(f"{key} {value}" for key, value in record["machine"].items())
        for record in records
    )
    dates = sorted(str(record["date"])[:10] for record in records)
    lines = [
        *(f"- {machine}" for machine in machines),
        f"- {len(records)} cases, {dates[0]} to {dates[-1]}.",
        "",
        f"`benchmarks/{writer or name}.py` runs the cases, and this page is made by `python3 -m",
        f"benchmarks.{name}_page docs/results/{name}.json --output docs/results`.",
    ]
    return [*lines, "", remark] if remark else lines
