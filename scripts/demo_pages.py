#!/usr/bin/env python3
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The demos as pages of the site: each is executed as a notebook, and the gallery has its picture.

    python3 scripts/demo_pages.py

writes into `docs/demos/`, for every `demos/demo_*.py`, the executed notebook, which is the page; in
`docs/demos/downloads/` the same notebook without the links of the page, and the script; and a
thumbnail, the last picture in the notebook's output. `docs/demos/index.md` is the gallery. None of
it is kept in the repository.

A demo that fails ends the build with its traceback. One that ran with the same files and the same
version of dolfinx is not executed again.
"""

from __future__ import annotations

import base64
import hashlib
import io
import os
import re
import shutil
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode
from nbformat.v4 import new_code_cell
from PIL import Image

import dolfinx

ROOT = Path(__file__).resolve().parents[1]
DEMOS = ROOT / "demos"
PAGES = ROOT / "docs/demos"
DOWNLOADS = PAGES / "downloads"
RUNS = ROOT / "build/demos"
TIMEOUT = 600  # of a cell [s]
WIDTH = 640  # of a thumbnail


@dataclass(frozen=True)
class Page:
    """A demo in the gallery.

    Attributes:
        name: The file without its ending.
        teaser: A line below the picture.
        group: Heading in the gallery.
        arguments: Its command line on the site, if it has one.
        size: Length of the elements' edges on the site, in place of that in the line `size = …`,
            of a demo that takes minutes otherwise.
    """

    name: str
    teaser: str
    group: str
    arguments: tuple[str, ...] = ()
    size: float | None = None


FIRST = "First steps"
WALLS = "Artery walls and materials"
LARGE = "Large deformations"
METHOD = "The method"
GALLERY = [
    Page("demo_hyperelasticity", "dolfinx's program, with one import changed.", FIRST),
    Page("demo_linear_elasticity", "A beam under its weight: two lines change.", FIRST),
    Page("demo_poisson", "FETI compared with dolfinx, and the order of convergence.", FIRST),
    Page("demo_solver_options", "What -ksp_view shows, and what options change.", FIRST),
    Page("demo_own_artery", "Mesh, fibres, 16 kPa, a stress, a force, a picture.", WALLS),
    Page("demo_own_material", "An energy: checked at a point, then inflated.", WALLS),
    Page("demo_artery", "A branched artery, and a direct solver for comparison.", WALLS, size=2.0),
    Page("demo_patient", "Imaged at 80 mmHg: without load, back, and on to 120.", WALLS),
    Page("demo_windkessel", "Five beats of an artery, and its pressure–volume loop.", WALLS),
    Page(
        "demo_case",
        "A TOML file with layers and conditions, and a command line.",
        WALLS,
        arguments=("--mesh", "tube", "--size", "0.5", "--subdomains", "8", "--steps", "4"),
    ),
    Page("demo_load_steps", "Adaptive load steps, and a run that is continued.", LARGE),
    Page("demo_thick_tube", "Inflated, and compared with the closed form.", LARGE),
    Page("demo_balloon", "Filled through its limit point, with the pressure unknown.", LARGE),
    Page("demo_contact", "A balloon opens a stenosed artery, and the wall recoils.", LARGE),
    Page("demo_memory", "Relaxation and damage, compared with closed forms.", LARGE),
    Page("demo_growth", "A ring that grows, and muscle that pulls.", LARGE),
    Page("demo_pulse", "Inertia, adapted time steps, and a balance of energies.", LARGE),
    Page("demo_nearly_incompressible", "Iterations over κ, compared with multigrid.", METHOD),
    Page("demo_jumps", "A checkerboard of soft and stiff squares.", METHOD),
    Page("demo_torn_matrix", "A MATIS of your own, compared with PCBDDC.", METHOD),
    Page(
        "demo_classical_vs_all_floating",
        "The paper's linear study in small: two variants, three preconditioners.",
        METHOD,
    ),
]


def main() -> int:
    """Execute what has changed; write the pages."""
    demos = {path.stem for path in DEMOS.glob("demo_*.py")}
    listed = {page.name for page in GALLERY}
    if demos != listed:
        sys.exit(f"demo_pages: GALLERY and demos/ differ in {sorted(demos ^ listed)}")
    DOWNLOADS.mkdir(parents=True, exist_ok=True)
    begin = time.perf_counter()
    for page in GALLERY:
        notebook = PAGES / f"{page.name}.ipynb"
        state = fingerprint(page)
        if not up_to_date(notebook, state):
            write_page(page, notebook, state)
    for path in (*PAGES.iterdir(), *DOWNLOADS.iterdir()):  # of demos that are gone
        if path.suffix in (".ipynb", ".py", ".png") and path.stem not in listed:
            path.unlink()
    (PAGES / "index.md").write_text(gallery(), encoding="utf-8")
    print(f"demo_pages: {len(GALLERY)} demos, {time.perf_counter() - begin:.0f} s")
    return 0


def fingerprint(page: Page) -> str:
    """Return a digest of all that the output of a demo depends on."""
    digest = hashlib.sha256(repr((page, dolfinx.__version__)).encode())
    files = [DEMOS / f"{page.name}.py", Path(__file__)]
    sources = (ROOT / "dolfinx_feti").rglob("*")
    files += sorted(path for path in sources if path.suffix in (".py", ".c", ".h", ".html"))
    for path in files:
        digest.update(path.read_bytes())
    return digest.hexdigest()


def up_to_date(notebook: Path, state: str) -> bool:
    """Whether a page exists and was made from these files."""
    if not notebook.is_file() or not notebook.with_suffix(".png").is_file():
        return False
    return nbformat.read(notebook, as_version=4).metadata.get("fingerprint") == state


def write_page(page: Page, path: Path, state: str) -> None:
    """Execute a demo; write notebook, script and thumbnail."""
    begin = time.perf_counter()
    notebook = executed(page)
    seconds = time.perf_counter() - begin
    nbformat.write(notebook, DOWNLOADS / path.name)
    shutil.copy(DEMOS / f"{page.name}.py", DOWNLOADS)
    notebook.metadata["fingerprint"] = state
    notebook.cells[0].source += "\n\n" + downloads(page, seconds)
    picture = last_picture(notebook)
    if picture is None:
        sys.exit(f"demo_pages: {page.name} shows no picture, and the gallery needs one")
    thumbnail(picture).save(path.with_suffix(".png"))
    nbformat.write(notebook, path)
    print(f"demo_pages: {page.name}, {seconds:.0f} s", flush=True)


def executed(page: Page) -> NotebookNode:
    """Return the demo as a notebook, with the output of its cells."""
    notebook = jupytext.read(DEMOS / f"{page.name}.py")
    notebook.cells[0].source = without_licence(notebook.cells[0].source)
    if page.arguments:
        words = ", ".join(f'"{word}"' for word in (f"{page.name}.py", *page.arguments))
        line = f"import sys\n\nsys.argv = [{words}]  # in a notebook, instead of a command line"
        notebook.cells.insert(1, new_code_cell(line))
    if page.size is not None:
        coarsen(notebook, page)
    folder = RUNS / page.name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    environment = {k: v for k, v in os.environ.items() if k != "MPLBACKEND"}
    environment["PYTHONPATH"] = str(ROOT)
    environment["OMP_NUM_THREADS"] = "1"
    client = NotebookClient(
        notebook,
        timeout=TIMEOUT,
        kernel_name="python3",
        resources={"metadata": {"path": str(folder)}},
    )
    client.execute(env=environment)
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)  # times of day
        tidy(cell)
    return notebook


def coarsen(notebook: NotebookNode, page: Page) -> None:
    """Set the size of the elements of a page, and say so."""
    lines = 0
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.source, n = re.subn(
                r"^size = [\d.]+", f"size = {page.size}", cell.source, flags=re.M
            )
            lines += n
    if lines != 1:
        sys.exit(f"demo_pages: {page.name} has {lines} lines `size = …`, and one is needed")
    note = f"In this notebook `size` is {page.size}: the mesh is coarser than that of the script."
    notebook.cells[0].source += f"\n\n{note}"


def without_licence(text: str) -> str:
    """Return a text without the lines of copyright and licence."""
    lines = [line for line in text.splitlines() if not line.startswith(("Copyright", "SPDX"))]
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines)).strip()


def tidy(cell: NotebookNode) -> None:
    """Join what was written to one stream piece by piece."""
    joined: list[NotebookNode] = []
    for output in cell.get("outputs", []):
        last = joined[-1] if joined else None
        if last and output.output_type == last.output_type == "stream" and output.name == last.name:
            last.text += output.text
        else:
            joined.append(output)
    if "outputs" in cell:
        cell.outputs = joined


def downloads(page: Page, seconds: float) -> str:
    """Return the line below the title: what can be downloaded, and how long the demo took."""
    script = f"{{download}}`Script <./downloads/{page.name}.py>`"
    notebook = f"{{download}}`notebook <./downloads/{page.name}.ipynb>`"
    took = f"executed in {seconds:.0f} s on one process, dolfinx {dolfinx.__version__}"
    return f"{script} · {notebook} · {took}"


def last_picture(notebook: NotebookNode) -> bytes | None:
    """Return the last PNG in the output of a notebook."""
    picture = None
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            if "image/png" in output.get("data", {}):
                picture = base64.b64decode(output.data["image/png"])
    return picture


def thumbnail(picture: bytes) -> Image.Image:
    """Return a picture on a white card of 3 : 2."""
    image = Image.open(io.BytesIO(picture)).convert("RGBA")
    size = (WIDTH, WIDTH * 2 // 3)
    image.thumbnail(size)
    card = Image.new("RGBA", size, "white")
    card.alpha_composite(image, tuple((c - i) // 2 for c, i in zip(size, image.size, strict=True)))
    return card.convert("RGB")


def title(page: Page) -> str:
    """Return the heading of a demo."""
    text = (DEMOS / f"{page.name}.py").read_text(encoding="utf-8")
    heading = re.search(r"^# # (.+)$", text, re.M)
    if heading is None:
        sys.exit(f"demo_pages: {page.name} has no heading")
    return heading[1]


def gallery() -> str:
    """Return the page of the gallery."""
    lines = [
        "# Demos",
        "",
        "Each demo is a script and a notebook. It needs the installed package and PyVista alone:",
        "download it and run `python3 demo_own_artery.py`, or `mpirun -n 4 python3 …` on four",
        "processes. In a checkout without FEniCSx, `scripts/with-fenicsx python3",
        "demos/demo_own_artery.py`. Pictures are written to the present folder.",
        "",
    ]
    for group in dict.fromkeys(page.group for page in GALLERY):
        lines += [f"## {group}", "", "::::{grid} 1 2 2 3", ":gutter: 3", ""]
        for page in (page for page in GALLERY if page.group == group):
            lines += [
                f":::{{grid-item-card}} {title(page)}",
                f":link: {page.name}",
                ":link-type: doc",
                f":img-top: {page.name}.png",
                f":img-alt: {title(page)}",
                "",
                page.teaser,
                ":::",
                "",
            ]
        lines += ["::::", ""]
    lines += ["```{toctree}", ":hidden:", "", *(page.name for page in GALLERY), "```", ""]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
