# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The bar of a study, and what it prints."""

from __future__ import annotations

import io
import sys

from collective import COMM, agree, raises

from benchmarks.common import progress


def test_bar_on_a_terminal_and_nowhere_else(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    for stream in (Terminal(), io.StringIO()):
        monkeypatch.setattr(sys, "stderr", stream)
        shown = progress.Bar(2, COMM)
        shown.begin("the case")
        shown.monitor(None, 3, 1e-5)
        shown.end()
        text = stream.getvalue()
        if COMM.rank == 0 and stream.isatty():
            agree("0/2  the case: iteration 3, ‖b − A x‖ = 1.0e-05" in text, text)
            assert text.endswith("\r\x1b[K")
        else:
            agree(True)
            assert text == ""


class Broken(io.StringIO):
    """A stream that takes nothing: a full disk behind it, or a terminal that is gone."""

    def isatty(self) -> bool:
        return True

    def write(self, _text: str) -> int:
        raise BrokenPipeError("nobody reads this")


def test_line_that_cannot_be_printed_ends_all_processes():
    """The first process alone prints."""
    with raises(BrokenPipeError, "nobody reads this"):
        progress.say("a line", COMM, Broken())


def test_bar_that_cannot_be_shown_ends_none(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Broken())
    shown = progress.Bar(2, COMM)
    shown.begin("the case")
    shown.end()
    agree(shown.shown == (COMM.rank == 0))
