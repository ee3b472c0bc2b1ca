# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What documents and pages of the site name exists: paths, links, commands, modules, names."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import fields

import look_at_site
import pytest
from wall_files import ROOT

from dolfinx_feti.feti.options import FETIOptions

PACKAGE = ROOT / "dolfinx_feti"
FOLDERS = ("benchmarks", "demos", "docs", "dolfinx_feti", "meshes", "scripts", "tests")
DOCUMENTS = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "AGENTS.md")),
    *ROOT.glob("*/README.md"),
    *sorted((ROOT / "docs").rglob("*.md")),
]

#: A program in Python.
BLOCK = r"^```python\n(.*?)^```"

pytestmark = pytest.mark.serial


def paths(text: str) -> Iterator[str]:
    """Yield what looks like a path of this repository, between backticks."""
    for quoted in re.findall(r"`([^`\n]+)`", text):
        for word in quoted.split():
            if re.fullmatch(r"[\w.-]+(/[\w.-]+)+/?", word):
                known = word.split("/")[0] in FOLDERS or (PACKAGE / word).exists()
                if known or word.endswith((".py", ".md")):
                    yield word


def links(text: str) -> Iterator[str]:
    """Yield the targets of links and pictures that are files, in Markdown, MyST and HTML."""
    markdown = re.findall(r"\]\(([^)\s]+)\)", text)
    directives = re.findall(r"^```\{image\} (\S+)$", text, re.M)
    html = re.findall(r'<(?:source|img) [^>]*?(?:src|srcset)="([^"]+)"', text)
    for target in (*markdown, *directives, *html):
        if not re.match(r"https?://|#", target):
            yield target.split("#")[0]


def imported(source: str) -> Iterator[tuple[str, str]]:
    """Yield the modules of this repository that a source imports from, and the names."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in FOLDERS:
            yield from ((node.module, alias.name) for alias in node.names)


def can_be_imported(module: str, name: str) -> bool:
    """Return True if a module has a name, or a module of that name."""
    if hasattr(importlib.import_module(module), name):
        return True
    return importlib.util.find_spec(f"{module}.{name}") is not None


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_what_a_document_names_exists(document):
    """Paths, targets of links, modules of commands, and names that blocks import."""
    text = document.read_text(encoding="utf-8")
    tops = (ROOT, PACKAGE)  # pages name folders of the package without its name, too
    missing = [path for path in paths(text) if not any((top / path).exists() for top in tops)]
    missing += [target for target in links(text) if not (document.parent / target).exists()]
    modules = re.findall(r"-m\s+((?:benchmarks|meshes)[.\w]+\w)", text)
    missing += [name for name in modules if importlib.util.find_spec(name) is None]
    names = [name for source in re.findall(BLOCK, text, re.M | re.S) for name in imported(source)]
    missing += [".".join(it) for it in names if not can_be_imported(*it)]
    assert not missing


def test_pages_that_the_code_names_exist():
    sources = [path for name in FOLDERS for path in (ROOT / name).rglob("*.py")]
    named = {page for path in sources for page in re.findall(r"docs/[\w/]+\.md", path.read_text())}
    written = {"docs/modules.md", "docs/demos/index.md"}  # for the site
    assert len(named) > 20 and not [page for page in named - written if not (ROOT / page).exists()]


def test_pages_of_the_site_have_titles_of_their_own():
    """This holds for texts, and for demos, whose heading is a comment."""
    written = {ROOT / "docs/changelog.md", *(ROOT / "docs/demos").glob("*.md")}  # not by hand
    pages = {*(ROOT / "docs").rglob("*.md"), *(ROOT / "demos").glob("demo_*.py")} - written
    mark = {".md": "# ", ".py": "# # "}
    headings = {
        page: re.search(f"^{mark[page.suffix]}(.+)$", page.read_text(encoding="utf-8"), re.M)
        for page in pages
    }
    assert not [page for page, found in headings.items() if found is None]
    titles = Counter(found[1].casefold() for found in headings.values())
    assert len(titles) > 30
    assert not [title for title, times in titles.items() if times > 1]


#: Pages that are looked things up in, rather than read: reference, and what scripts make.
LONG = {
    "equations",
    "messages",
    "modules",
    "notation",
    "options",
    "petsc_options",
    "references",
    "theory",
}

#: Words of a page that is read to its end.
BOUND = 900

#: Words of a page of results, which has many sections with a sentence each.
RESULTS = 1200


#: A folded table of a page, and the line of records below an open one.
NOT_READ = r"<details>.*?</details>|^\*Records? of [^\n]*\*$"


def test_pages_are_short():
    """A visitor reads a page to its end; folded tables and lines of records do not count.

    A link counts as one word: its text is often the title of another page.
    """

    def count_words(text: str) -> int:
        read = re.sub(NOT_READ, "", text, flags=re.M | re.S)
        return len(re.sub(r"\[[^][]*\]\([^()]*\)", "link", read).split())

    words = {
        path: count_words(path.read_text(encoding="utf-8"))
        for path in (ROOT / "docs").rglob("*.md")
        if "demos" not in path.parts
    }
    long = [
        path
        for path, n in words.items()
        if n > (RESULTS if "results" in path.parts else BOUND) and path.stem not in LONG
    ]
    assert not long


def test_names_of_the_api_exist():
    table = (ROOT / "docs/api.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(dolfinx_feti[\w.]*)` \| (.+) \|$", table, re.M)
    assert len(rows) > 5
    for module, cell in rows:
        names = set(re.findall(r"`(\w+)`", cell))
        it = importlib.import_module(module)
        assert names <= set(getattr(it, "__all__", dir(it))), module


def test_options_and_their_defaults_are_those_of_the_code():
    page = (ROOT / "docs/options.md").read_text(encoding="utf-8")
    table = page.partition("| values, the default first |")[2]
    rows = re.findall(r"^\| `feti_(\w+)` \| `?([\w.]+)", table.partition("\n\n")[0], re.M)
    assert len(rows) == len(dict(rows))
    assert dict(rows) == {option.name: str(option.default) for option in fields(FETIOptions)}


def test_theory_names_files_that_exist():
    """As *feti/coarse: gathered, group; loading* below a heading, or [feti/subdomain: soft]."""
    text = (ROOT / "docs/theory.md").read_text(encoding="utf-8")
    found = re.findall(r"^\*([a-z/]+.*)\*$|\[([a-z/]+: [a-z, ]+)\]", text, re.M)
    places = [part.partition(": ") for pair in found for part in "".join(pair).split("; ")]
    paths = [PACKAGE / folder / name for folder, _, names in places for name in names.split(", ")]
    assert len(paths) > 40
    assert not [path for path in paths if not (path.is_dir() or path.with_suffix(".py").exists())]


def test_changelog_is_release_notes():
    """Short lines in the usual order, with links that lead somewhere."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    order = ["Added", "Changed", "Fixed", "Removed"]
    for section in re.split(r"^## ", text, flags=re.M)[1:]:
        heads = re.findall(r"^### (.+)$", section, re.M)
        assert heads == [head for head in order if head in heads]
    entries = re.findall(r"^- (.+)$", text, re.M)
    assert not [entry for entry in entries if len(re.sub(r"\(\[.*", "", entry).split()) > 18]
    assert not [target for target in links(text) if not (ROOT / target).exists()]


