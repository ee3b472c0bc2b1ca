# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What tests of demos share: where they are, and what they leave behind."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from collective import agree
from wall_files import ROOT, on_first

DEMOS = ROOT / "demos"
EXAMPLE = ROOT / "meshes/example.msh"


def read_summary(folder: Path) -> dict[str, Any]:
    return on_first(lambda: json.loads((folder / "summary.json").read_text()))


def check_pictures(folder: Path, *names: str, height: int = 500, width: int = 800) -> None:
    """Each is there, large enough to look at, and not of one colour."""
    from matplotlib.image import imread

    def look() -> list[tuple[float, ...]]:
        images = [imread(folder / name) for name in names]
        return [(float(np.ptp(image)), *image.shape[:2]) for image in images]

    found = on_first(look)
    agree(all(range_ > 0.5 and h > height and w > width for range_, h, w in found), found)
