# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The harness: it runs the cases of a study that a file of records lacks, and writes its page.

    python3 -m benchmarks.NAME --json FILE                  run all cases that the file lacks
    python3 -m benchmarks.NAME --list                       print all cases, one on each line
    python3 -m benchmarks.NAME --only level=2,pc=lumped     run the cases with these values
    python3 -m benchmarks.NAME --page FOLDER --json FILE …  write the page from files of records

A study is a module with an object :class:`Study` and a template ``NAME.md`` in the same folder, and
ends in ``if __name__ == "__main__": STUDY.main()``. Words with a single dash are options of PETSc.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

from benchmarks.common.command import say
from benchmarks.common.pages import Fields, fill, fold_tables, provenance
from benchmarks.common.records import Known, Record, Records, read_records
from dolfinx_feti import ConvergenceError
from dolfinx_feti.meshes.arguments import RootParser, parse_all, split_petsc_options

#: Writes and prints a record, and returns it; see :func:`keep_record`. Arguments: entries of the
#: record's key in addition to those of its case, such as the pressure; measured values. Collective.
Keep = Callable[[Record, Record], Record]
Arguments = argparse.Namespace

#: Comma of ``--only`` that begins another value, unlike that in ``material=HGO, dispersed``.
NEXT_VALUE = re.compile(r",(?=\s*\w+=|\s*$)")


def no_options(parser: argparse.ArgumentParser) -> None:
    """Add no options: the study has only those of the harness."""


def has_record(case: Record, records: Records, _args: Arguments) -> bool:
    """Return True if a case has a record."""
    return bool(records.all(case))