def test_links_have_a_text():
    """A link without text is filled in by Sphinx alone, and cannot be seen elsewhere."""
    pages = [
        ROOT / "README.md",
        *(ROOT / "docs").rglob("*.md"),
        *(ROOT / "benchmarks").rglob("*.md"),
    ]
    empty = [str(page) for page in pages if "[](" in page.read_text(encoding="utf-8")]
    assert not empty


def test_paths_are_found():
    text = (
        "`a/b.py`, `docs/usage.md --help`, `scripts/with-fenicsx COMMAND`, `output/artery/`, `x/y`"
    )
    assert list(paths(text)) == ["a/b.py", "docs/usage.md", "scripts/with-fenicsx"]
    assert list(links("[a](b/c.md#d) [e](https://f) ![g](h.png) [](#i)")) == ["b/c.md", "h.png"]
    shown = '```{image} a.png\n```\n<source media="(x)" srcset="b.png">\n<img src="c.png" alt="">'
    assert list(links(shown)) == ["a.png", "b.png", "c.png"]
    names = list(imported("from dolfinx_feti.x import y, z\nimport numpy"))
    assert names == [("dolfinx_feti.x", "y"), ("dolfinx_feti.x", "z")]


WHOLE = (
    '<h1 id="top">A</h1><a href="#top">x</a><a href="b.html#c">y</a><a href="https://z.org">z</a>'
)


@pytest.mark.parametrize(
    ("page", "faults"),
    [
        (WHOLE, []),
        ('<a href="c.html">', ["names c.html, which does not exist"]),
        ('<img src="no.png">', ["names no.png, which does not exist"]),
        ('<a href="b.html#d">', ["names b.html#d, whose heading does not exist"]),
        ('<a href="#d">', ["names #d, whose heading does not exist"]),
        (
            '<script src="https://z.org/x.js"></script>',
            ["loads https://z.org/x.js from the network"],
        ),
        ('<link href="//z.org/x.css">', ["loads //z.org/x.css from the network"]),
    ],
)
def test_faults_of_a_site(tmp_path, page, faults):
    """`make docs` looks at the whole site; what the theme keeps in ``_static`` is no page."""
    (tmp_path / "_static").mkdir()
    (tmp_path / "_static/x.html").write_text("<a href='{{ y }}'>")
    (tmp_path / "b.png").write_bytes(b"")
    (tmp_path / "a.html").write_text(page)
    (tmp_path / "b.html").write_text('<p id="c"><img src="b.png"></p>')
    assert list(look_at_site.broken_links(tmp_path)) == [f"a.html {fault}" for fault in faults]
