# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""C code of the package, compiled at first use and kept, as FFCx does with forms.

``DOLFINX_FETI_CFLAGS`` has further flags for the C compiler, which FFCx uses, too. The cache is
``$XDG_CACHE_HOME/dolfinx_feti`` (``~/.cache/dolfinx_feti`` without that variable), or a folder for
this run where that cannot be written. Names change with the code, the flags, the processor if they
ask for its kind, cffi and Python.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import importlib.util
import io
import logging
import os
import platform
import re
import shlex
import sysconfig
import tempfile
import threading
from collections.abc import Iterable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

from mpi4py import MPI

import cffi
import numpy as np
import numpy.typing as npt
from scipy.linalg import cython_blas, cython_lapack

from dolfinx_feti.runtime.collective import on_all, on_first, reason

#: Machines of which the compiler knows ``-march=native``.
MACHINES = ("x86_64", "aarch64")

#: Seconds of a compilation without a word.
PATIENCE = 2.0

#: Source, declarations, generated code, flags and cache, see :func:`load`.
_Key = tuple[Path, str, str, tuple[str, ...], Path | None]

logger = logging.getLogger("dolfinx_feti.compilation")

#: Types of C, by those of arrays.
_KINDS = {
    np.dtype(np.float32): "float[]",
    np.dtype(np.float64): "double[]",
    np.dtype(np.int32): "int[]",
    np.dtype(np.int64): "int64_t[]",
}

#: Attribute of communicators: what all of their processes have loaded.
_SEEN = MPI.Comm.Create_keyval()

#: What this process has loaded.
_loaded: dict[object, ModuleType] = {}


def _temporary(folder: Path | None = None) -> tempfile.TemporaryDirectory[str]:
    """Create a folder for a while; what others hold open in it may stay, as NFS has it."""
    return tempfile.TemporaryDirectory(dir=folder, ignore_cleanup_errors=True)


#: Cache of this run where the other one cannot be written.
_scratch = functools.cache(_temporary)


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
            where they do not see its file.
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
    seen: Any = comm.Get_attr(_SEEN)
    if seen is None:
        seen = set[object]()
        comm.Set_attr(_SEEN, seen)
    if key not in seen:
        path = on_first(lambda: str(_module(key).__file__), comm)
        on_all(lambda: _module(key, path), comm)
        seen.add(key)
    return _module(key)


@contextlib.contextmanager
def announced(what: str, where: object) -> Iterator[None]:
    """Log what is being compiled, and which folder keeps it, if that takes over two seconds."""
    message = f"compiling {what}, which is kept for later runs in {where}"
    timer = threading.Timer(PATIENCE, logger.warning, [message])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def processor_flags() -> list[str]:
    """Return flags for code that runs on processors of this kind only; none where it is not known.

    One of them names the processor, so that the names of the code do: several kinds of machines may
    share a cache.
    """
    try:
        first = Path("/proc/cpuinfo").read_text(encoding="utf-8").split("\n\n", maxsplit=1)[0]
    except OSError:
        return []
    if platform.machine() not in MACHINES:
        return []
    known = re.findall("^(?:model|CPU|flags|Feat).*", first, flags=re.MULTILINE)
    return ["-march=native", f"-DPROCESSOR_{_hash(known)[:8]}"]


def pointer(module: Any, array: npt.NDArray[Any], *, order: str = "C") -> Any:
    """Return a C pointer, of a loaded module, to the entries of an array, which outlives it.

    Raises:
        ValueError: The entries are not consecutive by rows (C) or by columns (F), or not of
            float32, float64, int32 or int64.
    """
    by_rows = array if order == "C" else array.T
    if not by_rows.flags.c_contiguous:
        raise ValueError(f"array of shape {array.shape} is not contiguous in {order} order")
    kind = _KINDS.get(array.dtype)
    if kind is None:
        raise ValueError(f"array of {array.dtype}: give float32, float64, int32 or int64")
    return module.ffi.from_buffer(kind, by_rows)


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


def _hash(texts: Iterable[str]) -> str:
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()


def _module(key: _Key, path: str = "") -> ModuleType:
    """Load what was compiled to a path, or compile it, unless that is done; see :func:`load`."""
    if key in _loaded:
        return _loaded[key]
    source, declarations, generated, flags, cache = key
    try:
        text, suffix = _text(source, generated), str(sysconfig.get_config_var("EXT_SUFFIX"))
        known_by = _hash([text, declarations, *flags, version("cffi"), suffix])[:16]
        name = f"{source.stem}_{known_by}"
        if not Path(path).is_file():
            path = str(_compiled(name + suffix, text, declarations, flags, cache))
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None and spec.loader is not None, path
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    except Exception as error:
        raise RuntimeError(
            f"{source.name} cannot be compiled ({reason(error)}): check the C compiler, which FFCx "
            "needs, too (variable CC), and that the cache can be written (variable XDG_CACHE_HOME)."
        ) from error
    return _loaded.setdefault(key, module)


def _text(source: Path, generated: str) -> str:
    """Return a file with the generated code and the files that it includes."""
    text = source.read_text(encoding="utf-8").replace("/* generated */", generated)
    for header in re.findall(r'^#include "(.*)"$', text, flags=re.MULTILINE):
        own = source.with_name(header).read_text(encoding="utf-8")
        text = text.replace(f'#include "{header}"', own)
    return text


def _compiled(
    file: str, text: str, declarations: str, flags: Sequence[str], cache: Path | None
) -> Path:
    """Return the compiled file; others may be making the same one at the same time."""
    own = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "dolfinx_feti"
    folder = cache or own
    if (folder / file).exists():
        return folder / file
    try:
        folder.mkdir(parents=True, exist_ok=True)
        work = _temporary(folder)
    except OSError as error:
        logger.info(f"compiled code is not kept: {reason(error)}")
        folder = Path(_scratch().name)
        work = _temporary(folder)
    name, builder = file.partition(".")[0], cffi.FFI()
    builder.cdef(declarations)
    builder.set_source(name, text, extra_compile_args=list(flags))
    what = name.rpartition("_")[0] + ".c"
    with work, contextlib.redirect_stdout(io.StringIO()), announced(what, folder):
        return Path(builder.compile(tmpdir=work.name)).replace(folder / file)
