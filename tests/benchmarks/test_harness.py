# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The harness of the studies: records, what is run, what is refused."""

from __future__ import annotations

import errno
import io
import json
import os
import re
from pathlib import Path

import pytest
from collective import COMM, agree, raises
from wall_files import on_first

from benchmarks import compare, cube, nonlinear, scaling, verification
from benchmarks.common import command, pages
from benchmarks.common import records as module
from benchmarks.common.records import Records
from benchmarks.common.study import Study, case_text, read_values, select
from dolfinx_feti import ConvergenceError
from dolfinx_feti.meshes.arguments import count

pytest.importorskip("matplotlib")


def test_record_of_the_first_process_counts(tmp_path):
    """Times differ between processes; all keep that of the first, in place of the last one."""
    path = tmp_path / "new/records.json"
    records = Records(path, COMM)
    key = {"case": 1}
    for seconds in (COMM.rank, COMM.rank + 7):
        stored = records.keep(key, {"seconds": seconds})
        agree(stored["case"] == 1 and stored["seconds"] == seconds - COMM.rank, stored)
        agree(records.all(key) == Records(path, COMM).all(key) == [stored], stored)
        agree(on_first(lambda: json.loads(path.read_text())) == [stored])


def test_full_disk_leaves_the_file_as_it_was(tmp_path, monkeypatch):
    path = tmp_path / "records.json"
    records = Records(path, COMM)
    records.keep({"case": 1}, {})
    before = on_first(path.read_text)

    def full(*_places: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(module.os, "replace", full if COMM.rank == 0 else os.replace)
        with raises(OSError, "cannot be written .No space left on device.: make room"):
            records.keep({"case": 2}, {})
    agree(on_first(path.read_text) == before)
    agree(on_first(lambda: [each.name for each in tmp_path.iterdir()]) == ["records.json"])
    records.keep({"case": 3}, {})
    agree(len(on_first(lambda: json.loads(path.read_text()))) == 3, "what was found is kept")


class Broken(io.StringIO):
    """A stream whose writes fail, as on a full disk or a closed terminal."""

    def write(self, _text: str) -> int:
        raise BrokenPipeError("the reader has gone")


def test_line_that_cannot_be_printed_ends_all_processes():
    """The first process alone prints."""
    with raises(BrokenPipeError, "the reader has gone"):
        command.say("a line", COMM, Broken())


def is_square(record) -> bool:
    return "x" in record


def add_numbers(parser) -> None:
    parser.add_argument("--x", type=command.several(count))


def numbers(args, _comm):
    for x in args.x:
        yield {"x": x}


def square(case, keep, _args, _comm) -> None:
    keep({}, {"square": case["x"] ** 2})


def rows(records):
    return {"rows": records}


def squares(run=square, **changes: object) -> Study:
    """Return a study that squares numbers."""
    return Study(
        file=str(Path(__file__).with_name("squares.py")),
        about="Squares.",
        page="squares",
        known=is_square,
        options=add_numbers,
        cases=numbers,
        run=run,
        fields=rows,
        **changes,
    )


EPYC = {"processor": "2 × AMD EPYC"}
MONDAY = {"date": "2026-01-05T01:02:03+00:00", "machine": EPYC, "commit": "abc"}
TUESDAY = {"date": "2026-01-06T01:02:03+00:00", "machine": EPYC}
ROWS = "| n |\n| --: |\n| {n} | <!-- rows -->\n\nThe end.\n"


@pytest.mark.serial
@pytest.mark.parametrize(
    ("rows", "line"),
    [
        ([MONDAY], "*Record of 2026-01-05; commit abc; 2 × AMD EPYC.*"),
        ([MONDAY, MONDAY], "*Records of 2026-01-05; commit abc; 2 × AMD EPYC.*"),
        (
            [MONDAY, TUESDAY, dict(TUESDAY)],
            "*Records of different days: 2026-01-05 (1), 2026-01-06 (2); commit abc; commit of "
            "some not recorded; 2 × AMD EPYC.*",
        ),
        ([{"sources": [TUESDAY]}], "*Record of 2026-01-06; commit not recorded; 2 × AMD EPYC.*"),
        ([{"n": 1}], "*Record of 2026-01-05; commit abc; 2 × AMD EPYC.*"),  # that of the page
        (
            [{"sources": [MONDAY | {"commit": "de+", "machine": {"processor": "ARM"}}, MONDAY]}],
            "*Records of 2026-01-05; commits de+, abc (+ with uncommitted changes); ARM and "
            "2 × AMD EPYC.*",
        ),
        (
            [{"sources": [{"n": 1}]}],
            "*Record of unknown date; commit not recorded; machine not recorded.*",
        ),
    ],
)
def test_line_below_a_table_names_its_records(rows, line):
    """Each record counts once, and a folded table has the line inside."""
    distinct = [row if "sources" in row else dict(row) for row in rows]
    text = pages.fill(ROWS, {"rows": distinct, "records": [MONDAY]})
    agree(text.endswith(f"|\n\n{line}\n\nThe end.\n"), text)
    folded = pages.fold_tables(pages.fill(ROWS, {"rows": distinct * 9, "records": [MONDAY]}))
    agree(folded.startswith("<details>") and folded.count("*Record") == 1, folded)
    agree(folded.endswith(".*\n\n</details>\n\nThe end.\n"), folded)


def test_misspelt_field_of_a_template_is_found():
    fields = {"n": 1, "rows": [{"n": 1}], "parts": [{"m": 2, "rows": []}]}
    template = "{n} {nn}\n| {n} {rown:.1f} | <!-- rows -->\n## {m} <!-- parts -->\n{m[a]} {mm.a}\n"
    agree(pages.missing_fields(template, fields) == {"nn", "rown", "mm"})


def test_cases_are_listed(capsys):
    agree(squares().main(["--x", "2,3", "--list"], COMM) == [])
    agree(COMM.bcast(capsys.readouterr().out) == "x=2\nx=3\n")


def test_one_case_is_run():
    agree([record["square"] for record in squares().main(["--x", "2,3", "--only", "x=3"])] == [9])


@pytest.mark.parametrize(
    ("words", "material", "kappa"),
    [
        ("material=HGO, dispersed", "HGO, dispersed", 10.0),
        ("material=HGO,kappa=1000", "HGO", 1000.0),
        ("kappa=1e3, material=HGO", "HGO", 1000.0),
    ],
    ids=["value-with-comma", "integer-for-float", "exponent"],
)
def test_case_is_chosen_by_its_text(words, material, kappa):
    """The line of --list chooses its case, and a number may be written in another way."""
    cases = [
        {"material": "HGO", "kappa": 10.0},
        {"material": "HGO", "kappa": 1000.0},
        {"material": "HGO, dispersed", "kappa": 10.0},
    ]
    wanted = {"material": material, "kappa": kappa}
    agree(list(select(cases, read_values(words))) == [wanted], words)
    agree(list(select(cases, read_values(case_text(wanted)))) == [wanted], case_text(wanted))


@pytest.mark.parametrize(
    ("words", "said"),
    [("x=4", "no case has x=4; --list"), ("y=2", "no case has y=2"), ("x", "write NAME=VALUE")],
)
def test_no_case_is_chosen(words, said, capsys):
    with pytest.raises(SystemExit) as caught:
        squares().main(["--x", "2,3", "--only", words], COMM)
    found = COMM.bcast(capsys.readouterr().err)
    agree(caught.value.code == 2 and said in found, found)


def test_study_runs_what_its_file_lacks(tmp_path, capsys):
    """It prints all records; they have the command and the version that made them."""
    file = str(COMM.bcast(str(tmp_path / "new/squares.json")))
    first = squares().main(["--x", "2", "--json", file], COMM)
    agree([r["square"] for r in first] == [4] and first[0]["command"] and first[0]["version"])
    said = COMM.bcast(capsys.readouterr().out)
    agree([json.loads(said)] == first, said)
    work = []

    def negate(case, keep, _args, _comm) -> None:
        work.append(case)
        keep({}, {"square": -1})

    study = squares(negate)
    records = study.main(["--x", "2,3", "--json", file], COMM)
    agree([r["square"] for r in records] == [4, -1] and work == [{"x": 3}], records)
    said = COMM.bcast(capsys.readouterr().out)
    agree(said.startswith("in the records already: {") and said.count("\n") == 2, said)
    again = study.main(["--x", "2", "--again", "--json", file], COMM)
    agree(again[0]["square"] == -1)
    agree(on_first(lambda: len(json.loads(Path(file).read_text()))) == 2)


def test_study_goes_on_after_a_case_that_fails(tmp_path, capsys):
    """The exit status is 1; records before and after the failure are in the file."""
    file = COMM.bcast(str(tmp_path / "squares.json"))

    def run(case, keep, *_rest) -> None:
        if case["x"] == 2:
            raise ConvergenceError("two is too many")
        keep({}, {"square": case["x"] ** 2})

    with pytest.raises(SystemExit) as caught:
        squares(run).main(["--x", "1,2,3", "--json", file], COMM)
    said = COMM.bcast(capsys.readouterr().err)
    agree(caught.value.code == 1 and "two is too many" in said, said)
    agree(on_first(lambda: [r["x"] for r in json.loads(Path(file).read_text())]) == [1, 3])


def test_file_that_cannot_be_written_is_refused(tmp_path, capsys):
    with pytest.raises(SystemExit) as caught:
        squares().main(["--x", "1", "--json", COMM.bcast(str(tmp_path))], COMM)
    found = COMM.bcast(capsys.readouterr().err)
    said = r"--json '.*' cannot be used: .*directory.*\. Name another file\."
    agree(caught.value.code == 2 and re.search(said, found), found)


@pytest.mark.parametrize("text", ["mine", '{"x": 1}', "[1, 2]", '[{"y": 1}]', "", "[]"])
@pytest.mark.parametrize("page", [False, True])
def test_file_of_something_else_is_refused(tmp_path, capsys, text, page):
    """The file is not changed. An empty one takes records, but makes no page."""
    file, folder = (Path(COMM.bcast(str(tmp_path / name))) for name in ("other.json", "page"))
    on_first(lambda: file.write_text(text))
    words = ["--x", "1", "--json", str(file), *(["--page", str(folder)] if page else [])]
    if text in ("", "[]") and not page:
        agree(squares().main(words, COMM)[0]["square"] == 1)
        return
    with pytest.raises(SystemExit) as caught:
        squares().main(words, COMM)
    found = COMM.bcast(capsys.readouterr().err)
    agree(caught.value.code == 2 and "other.json' holds no records of squares" in found, found)
    agree(("something else" in found) == (text not in ("", "[]")), found)
    agree(on_first(file.read_text) == text and not folder.exists())


@pytest.mark.parametrize(
    ("study", "words", "said"),
    [
        (compare, "--kappa 0", "argument --kappa: '0' is not a positive number"),
        (compare, "--dofs 1e5", "argument --dofs: '1e5' is not a number 1, 2, 3"),
        (compare, "--solvers feti,umfpack", "--solvers: 'umfpack' is none of: feti, feti-dual"),
        (compare, "--loaded 1 --path 1", "--path and --loaded exclude each other"),
        (compare, "--path 1 --solvers feti,gamg", "--path takes no other solvers than feti, mum"),
        (compare, "--path 1 --solvers mumps", "--path needs feti among the --solvers"),
        (compare, "--path 1 --geometry block", "--geometry block goes without --path"),
        (compare, "--dofs 900 --subdomains 100000", "100000"),
        (compare, "-log_view --kappa 10 50", "arguments: 50 after --kappa: it takes no more than"),
        (compare, "50", "arguments: 50;"),
        (cube, "--sets jump", "argument --sets: 'jump' is none of: papers, choices, jumps"),
        (nonlinear, "--geometry cube", "'cube' is none of: tube, vessel"),
        (nonlinear, "--geometry tube --size 1 --subdomains 100000", "100000"),
        (scaling, "--processes 100000", "shared ones measure nothing"),
        (scaling, "--processes 1 --count 64 --subdomains 8", "as many --subdomains"),
        (verification, "--part tube --pressures 100,10", "[100.0, 10.0] do not rise"),
        (verification, "--part tube --element q9", "invalid choice: 'q9'"),
        (verification, "--part bone", "'bone' is none of: published, tube, inf-sup"),
    ],
)
@pytest.mark.serial
def test_wrong_words_end_before_any_work(study, words, said, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as caught:
        study.STUDY.main(words.split())
    found = capsys.readouterr().err
    assert caught.value.code == 2
    assert said in found