def no_pictures(_records: Sequence[Record], _folder: Path) -> Sequence[Fields]:
    """Draw nothing."""
    return ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """A study: its cases, how one is measured, and what its page shows.

    Args:
        file: Path of its module, ``__file__``; the template has the same name.
        about: Help of the command line, ``__doc__``.
        page: Name of the page without suffix.
        known: Returns True if a record is one of this study.
        cases: Yields the key of each case; raises a ValueError that names a wrong argument.
        run: Measures a case and keeps its records, one or more. Collective.
        fields: Returns the values of the template from all records.
        options: Adds the study's own options to the command line.
        done: Returns True if a case has all its records.
        draw: Draws pictures into a folder; returns a row for each.
    """

    file: str
    about: str | None
    page: str
    known: Known
    cases: Callable[[Arguments, MPI.Comm], Iterable[Record]]
    run: Callable[[Record, Keep, Arguments, MPI.Comm], object]
    fields: Callable[[Sequence[Record]], Fields]
    options: Callable[[argparse.ArgumentParser], object] = no_options
    done: Callable[[Record, Records, Arguments], bool] = has_record
    draw: Callable[[Sequence[Record], Path], Sequence[Fields]] = no_pictures

    def main(
        self, argv: Sequence[str] | None = None, comm: MPI.Comm = MPI.COMM_WORLD
    ) -> list[Record]:
        """Run a command line; return the records of its cases, also those read from the file.

        Collective.

        Raises:
            SystemExit: The command line is wrong (status 2), or a case failed (status 1).
        """
        parser = self._create_parser()
        words, petsc_words = split_petsc_options(sys.argv[1:] if argv is None else argv)
        args = parse_all(parser, words)
        PETSc.Options().insertString(" ".join(petsc_words))
        if args.page is None and len(args.json) > 1:
            parser.error("argument --json: one file takes the records; --page reads several")
        try:
            if args.page is not None:
                self.write_page(args.json, args.page)
                return []
            path = args.json[0] if args.json else None
            cases = select(self.cases(args, comm), args.only)
            if args.list:
                for case in cases:
                    say(case_text(case), comm)
                return []
            records = Records(path, comm, self.known, self.page)
            return self._run_all(cases, args, records, comm)
        except (OSError, ValueError) as error:  # of a file; fewer cells than subdomains
            parser.error(str(error))

    def _create_parser(self) -> RootParser:
        """Create the parser of the command line: options of all studies, and those of this one."""
        parser = RootParser(
            Path(self.file).stem,
            description=self.about,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        add = parser.add_argument
        add("--json", type=Path, nargs="+", default=[], metavar="FILE", help="records; added to")
        add("--again", action="store_true", help="also run cases that the file has")
        add("--list", action="store_true", help="print the cases instead")
        add("--only", type=read_values, default={}, metavar="NAME=VALUE,…", help="run these cases")
        add("--page", type=Path, metavar="FOLDER", help="write the page of the files instead")
        self.options(parser)
        return parser

    def _run_all(
        self, cases: Iterable[Record], args: Arguments, records: Records, comm: MPI.Comm
    ) -> list[Record]:
        """Run the cases without a record; return the records of all cases. Collective.

        Other cases run even if one does not converge.

        Raises:
            SystemExit: A case failed (status 1).
        """
        records_of_cases: list[Record] = []
        has_failed = False
        for case in cases:
            if not args.again and self.done(case, records, args):
                for record in records.all(case):
                    say(f"in the records already: {json.dumps(record, ensure_ascii=False)}", comm)
            else:
                try:
                    self.run(case, partial(keep_record, records, comm, case), args, comm)
                except ConvergenceError as error:
                    say(f"failed: {case_text(case)}: {error}", comm, sys.stderr)
                    has_failed = True
            records_of_cases += records.all(case)
        if has_failed:
            sys.exit(1)
        return records_of_cases

    def write_page(self, files: Sequence[Path], folder: Path) -> str:
        """Write the page of the records in some files, and its pictures; return its text.

        Raises:
            OSError: A file cannot be read.
            ValueError: A file has no records, or those of another study.
        """
        records = [r for path in files for r in read_records(path, self.known, self.page)]
        folder.mkdir(parents=True, exist_ok=True)
        text = fold_tables(fill(self.template, self.page_fields(records, folder)))
        (folder / f"{self.page}.md").write_text(text, encoding="utf-8")
        return text

    @property
    def template(self) -> str:
        """Text of the template."""
        return Path(self.file).with_suffix(".md").read_text(encoding="utf-8")

    def page_fields(self, records: Sequence[Record], folder: Path) -> dict[str, Any]:
        """Return the values of the page, and draw its pictures.

        Args:
            records: Records of the study.
            folder: Where pictures are written.
        """
        pictures = self.draw(records, folder)
        return {**provenance(records), **self.fields(records), "pictures": pictures}


def keep_record(
    records: Records, comm: MPI.Comm, case: Record, key: Record, values: Record
) -> Record:
    """Write and print the record of a case. Collective.

    Args:
        records: Records of the study.
        comm: Communicator.
        case: Key of the case.
        key: Further entries of the record's key, such as the pressure.
        values: Measured values.
    """
    record = records.keep(case | key, values)
    say(json.dumps(record, ensure_ascii=False), comm)
    return record


def read_values(text: str) -> dict[str, str]:
    """Return the values of ``--only`` by name, such as those of ``level=2,pc=lumped``.

    A value may have commas of its own: the next one begins where a name and ``=`` follow a comma.
    """
    words = [word.partition("=") for word in NEXT_VALUE.split(text)]
    if not all(name and equals for name, equals, _ in words):
        raise argparse.ArgumentTypeError(f"{text!r}: write NAME=VALUE,NAME=VALUE")
    return {name.strip(): value.strip() for name, _, value in words}


def select(cases: Iterable[Record], wanted: Mapping[str, str]) -> Iterator[Record]:
    """Yield the cases that have the wanted values.

    Args:
        cases: Keys of cases.
        wanted: Values as text, by name.

    Raises:
        ValueError: No case has them.
    """
    has_any = False
    for case in cases:
        if all(name in case and is_written(case[name], text) for name, text in wanted.items()):
            has_any = True
            yield case
    if wanted and not has_any:
        values = ",".join(f"{name}={value}" for name, value in wanted.items())
        raise ValueError(f"argument --only: no case has {values}; --list prints all cases")


def is_written(value: object, text: str) -> bool:
    """Return True if a text stands for a value; 1000 and 1e3 stand for 1000.0."""
    if isinstance(value, float):
        try:
            return float(text) == value
        except ValueError:
            return False
    return str(value) == text


def case_text(case: Record) -> str:
    """Return the key of a case as ``--only`` takes it."""
    return ",".join(f"{name}={value}" for name, value in case.items())
