# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The words that a study takes, and what it prints on its way."""

from __future__ import annotations

import io

import pytest
from collective import COMM, agree, raises

from benchmarks.common import command


class Broken(io.StringIO):
    """A stream that takes nothing: a full disk behind it, or a terminal that is gone."""

    def write(self, _text: str) -> int:
        raise BrokenPipeError("nobody reads this")


def test_line_that_cannot_be_printed_ends_all_processes():
    """The first process alone prints."""
    with raises(BrokenPipeError, "nobody reads this"):
        command.say("a line", COMM, Broken())


@pytest.mark.serial
@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("--pressures 10 50", "arguments: 50 after --pressures: it takes no more than one word"),
        ("-log_view --pressures 10 50", "arguments: 50 after --pressures"),
        ("50", "arguments: 50\n"),
        ("--pressure 50", "arguments: --pressure 50\n"),
    ],
)
def test_words_left_over(capsys, line, message):
    """Nothing is left to PETSc but words with a single dash, each with its value."""
    parser = command.create_parser("study", None, COMM)
    parser.add_argument("--pressures", type=command.several(float))
    words = "-ksp_rtol 1e-9 --pressures 10,50 -ksp_monitor".split()
    agree(command.parse_words(parser, words).pressures == [10.0, 50.0])
    with pytest.raises(SystemExit):
        command.parse_words(parser, line.split())
    said = capsys.readouterr().err
    agree(message in said, said)
