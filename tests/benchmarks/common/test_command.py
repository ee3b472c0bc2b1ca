# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What a study prints on its way."""

from __future__ import annotations

import io

from collective import COMM, raises

from benchmarks.common import command


class Broken(io.StringIO):
    """A stream that takes nothing: a full disk behind it, or a terminal that is gone."""

    def write(self, _text: str) -> int:
        raise BrokenPipeError("nobody reads this")


def test_line_that_cannot_be_printed_ends_all_processes():
    """The first process alone prints."""
    with raises(BrokenPipeError, "nobody reads this"):
        command.say("a line", COMM, Broken())
