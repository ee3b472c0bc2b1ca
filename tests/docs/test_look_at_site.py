# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The test of the site finds what is broken in one; `make docs` runs it on the whole site."""

from __future__ import annotations

import look_at_site
import pytest

pytestmark = pytest.mark.serial

WHOLE = (
    '<h1 id="top">A</h1><a href="#top">x</a><a href="b.html#c">y</a><a href="https://z.org">z</a>'
)


def site(folder, a: str, b: str = '<p id="c"><img src="b.png"></p>'):
    (folder / "b.png").write_bytes(b"")
    (folder / "a.html").write_text(a)
    (folder / "b.html").write_text(b)
    return folder


def test_whole_site(tmp_path):
    assert list(look_at_site.broken_links(site(tmp_path, WHOLE))) == []


@pytest.mark.parametrize(
    ("page", "fault"),
    [
        ('<a href="c.html">', "a.html names c.html, which does not exist"),
        ('<img src="no.png">', "a.html names no.png, which does not exist"),
        ('<a href="b.html#d">', "a.html names b.html#d, whose heading does not exist"),
        ('<a href="#d">', "a.html names #d, whose heading does not exist"),
        (
            '<script src="https://z.org/x.js"></script>',
            "a.html loads https://z.org/x.js from the network",
        ),
        ('<link href="//z.org/x.css">', "a.html loads //z.org/x.css from the network"),
    ],
)
def test_faults(tmp_path, page, fault):
    assert list(look_at_site.broken_links(site(tmp_path, page))) == [fault]


def test_what_the_theme_keeps_is_no_page(tmp_path):
    (tmp_path / "_static").mkdir()
    (tmp_path / "_static/x.html").write_text("<a href='{{ y }}'>")
    assert list(look_at_site.broken_links(site(tmp_path, WHOLE))) == []
