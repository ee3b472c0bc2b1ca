# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What the readers of mesh files share: optional packages, and where naming is explained."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

__all__ = ["NAMING_HELP", "import_reader"]

#: End of the messages about names and tags.
NAMING_HELP = "meshes/README.md explains how to name layers and surfaces"


def import_reader(name: str, path: Path) -> ModuleType:
    """Import an optional package that reads a file.

    Args:
        name: The package.
        path: The file, for the message.

    Raises:
        ModuleNotFoundError: The package is not installed; the message has the remedy.
    """
    try:
        return __import__(name)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"Reading {path} needs the Python package {name}, which is not installed: "
            f"`pip install {name}` or `apt install python3-{name}`",
            name=name,
        ) from error
