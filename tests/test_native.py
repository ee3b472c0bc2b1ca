# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""C code that is compiled at first use."""

from __future__ import annotations

import ctypes
import logging

import numpy as np
from collective import COMM, agree, raises

from dolfinx_feti import native

TWICE = """
void twice(int n, double *x) { for (int i = 0; i < n; ++i) x[i] *= 2.0; }
"""


def test_compiled_once_and_kept(tmp_path, monkeypatch):
    """The first process compiles; a second call finds what is loaded, another run the file."""
    folder = COMM.bcast(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    source = folder / "twice.c"
    if COMM.rank == 0:
        source.write_text(TWICE, encoding="utf-8")
    COMM.barrier()
    module = native.load(source, "void twice(int, double *);", COMM)
    x = np.arange(3.0)
    module.lib.twice(3, native.pointer(module, x))
    agree(np.array_equal(x, [0.0, 2.0, 4.0]))
    agree(native.load(source, "void twice(int, double *);", COMM) is module)
    files = list((folder / "dolfinx_feti").iterdir())
    agree(len(files) == 1 and files[0].name.startswith("twice_"))
    monkeypatch.setattr(native, "_loaded", {})
    monkeypatch.setattr(native.cffi.FFI, "compile", lambda *_, **__: agree(False))
    native.load(source, "void twice(int, double *);", COMM).lib.twice(3, native.pointer(module, x))
    agree(np.array_equal(x, [0.0, 4.0, 8.0]))


def test_code_that_does_not_compile(tmp_path, monkeypatch):
    """All processes raise."""
    folder = COMM.bcast(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    source = folder / "wrong.c"
    if COMM.rank == 0:
        source.write_text("void wrong(int n) { no C; }", encoding="utf-8")
    COMM.barrier()
    with raises(native.cffi.VerificationError, "CompileError"):
        native.load(source, "void wrong(int);", COMM)


def test_done_without(tmp_path, monkeypatch, caplog):
    """A file that cannot be compiled is warned of once, with the remedy, and not tried again."""
    tried = []

    def fails(*_):
        tried.append(1)
        raise OSError("no compiler here")

    monkeypatch.setattr(native, "load", fails)
    monkeypatch.setattr(native, "_failed", set())
    with caplog.at_level(logging.WARNING, logger="dolfinx_feti"):
        for _ in range(3):
            agree(native.load_or_do_without(tmp_path / "any.c", "", COMM) is None)
    agree(len(tried) == 1)
    agree(
        COMM.rank > 0 or [r.getMessage().count("no compiler here") for r in caplog.records] == [1]
    )
    agree(COMM.rank > 0 or "XDG_CACHE_HOME" in caplog.text)


def test_addresses_of_blas_and_lapack():
    """A function found by name does what it should."""
    kind = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)
    dnrm2 = kind(native.address_of("dnrm2"))
    x = np.array([3.0, 4.0])
    n, step = ctypes.c_int(2), ctypes.c_int(1)
    norm = dnrm2(ctypes.addressof(n), x.ctypes.data, ctypes.addressof(step))
    agree(norm == 5.0 and native.address_of("dpotrf") != 0)
