# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""C code of the package, compiled at first use and kept, as FFCx does with forms.

The compiler is the one that FFCx calls, by way of cffi; ``DOLFINX_FETI_CFLAGS`` has further flags
for it. What it makes is kept in ``$XDG_CACHE_HOME/dolfinx_feti`` (``~/.cache/dolfinx_feti`` without
that variable), under a name that changes with the code, the flags and Python.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import importlib.util
import io
import os
import platform
import shlex
import sysconfig
import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from mpi4py import MPI

import cffi
import numpy.typing as npt
from scipy.linalg import cython_blas, cython_lapack

from dolfinx_feti.runtime.collective import on_all, on_first, reason

__all__ = ["address_of", "load", "pointer", "processor_flags"]

#: Machines of which the compiler knows ``-march=native``.
MACHINES = ("x86_64", "aarch64")

_loaded: dict[str, ModuleType] = {}


def load(
    source: Path,
    declarations: str,
    comm: MPI.Comm,
    *,
    generated: str = "",
    flags: Sequence[str] = ("-O3",),
) -> Any:
    """Compile a file, unless that is done, and load it.

    Args:
        source: The file.
        declarations: What of it is called and read, in C.
        comm: Communicator of all processes that load it. The first one compiles; others do only
            where they do not see its files.
        generated: Code that takes the place of ``/* generated */`` in the file.
        flags: For the compiler.

    Returns:
        The module, whose ``lib`` has the functions, and ``ffi`` the types.

    Raises:
        RuntimeError: It cannot be compiled or loaded, on all processes.

    Note:
        Collective.
    """
    text = source.read_text(encoding="utf-8").replace("/* generated */", generated)
    flags = [*flags, *shlex.split(os.environ.get("DOLFINX_FETI_CFLAGS", ""))]
    version = "\n".join([text, declarations, *flags, str(sysconfig.get_config_var("EXT_SUFFIX"))])
    name = f"{source.stem}_{hashlib.sha256(version.encode()).hexdigest()[:16]}"

    def module() -> ModuleType:
        if name not in _loaded:
            try:
                _loaded[name] = _import(name, _compiled(name, text, declarations, flags))
            except Exception as error:
                raise RuntimeError(
                    f"{source.name} cannot be compiled ({reason(error)}): check the C compiler, "
                    "which FFCx needs, too (variable CC), and that the cache can be written "
                    "(variable XDG_CACHE_HOME)."
                ) from error
        return _loaded[name]

    on_first(lambda: bool(module()), comm)
    return on_all(module, comm)


def processor_flags() -> list[str]:
    """Return flags for code that runs on processors of this kind only.

    One of them names the processor, so that the names of the code do: several kinds of machines may
    share a cache. There are none where it is not known.
    """
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").split("\n\n", maxsplit=1)[0]
    except OSError:
        return []
    if platform.machine() not in MACHINES:
        return []
    known = [
        line for line in lines.splitlines() if line.startswith(("model", "CPU", "flags", "Feat"))
    ]
    name = hashlib.sha256("\n".join(known).encode()).hexdigest()[:8]
    return ["-march=native", f"-DPROCESSOR_{name}"]


def pointer(module: Any, array: npt.NDArray[Any]) -> Any:
    """Return a C pointer to the entries of an array, which has to outlive it.

    Raises:
        ValueError: The entries are not consecutive.
    """
    if not (array.flags.c_contiguous or array.flags.f_contiguous):
        raise ValueError(f"array of shape {array.shape} is not contiguous")
    kind = {"f4": "float[]", "f8": "double[]", "i4": "int[]", "i8": "int64_t[]"}[
        array.dtype.str[1:]
    ]
    return module.ffi.from_buffer(kind, array.ravel(order="K"))


def address_of(name: str) -> int:
    """Return where a function of BLAS or LAPACK is, such as ``dsyrk``, with 32-bit integers."""
    library = cython_blas if name in cython_blas.__pyx_capi__ else cython_lapack
    capsule = library.__pyx_capi__[name]
    api = ctypes.pythonapi
    api.PyCapsule_GetName.restype = ctypes.c_char_p
    api.PyCapsule_GetName.argtypes = [ctypes.py_object]
    api.PyCapsule_GetPointer.restype = ctypes.c_void_p
    api.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    return int(api.PyCapsule_GetPointer(capsule, api.PyCapsule_GetName(capsule)))


def _compiled(name: str, text: str, declarations: str, flags: list[str]) -> Path:
    """Return the compiled file; others may be making the same one at the same time."""
    folder = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "dolfinx_feti"
    kept = folder / (name + sysconfig.get_config_var("EXT_SUFFIX"))
    if kept.exists():
        return kept
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as work:
        builder = cffi.FFI()
        builder.cdef(declarations)
        builder.set_source(name, text, extra_compile_args=flags)
        output = io.StringIO()
        with contextlib.redirect_stdout(output):
            made = builder.compile(tmpdir=work)
        Path(made).replace(kept)
    return kept


def _import(name: str, path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is not a module")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
