#!/usr/bin/env python3
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Draw the pictures of README and of the site's first page, for light and for dark pages.

    scripts/with-fenicsx python3 scripts/images.py [wall] [speed] [workshop]

writes into ``docs/images/``

- ``wall.png`` and ``wall-dark.png``: the wall that ``demos/demo_artery.py`` computes, some minutes;
- ``speed.png`` and ``speed-dark.png``: times from the records ``docs/results/speed.json``;
- ``workshop.png``: the curves of the programs in ``docs/fitting.md``.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs/images"
RUNS = ROOT / "build/images"

sys.path.insert(0, str(ROOT))

#: Colours of the stress on dark pages: the lowest one of viridis is nearly black.
COLOURS_ON_DARK = "plasma"


def run(source: str, name: str) -> dict[str, Any]:
    """Run a program in ``build/images/NAME``; return its variables."""
    folder = RUNS / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    os.chdir(folder)
    variables: dict[str, Any] = {"__name__": "__main__"}
    exec(compile(source, name, "exec"), variables)
    return variables


def draw_wall() -> None:
    """Draw the wall of the demo: torn at rest, and coloured by the stress under pressure.

    It reads the variables ``problem`` and ``inflated`` of the demo.
    """
    from dolfinx_feti.output import pictures

    demo = run((ROOT / "demos/demo_artery.py").read_text(encoding="utf-8"), "demo_artery")
    panels = (pictures.subdomains(demo["problem"], title="64 subdomains"), demo["inflated"])
    pictures.draw(IMAGES / "wall.png", *panels)
    pictures.draw(IMAGES / "wall-dark.png", *panels, colours=COLOURS_ON_DARK, dark=True)


def draw_speed() -> None:
    """Draw the times of the records."""
    from benchmarks.common.compare.tables import draw
    from benchmarks.common.records import read_records

    records = read_records(ROOT / "docs/results/speed.json", lambda _: True, "speed")
    draw(records, IMAGES / "speed.png")
    draw(records, IMAGES / "speed-dark.png", dark=True)


def draw_workshop() -> None:
    """Run the programs of the page up to the picture, and take that."""
    page = (ROOT / "docs/fitting.md").read_text(encoding="utf-8")
    programs = re.findall(r"^```python\n(.*?)^```", page, re.M | re.S)
    (last,) = [number for number, text in enumerate(programs) if "curves.png" in text]
    run("".join(programs[: last + 1]), "workshop")
    shutil.copy(RUNS / "workshop/curves.png", IMAGES / "workshop.png")


PICTURES = {"wall": draw_wall, "speed": draw_speed, "workshop": draw_workshop}


def main() -> int:
    """Draw the pictures that are named, or all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("pictures", nargs="*", choices=[*PICTURES, []], metavar="PICTURE")
    chosen = parser.parse_args().pictures or list(PICTURES)
    for name in chosen:
        PICTURES[name]()
    return 0


if __name__ == "__main__":
    sys.exit(main())
