# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The harness: what a study takes, the cases that its file lacks, one record each, and its page.

    python3 -m benchmarks.NAME --json FILE                  run what the file lacks
    python3 -m benchmarks.NAME --page FOLDER --json FILE …  write the page of what files hold

A study is a module with an object :class:`Study` and a template beside it, ``NAME.md``, and ends in
``if __name__ == "__main__": STUDY.main()``. Words with a single dash are options of PETSc.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

from benchmarks.common.command import say
from benchmarks.common.pages import Fields, fill, provenance, set_aside
from benchmarks.common.records import Known, Record, Records, read_records
from dolfinx_feti import ConvergenceError
from meshes.arguments import Parser, parse_all, without_petsc

#: Adds what was found to the key of a case, a further key first, and writes and shows the record.
Keep = Callable[[Record, Record], Record]
Arguments = argparse.Namespace


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """A study: what tells its cases apart, how one is measured, and what its page shows.

    ``cases`` raises a ValueError that names a wrong argument; ``run`` keeps a record, or several.
    """

    file: str  # its module
    about: str | None
    page: str
    known: Known
    cases: Callable[[Arguments, MPI.Comm], Iterable[Record]]
    run: Callable[[Record, Keep, Arguments, MPI.Comm], object]  # collective
    fields: Callable[[Sequence[Record]], Fields]  # of the template
    options: Callable[[argparse.ArgumentParser], object] = lambda _parser: None
    done: Callable[[Record, Records, Arguments], bool] = lambda case, records, _: bool(
        records.all(case)
    )
    draw: Callable[[Sequence[Record], Path], Sequence[Fields]] = lambda _records, _folder: ()

    def main(
        self, argv: Sequence[str] | None = None, comm: MPI.Comm = MPI.COMM_WORLD
    ) -> list[Record]:
        """Run a command line; return the records of its cases, also those that the file had.

        It exits if the command line is wrong, or a case has no record. Collective.
        """
        form = argparse.RawDescriptionHelpFormatter
        name = Path(self.file).stem
        parser = Parser(name, description=self.about, formatter_class=form, allow_abbrev=False)
        add = parser.add_argument
        add("--json", type=Path, nargs="+", default=[], metavar="FILE", help="records; added to")
        add("--again", action="store_true", help="also run cases that the file has")
        add("--page", type=Path, metavar="FOLDER", help="write the page of the files instead")
        self.options(parser)
        own, petsc = without_petsc(sys.argv[1:] if argv is None else argv)
        args = parse_all(parser, own)
        PETSc.Options().insertString(" ".join(petsc))
        if args.page is None and len(args.json) > 1:
            parser.error("argument --json: one file takes the records; --page reads several")
        try:
            if args.page is not None:
                self.write_page(args.json, args.page)
                return []
            path = args.json[0] if args.json else None
            records = Records(path, comm, self.known, self.page)
            return self._run_all(args, records, comm)
        except (OSError, ValueError) as error:  # of a file; fewer cells than subdomains
            parser.error(str(error))

    def _run_all(self, args: Arguments, records: Records, comm: MPI.Comm) -> list[Record]:
        """Run the cases that the records lack; return their records, or exit if one has failed."""
        found: list[Record] = []
        lost = False
        for case in self.cases(args, comm):

            def keep(key: Record, values: Record, case: Record = case) -> Record:
                record = records.keep(case | key, values)
                say(json.dumps(record, ensure_ascii=False), comm)
                return record

            if not args.again and self.done(case, records, args):
                for record in records.all(case):
                    say(f"in the records already: {json.dumps(record, ensure_ascii=False)}", comm)
            else:
                try:
                    self.run(case, keep, args, comm)
                except ConvergenceError as error:
                    say(f"failed: {case}: {error}", comm, sys.stderr)
                    lost = True
            found += records.all(case)
        if lost:
            sys.exit(1)
        return found

    def write_page(self, files: Sequence[Path], folder: Path) -> str:
        """Write the page of some files, its tables and pictures; return it with all tables."""
        records = [r for path in files for r in read_records(path, self.known, self.page)]
        folder.mkdir(parents=True, exist_ok=True)
        values = {**provenance(records), **self.fields(records)}
        values["pictures"] = self.draw(records, folder)
        template = Path(self.file).with_suffix(".md").read_text(encoding="utf-8")
        filled = fill(template, values)
        text, tables = set_aside(filled, self.page)
        (folder / f"{self.page}.md").write_text(text, encoding="utf-8")
        for old in (folder / "tables").glob(f"{self.page}_[0-9]*.csv"):
            old.unlink()
        for number, rows in enumerate(tables, start=1):
            path = folder / "tables" / f"{self.page}_{number}.csv"
            path.parent.mkdir(exist_ok=True)
            with path.open("w", encoding="utf-8", newline="") as file:
                csv.writer(file, lineterminator="\n").writerows(rows)
        return filled
