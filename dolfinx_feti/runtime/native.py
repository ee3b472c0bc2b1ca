# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""C code of the package: compiled at first use, cached in a folder, loaded by cffi.

FFCx handles the code that it generates for forms in the same way. Environment variables:

- ``DOLFINX_FETI_CFLAGS``: further flags for the C compiler, which is that of FFCx (``CC``),
- ``XDG_CACHE_HOME``: the cache is ``$XDG_CACHE_HOME/dolfinx_feti`` (``~/.cache/dolfinx_feti``
  without that variable), or a folder for this run only if that cannot be written.

The name of a compiled file contains a hash of the code, the flags, and the versions of cffi and
Python. If one of them changes, the code is compiled to another file.
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
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

from mpi4py import MPI

import cffi
import numpy as np
import numpy.typing as npt
from scipy.linalg import cython_blas, cython_lapack

from dolfinx_feti.runtime.collective import error_message, on_all, on_root

#: Machines whose compilers know ``-march=native``.
MACHINES = ("x86_64", "aarch64")

#: Duration after which a compilation is logged [s]. Most files take less than one second; the user
#: should know the reason of a longer wait.
LOG_AFTER = 2.0

logger = logging.getLogger("dolfinx_feti.compilation")

#: Type of a pointer in C, by the type of the entries of an array.
_C_TYPES = {
    np.dtype(np.float32): "float[]",
    np.dtype(np.float64): "double[]",
    np.dtype(np.int32): "int[]",
    np.dtype(np.int64): "int64_t[]",
}


@dataclass(frozen=True, slots=True)
class _Unit:
    """The arguments of :func:`load` that determine a compiled file, with all flags."""

    source: Path
    declarations: str
    generated: str
    flags: tuple[str, ...]
    cache: Path | None


#: Modules that this process has loaded, like ``sys.modules`` of Python.
_loaded: dict[_Unit, ModuleType] = {}

#: Key of an attribute of communicators: the set of units that :func:`load` has loaded with it. The
#: set is the same on all processes, because :func:`load` is collective.
_LOADED_BY_ALL = MPI.Comm.Create_keyval()


def load(
    source: Path,
    declarations: str,
    comm: MPI.Comm,
    *,
    generated: str = "",
    flags: Sequence[str] = ("-O3",),
    cache: Path | None = None,
) -> Any:
    """Load a C file, which is compiled unless the cache has it. Collective.

    The first process compiles. Another process compiles as well if it cannot access the file of the
    first, as on nodes without a common file system. A second call with the same communicator does
    not communicate.

    Args:
        source: The file. Paths of its ``#include "…"`` are relative to its folder.
        declarations: Declarations in C of the functions and types that Python uses.
        comm: All processes that load it.
        generated: Code that replaces ``/* generated */`` in the file.
        flags: Flags for the compiler.
        cache: Folder to use in place of the cache of the package.

    Returns:
        The module of cffi: ``lib`` has the functions, ``ffi`` the types.

    Raises:
        RuntimeError: It cannot be compiled, or the compiled file cannot be loaded; on all
            processes.
    """
    all_flags = (*flags, *shlex.split(os.environ.get("DOLFINX_FETI_CFLAGS", "")))
    unit = _Unit(source, declarations, generated, all_flags, cache)
    loaded_by_all: Any = comm.Get_attr(_LOADED_BY_ALL)
    if loaded_by_all is None:
        loaded_by_all = set[_Unit]()
        comm.Set_attr(_LOADED_BY_ALL, loaded_by_all)
    if unit not in loaded_by_all:
        path = on_root(lambda: str(_load_module(unit).__file__), comm)
        on_all(lambda: _load_module(unit, path), comm)
        loaded_by_all.add(unit)
    return _load_module(unit)


def load_with_header(source: Path, comm: MPI.Comm, *, flags: Sequence[str] = ("-O3",)) -> Any:
    """Load a C file, like :func:`load`, whose declarations are in a header of the same name.

    The header consists of declarations and comments only, without directives of the preprocessor.
    Collective.
    """
    declarations = source.with_suffix(".h").read_text(encoding="utf-8")
    return load(source, declarations, comm, flags=flags)


@contextlib.contextmanager
def logged_if_slow(what: str, where: object) -> Iterator[None]:
    """Context that logs a compilation if it takes longer than :data:`LOG_AFTER`.

    Args:
        what: Name of the file that is compiled.
        where: Folder that caches the result.
    """
    message = f"compiling {what}, which is cached for later runs in {where}"
    timer = threading.Timer(LOG_AFTER, logger.warning, [message])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def processor_flags() -> list[str]:
    """Return compiler flags for the kind of processor of this process.

    One of the flags is a hash of the kind of processor. It does not affect the code, but the names
    of the compiled files: machines of several kinds may share a cache.

    Returns:
        The flags; none if the kind of processor is not known.
    """
    try:
        first = Path("/proc/cpuinfo").read_text(encoding="utf-8").split("\n\n", maxsplit=1)[0]
    except OSError:
        return []
    if platform.machine() not in MACHINES:
        return []
    # x86 has lines "model", "model name" and "flags", ARM has "CPU part", others, and "Features".
    description = re.findall("^(?:model|CPU|flags|Feat).*", first, flags=re.MULTILINE)
    return ["-march=native", f"-DPROCESSOR_{_hash(description)[:8]}"]


