#!/usr/bin/env python3
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Look at the site as a reader does: all links, and every page in a browser without a network.

    python3 scripts/look_at_site.py build/docs

1. Files: every link and every picture leads to a file of the site, and to a heading that exists;
   nothing is loaded from the network.
2. Pages, in headless Chromium at the width of a desktop and of a telephone: they load without an
   error in the console, pictures are drawn, formulas are rendered, and nothing sticks out.
3. Search finds what it should.

The formulas are drawn by a MathJax of the site's own (docs/conf.py). The second and third part need
selenium, Chromium and its driver. Without them (outside of a Debian tree) the first part alone is
done, and that is said.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

#: Width and height of the windows.
DESKTOP = (1280, 900)
TELEPHONE = (400, 800)
#: Words to search for, and a page that has to be among the results.
SEARCHES = {"all-floating": "theory.html", "MATIS": "torn_matrix.html"}
#: Attributes that load what they name; links (a href) only lead there.
LOADS = {("script", "src"), ("img", "src"), ("link", "href"), ("iframe", "src"), ("source", "src")}

#: Errors in the console that are not the site's: the pydata-sphinx-theme 0.23 of Debian sid has a
#: bootstrap.js that lacks tooltips.
THEIRS = ("e.Tooltip is not a constructor",)

#: What a reader would see of a page: run in the browser when the page and its formulas are done.
LOOK = """
const formulas = [...document.querySelectorAll('.math')];
const limit = document.documentElement.clientWidth + 1;
const scrolls = e => ['auto', 'scroll', 'hidden'].includes(getComputedStyle(e).overflowX);
const framed = e =>
  e !== null && e.tagName !== 'ARTICLE' && (scrolls(e) || framed(e.parentElement));
return {
  title: document.title,
  text: document.querySelector('article, main').innerText.trim().length,
  pictures: [...document.images].filter(i => !i.complete || !i.naturalWidth).map(i => i.src),
  raw: formulas.filter(f => !f.querySelector('mjx-container')).map(f => f.innerText.slice(0, 60)),
  wrong: [...document.querySelectorAll('[data-mml-node="merror"]')]
    .map(e => e.getAttribute('title') || e.textContent.slice(0, 60)),
  formulas: formulas.length,
  width: document.documentElement.scrollWidth,
  window: document.documentElement.clientWidth,
  wide: [...document.querySelectorAll('article *')]
    .filter(e => e.getBoundingClientRect().right > limit && !framed(e))
    .slice(0, 3).map(e => e.tagName + ' ' + e.textContent.slice(0, 40)),
};
"""

READY = """
const done = arguments[0];
const formulas = document.querySelector('.math') !== null;
const start = Date.now();
(function wait() {
  if (document.readyState === 'complete') {
    if (!formulas) { done(true); return; }
    if (window.MathJax && MathJax.startup && MathJax.startup.promise) {
      MathJax.startup.promise.then(() => done(true)); return;
    }
  }
  if (Date.now() - start > 20000) { done(false); return; }
  setTimeout(wait, 20);
})();
"""


