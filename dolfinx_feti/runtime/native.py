# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""C code of the package, compiled at first use and kept, as FFCx does with forms.

``DOLFINX_FETI_CFLAGS`` has further flags for FFCx's compiler. The cache is
``$XDG_CACHE_HOME/dolfinx_feti`` (``~/.cache/dolfinx_feti`` without that variable), or a folder for
this run where that cannot be written. Names change with the code, the flags, the processor if they
ask for its kind, cffi and Python.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import hashlib
import importlib.util
import io
import logging
import os
import platform
import re
import shlex
import shutil
import sysconfig
import tempfile
import threading
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from mpi4py import MPI

import cffi
import numpy.typing as npt
from scipy.linalg import cython_blas, cython_lapack

from dolfinx_feti.runtime.collective import on_all, on_first, reason

__all__ = ["address_of", "announced", "load", "pointer", "processor_flags"]

#: Machines of which the compiler knows ``-march=native``.
MACHINES = ("x86_64", "aarch64")

#: End of the names of Python's modules.
SUFFIX = str(sysconfig.get_config_var("EXT_SUFFIX"))

#: Seconds of a compilation without a word.
PATIENCE = 2.0

logger = logging.getLogger("dolfinx_feti.compilation")

_loaded: dict[object, ModuleType] = {}

#: Attribute of communicators.
_SEEN = MPI.Comm.Create_keyval()


def load(
    source: Path,
    declarations: str,
    comm: MPI.Comm,
    *,
    generated: str = "",
    flags: Sequence[str] = ("-O3",),
    cache: Path | None = None,
) -> Any:
    """Compile a file, unless that is done, and load it.

    Args:
        source: The file; files that it includes in quotes are beside it.
        declarations: What of it is called and read, in C.
        comm: Communicator of all processes that load it. The first one compiles; others do only
            where they do not see its files.
        generated: Code that takes the place of ``/* generated */`` in the file.
        flags: For the compiler.
        cache: Folder in the place of the package's own.

    Returns:
        The module, whose ``lib`` has the functions, and ``ffi`` the types.

    Raises:
        RuntimeError: It cannot be compiled or loaded, on all processes.

    Note:
        Collective. Code that has been loaded with a communicator is found without communication.
    """
    flags = (*flags, *shlex.split(os.environ.get("DOLFINX_FETI_CFLAGS", "")))
    key = source, declarations, generated, flags, cache
    seen = _seen(comm)
    if key in seen and key in _loaded:
        return _loaded[key]

    def module(path: str = "") -> str:
        """Load the code, and return where it is."""
        if key not in _loaded:
            try:
                text = _text(source, generated)
                known_by = [text, declarations, *flags, version("cffi"), SUFFIX]
                name = hashlib.sha256("\n".join(known_by).encode()).hexdigest()[:16]
                name = f"{source.stem}_{name}"
                if not Path(path).is_file():
                    path = str(_compiled(name, text, declarations, flags, cache))
                _loaded[key] = _import(name, Path(path))
            except Exception as error:
                raise RuntimeError(
                    f"{source.name} cannot be compiled ({reason(error)}): check the C compiler, "
                    "which FFCx needs, too (variable CC), and that the cache can be written "
                    "(variable XDG_CACHE_HOME)."
                ) from error
        return str(_loaded[key].__file__)

    path = on_first(module, comm)
    on_all(lambda: module(path), comm)
    seen.add(key)
    return _loaded[key]


@contextlib.contextmanager
def announced(what: str, where: object) -> Iterator[None]:
    """Log that something is being compiled if that takes more than two seconds.

    Args:
        what: What is compiled.
        where: Folder that keeps it.
    """
    message = f"compiling {what}, which is kept for later runs in {where}"
    timer = threading.Timer(PATIENCE, logger.warning, [message])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


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


def pointer(module: Any, array: npt.NDArray[Any], *, order: str = "C") -> Any:
    """Return a C pointer to the entries of an array, which has to outlive it.

    Args:
        module: What :func:`load` returns.
        array: An array of float32, float64, int32 or int64.
        order: How the code reads it, by rows (C) or by columns (F).

    Raises:
        ValueError: The entries are not consecutive in this order, or of another type.
    """
    if not array.flags.c_contiguous if order == "C" else not array.flags.f_contiguous:
        raise ValueError(f"array of shape {array.shape} is not contiguous in {order} order")
    kind = {"f4": "float[]", "f8": "double[]", "i4": "int[]", "i8": "int64_t[]"}.get(
        array.dtype.str[1:]
    )
    if kind is None or not array.dtype.isnative:
        raise ValueError(f"array of {array.dtype}: give float32, float64, int32 or int64")
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


def _seen(comm: MPI.Comm) -> set[object]:
    """Return what all processes of a communicator have loaded."""
    seen: Any = comm.Get_attr(_SEEN)
    if seen is None:
        seen = set[object]()
        comm.Set_attr(_SEEN, seen)
    return cast(set[object], seen)


def _text(source: Path, generated: str) -> str:
    """Return a file with the generated code and the files that it includes."""
    text = source.read_text(encoding="utf-8").replace("/* generated */", generated)
    for header in re.findall(r'^#include "(.*)"$', text, flags=re.MULTILINE):
        own = source.with_name(header).read_text(encoding="utf-8")
        text = text.replace(f'#include "{header}"', own)
    return text


def _compiled(
    name: str, text: str, declarations: str, flags: Sequence[str], cache: Path | None
) -> Path:
    """Return the compiled file; others may be making the same one at the same time."""
    own = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "dolfinx_feti"
    folder = own if cache is None else cache
    kept = folder / (name + SUFFIX)
    if kept.exists():
        return kept
    try:
        folder.mkdir(parents=True, exist_ok=True)
        work = tempfile.mkdtemp(dir=folder)
    except OSError as error:
        logger.info(f"compiled code is not kept: {reason(error)}")
        folder = Path(tempfile.mkdtemp())
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        work, kept = tempfile.mkdtemp(dir=folder), folder / kept.name
    try:
        builder = cffi.FFI()
        builder.cdef(declarations)
        builder.set_source(name, text, extra_compile_args=list(flags))
        output = io.StringIO()
        with contextlib.redirect_stdout(output), announced(name.rpartition("_")[0] + ".c", folder):
            made = builder.compile(tmpdir=work)
        Path(made).replace(kept)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return kept


def _import(name: str, path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is not a module")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
