# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The import of PyVista, and VTK's way to draw without a window."""

from __future__ import annotations

import ctypes.util
import importlib
import importlib.util
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["import_pyvista", "require_pyvista", "without_window"]

#: Environment variable of VTK: the class of its windows.
VTK_WINDOW = "VTK_DEFAULT_OPENGL_WINDOW"


def require_pyvista() -> None:
    """Raise an ImportError if PyVista is not installed."""
    if importlib.util.find_spec("pyvista") is None:
        raise ImportError(
            'Pictures need PyVista: pip install "pyvista>=0.46" matplotlib, or '
            "conda install -c conda-forge pyvista matplotlib."
        )


def import_pyvista() -> Any:
    """Import and return ``pyvista``: on the first process only, as this takes a second."""
    return importlib.import_module("pyvista")


@contextmanager
def without_window() -> Iterator[None]:
    """Set VTK's window to EGL or OSMesa if there is no display: VTK would try X first and warn.

    Raises:
        RuntimeError: This machine has no library for it.
    """
    if os.environ.get("DISPLAY") or os.name == "nt" or VTK_WINDOW in os.environ:
        yield
        return
    if ctypes.util.find_library("EGL"):
        window = "vtkEGLRenderWindow"
    elif ctypes.util.find_library("OSMesa"):
        window = "vtkOSOpenGLRenderWindow"
    else:
        raise RuntimeError(
            "There is no display, and no library to draw without one: apt install libegl1 "
            "libegl-mesa0 libgl1-mesa-dri, or conda install -c conda-forge mesalib."
        )
    os.environ[VTK_WINDOW] = window
    try:
        yield
    finally:
        del os.environ[VTK_WINDOW]
