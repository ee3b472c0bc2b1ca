# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Sphinx configuration; ``make docs`` builds with all warnings as errors.

The pages need no network: formulas are drawn by the MathJax of Debian's package node-mathjax-full,
or by the file tex-svg-full.js that the variable MATHJAX names; it becomes part of the site. Where
there is neither, the pages load it from the network, and the test of the site complains.
"""

from __future__ import annotations

import inspect
import os
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from sphinx.application import Sphinx
from sphinx.util.inspect import stringify_signature

import dolfinx_feti

project = "dolfinx_feti"
author = "the dolfinx_feti authors"
project_copyright = "2026, the dolfinx_feti authors"
release = dolfinx_feti.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx_design",
]
myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
exclude_patterns = ["_build", "demos/downloads"]
suppress_warnings = ["mystnb.unknown_mime_type"]
copybutton_exclude = ".linenos, .gp, .go"

# scripts/demo_pages.py has executed the demos.
nb_execution_mode = "off"
nb_merge_streams = True
nb_ipywidgets_js: dict[str, dict[str, str]] = {}

# With a network, signatures link to the pages of other projects: DOLFINX_FETI_LINKS=1 make docs.
if os.environ.get("DOLFINX_FETI_LINKS"):
    extensions.append("sphinx.ext.intersphinx")
    intersphinx_mapping = {
        "dolfinx": ("https://docs.fenicsproject.org/dolfinx/main/python", None),
        "ufl": ("https://docs.fenicsproject.org/ufl/main", None),
        "basix": ("https://docs.fenicsproject.org/basix/main/python", None),
        "petsc4py": ("https://petsc.org/release/petsc4py", None),
        "numpy": ("https://numpy.org/doc/stable", None),
        "scipy": ("https://docs.scipy.org/doc/scipy", None),
    }

add_module_names = False  # a page names the package that a name is imported from
autoclass_content = "both"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
napoleon_custom_sections = ["Note: quadrature"]

html_theme = "sphinx_book_theme"
html_title = f"dolfinx_feti {release}"
html_theme_options = {
    "home_page_in_toc": True,
    "show_toc_level": 2,
    "use_download_button": False,
    "use_fullscreen_button": False,
}
html_context = {"default_mode": "auto"}
html_copy_source = False
html_show_search_summary = False  # a page that is a file may not read another file
html_static_path = ["_static"]
html_css_files = ["site.css"]

debian = "/usr/share/nodejs/mathjax-full/es5/tex-svg-full.js"
mathjax = Path(os.environ.get("MATHJAX", debian))
if mathjax.is_file():
    html_static_path.append(str(mathjax))
    mathjax_path = mathjax.name


def show_constructor(
    app: Sphinx,
    what: str,
    name: str,
    obj: object,
    options: Any,
    signature: str | None,
    returned: str | None,
) -> tuple[str | None, str | None]:
    """Return the signature of ``__init__`` for a class that has ``__new__``, too.

    Sphinx would show the arguments of ``__new__``, which hands all of them on.
    """
    if isinstance(obj, type) and signature and obj.__new__ is not object.__new__:
        without_return = inspect.signature(obj).replace(return_annotation=inspect.Signature.empty)
        signature = stringify_signature(without_return)
    return signature, returned


def setup(app: Sphinx) -> None:
    """Connect the function above to Sphinx."""
    app.connect("autodoc-process-signature", show_constructor)