class Outline(HTMLParser):
    """What a page links to, what it loads, and the anchors that it has."""

    def __init__(self, text: str) -> None:
        """Read a page."""
        super().__init__()
        self.links: list[tuple[str, str, str]] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep the links and anchors of a tag."""
        values = {name: value for name, value in attrs if value}
        self.anchors |= {values[name] for name in ("id", "name") if name in values}
        for name in ("href", "src"):
            if name in values:
                self.links.append((tag, name, values[name]))


def pages_of(site: Path) -> list[Path]:
    """Return the pages; the files of the theme in `_static` are not pages."""
    return sorted(path for path in site.rglob("*.html") if "_static" not in path.parts)


def broken_links(site: Path) -> Iterator[str]:
    """Yield what leads nowhere, and what is loaded from the network."""
    pages = {path: Outline(path.read_text(encoding="utf-8")) for path in pages_of(site)}
    for path, outline in pages.items():
        here = path.relative_to(site)
        for tag, attribute, link in outline.links:
            url = urlsplit(link)
            if url.scheme in ("http", "https") or link.startswith("//"):
                if (tag, attribute) in LOADS:
                    yield f"{here} loads {link} from the network"
            elif not url.scheme:
                target = (path.parent / unquote(url.path)).resolve() if url.path else path
                anchor = unquote(url.fragment)
                if not target.exists():
                    yield f"{here} names {link}, which does not exist"
                elif anchor and target in pages and anchor not in pages[target].anchors:
                    yield f"{here} names {link}, whose heading does not exist"


def browser() -> Any | None:
    """Start Chromium without a network; None if it is not installed."""
    chromium = shutil.which("chromium")
    driver = shutil.which("chromedriver")
    try:
        from selenium import webdriver
    except ModuleNotFoundError:
        return None
    if chromium is None or driver is None:
        return None
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for word in ("headless=new", "no-sandbox", "disable-gpu", "disable-dev-shm-usage"):
        options.add_argument(f"--{word}")
    options.add_argument("--host-resolver-rules=MAP * ~NOTFOUND")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    return webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))


def resize(chrome: Any, size: tuple[int, int]) -> None:
    """Set the size of the page; a window cannot become as narrow as a telephone."""
    metrics = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": False}
    chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)


def faults_of_page(chrome: Any, path: Path, size: tuple[int, int]) -> Iterator[str]:
    """Yield what is wrong with a page in a window."""
    resize(chrome, size)
    chrome.get(path.as_uri())
    if not chrome.execute_async_script(READY):
        yield "formulas are not rendered within 20 s"
        return
    seen = chrome.execute_script(LOOK)
    if not seen["title"] or seen["text"] < 20:
        yield "has no text"
    for fault, faulty in (
        ("pictures are missing", seen["pictures"]),
        ("formulas are not rendered", seen["raw"]),
        ("formulas are wrong", seen["wrong"]),
        ("errors in the console", [e["message"] for e in errors(chrome)]),
    ):
        if faulty:
            yield f"{fault}: {faulty[:3]}"
    if seen["width"] > seen["window"] + 1:
        yield f"is {seen['width']} px wide in {seen['window']} px: {seen['wide']}"


def errors(chrome: Any) -> list[dict[str, str]]:
    """Return the errors in the console since the last call."""
    severe = [entry for entry in chrome.get_log("browser") if entry["level"] == "SEVERE"]
    return [entry for entry in severe if not entry["message"].endswith(THEIRS)]


def faults_of_search(chrome: Any, site: Path) -> Iterator[str]:
    """Yield the words that search does not find where they are."""
    for words, page in SEARCHES.items():
        chrome.get(f"{(site / 'search.html').as_uri()}?q={words}")
        deadline = time.monotonic() + 20.0
        links: list[str] = []
        while not any(f"/{page}" in link for link in links) and time.monotonic() < deadline:
            time.sleep(0.2)
            links = chrome.execute_script(
                "return [...document.querySelectorAll('#search-results li a')].map(a => a.href)"
            )
        if not any(f"/{page}" in link for link in links):
            yield f"search for {words!r} finds {len(links)} pages, and not {page}"


def main() -> int:
    """Look at a site; return 1 if something is wrong with it."""
    site = Path(sys.argv[1] if len(sys.argv) > 1 else "build/docs").resolve()
    pages = pages_of(site)
    if not (site / "index.html").is_file():
        sys.exit(f"look_at_site: there is no site in {site}: make docs builds it")
    faults = list(broken_links(site))
    chrome = browser()
    looked = "links only: selenium and Chromium are not installed to look at the pages"
    if chrome is None and os.environ.get("DOLFINX_FETI_INSIDE", "").endswith("-docs"):
        faults.append("the tree for the documentation has no Chromium")
    if chrome is not None:
        with chrome:
            formulas = 0
            for path in pages:
                for size in (DESKTOP, TELEPHONE):
                    for fault in faults_of_page(chrome, path, size):
                        faults.append(f"{path.relative_to(site)} ({size[0]} px): {fault}")
                formulas += chrome.execute_script(LOOK)["formulas"]
            faults += faults_of_search(chrome, site)
        if formulas == 0:
            faults.append("there is no formula on any page")
        looked = (
            f"{formulas} formulas, {len(SEARCHES)} searches, {DESKTOP[0]} and {TELEPHONE[0]} px"
        )
    for fault in faults:
        print(f"look_at_site: {fault}")
    print(f"look_at_site: {len(pages)} pages, {looked}: {len(faults)} fault(s)")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