def pointer(module: Any, array: npt.NDArray[Any], *, order: str = "C") -> Any:
    """Return a C pointer to the entries of an array.

    The pointer keeps the array alive, but a C struct that contains the pointer does not: its
    creator has to keep the array until the last call of C with the struct.

    Args:
        module: The loaded module that uses the pointer.
        array: Numbers of type float32, float64, int32 or int64.
        order: "C" for entries row by row, "F" for column by column.

    Raises:
        ValueError: The entries are not contiguous in this order, or of another type.
    """
    by_rows = array if order == "C" else array.T
    if not by_rows.flags.c_contiguous:
        raise ValueError(f"array of shape {array.shape} is not contiguous in {order} order")
    c_type = _C_TYPES.get(array.dtype)
    if c_type is None:
        raise ValueError(f"array of {array.dtype}: give float32, float64, int32 or int64")
    return module.ffi.from_buffer(c_type, by_rows)


def address_of(name: str) -> int:
    """Return the address of a function of BLAS or LAPACK with 32-bit integers, such as ``dsyrk``.

    SciPy exports these functions to Cython as capsules.
    """
    library = cython_blas if name in cython_blas.__pyx_capi__ else cython_lapack
    capsule = library.__pyx_capi__[name]
    api = ctypes.pythonapi
    api.PyCapsule_GetName.restype = ctypes.c_char_p
    api.PyCapsule_GetName.argtypes = [ctypes.py_object]
    api.PyCapsule_GetPointer.restype = ctypes.c_void_p
    api.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    return int(api.PyCapsule_GetPointer(capsule, api.PyCapsule_GetName(capsule)))


def _hash(texts: Iterable[str]) -> str:
    """Return a hash of several texts as hexadecimal digits."""
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()


def _load_module(unit: _Unit, path: str = "") -> ModuleType:
    """Return the module of a unit on this process; load or compile it if necessary.

    Args:
        unit: What to load.
        path: File that the first process has compiled; ignored if this process has no access to it.

    Raises:
        RuntimeError: It cannot be compiled, or the compiled file cannot be loaded.
    """
    if unit in _loaded:
        return _loaded[unit]
    text = _read_code(unit.source, unit.generated)
    suffix = str(sysconfig.get_config_var("EXT_SUFFIX"))
    key = _hash([text, unit.declarations, *unit.flags, version("cffi"), suffix])[:16]
    name = f"{unit.source.stem}_{key}"
    if not Path(path).is_file():
        try:
            path = str(_compile(name + suffix, text, unit))
        except (cffi.VerificationError, ImportError, OSError) as error:
            raise RuntimeError(
                f"{unit.source.name} cannot be compiled ({error_message(error)}): check the C "
                "compiler, which FFCx needs, too (variable CC), and that the cache can be written "
                "(variable XDG_CACHE_HOME)."
            ) from error
    try:
        module = _import_file(name, path)
    except ImportError as error:
        raise RuntimeError(
            f"{path}, compiled from {unit.source.name}, cannot be loaded "
            f"({error_message(error)}): delete it, and it will be compiled again."
        ) from error
    return _loaded.setdefault(unit, module)


def _import_file(name: str, path: str) -> ModuleType:
    """Import a compiled file as the module of this name.

    Raises:
        ImportError: It cannot be imported.
    """
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is not an extension module")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _read_code(source: Path, generated: str) -> str:
    """Return the text of a C file, with the generated code and the files that it includes."""
    text = source.read_text(encoding="utf-8").replace("/* generated */", generated)
    for header in re.findall(r'^#include "(.*)"$', text, flags=re.MULTILINE):
        included = (source.parent / header).read_text(encoding="utf-8")
        text = text.replace(f'#include "{header}"', included)
    return text


def _compile(file: str, text: str, unit: _Unit) -> Path:
    """Return the path of a compiled file; compile it unless it is in the cache.

    Several processes may compile the same file at once. Each compiles in a temporary folder, and
    moves the result into the cache, which is atomic.

    Args:
        file: Name of the compiled file.
        text: Code, with all files that it includes.
        unit: Declarations, flags, and the folder of the cache.
    """
    home = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    folder = unit.cache or home / "dolfinx_feti"
    if (folder / file).exists():
        return folder / file
    try:
        folder.mkdir(parents=True, exist_ok=True)
        work = _temporary_folder(folder)
    except OSError as error:
        logger.info(f"compiled code is not cached: {error_message(error)}")
        folder = Path(_folder_of_run().name)
        work = _temporary_folder(folder)
    name = file.partition(".")[0]
    builder = cffi.FFI()
    builder.cdef(unit.declarations)
    builder.set_source(name, text, extra_compile_args=list(unit.flags))
    what = name.rpartition("_")[0] + ".c"
    # cffi and setuptools print the commands of the compiler.
    with work, contextlib.redirect_stdout(io.StringIO()), logged_if_slow(what, folder):
        return Path(builder.compile(tmpdir=work.name)).replace(folder / file)


def _temporary_folder(parent: Path | None = None) -> tempfile.TemporaryDirectory[str]:
    """Create a temporary folder. On NFS, files that are open elsewhere may remain after it."""
    return tempfile.TemporaryDirectory(dir=parent, ignore_cleanup_errors=True)


@functools.cache
def _folder_of_run() -> tempfile.TemporaryDirectory[str]:
    """Return the folder of compiled files of this run, used if the cache cannot be written."""
    return _temporary_folder()
